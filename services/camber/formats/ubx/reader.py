"""UBX decoder of a byte stream: observations, ephemerides, the receiver's position and its integrity reports.

Source: u-blox ZED-F9P, interface description (UBX-18010854), 3.2 (frame), 3.17.9 (RXM-SFRBX); ZED-F9R (UBX-20039643),
MON-RF, SEC-SIG. No input raises: malformed content is counted.
"""

from __future__ import annotations

import struct
from dataclasses import replace

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import BroadcastEphemeris
from camber.formats.receiver.frame_buffer import Frame, FramedDecoder
from camber.formats.receiver.integrity_report import JAMMING, IntegrityReport
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.ubx import nav_reader as nav
from camber.formats.ubx.ephemeris_assembly import EphemerisAssembler, SubframeWords
from camber.formats.ubx.gps_week import MS_PER_WEEK
from camber.formats.ubx.rawx_reader import read_raw_measurements
from camber.schemas.gnss import ReceiverIntegrity

UbxResult = (
    ReceiverEpoch
    | BroadcastEphemeris
    | IonosphereCoefficients
    | ReceiverSolution
    | nav.ReceiverBaseline
    | ReceiverIntegrity
    | SatelliteReport
)
_NAV, _RXM, _MON, _SEC = 0x01, 0x02, 0x0A, 0x27
_SPOOFING = ("unknown", "none", "indicated", "affirmed")
_NAVIGATION_IDS = {nav.PVT, nav.HPPOSLLH, nav.SAT, nav.COV, nav.RELPOSNED, nav.PL, nav.EOE}


class UbxMessages:
    """Decodes whole messages; `UbxDecoder` decodes a stream.

    `near_ns` (GPS time) resolves the 1024-week roll-over, and the week of messages before the first RXM-RAWX or dated
    NAV-PVT: without it such messages are not decoded. The NAV messages of one `iTOW` become one position, one baseline,
    one report of integrity and one of satellites with NAV-EOE, which should be enabled; without it when the next epoch
    begins, one epoch late. SEC-SIG and MON-RF after NAV-EOE become a separate report.
    """

    def __init__(self, near_ns: int | None = None, report: IntegrityReport | None = None) -> None:
        self.near_ns = near_ns
        """Time of the last epoch, initially as given."""
        # Only the given time resolves roll-overs: a wrong message may mislead the time, but not for long.
        self._reference_ns = near_ns
        self.malformed = 0
        """Messages whose content is inconsistent, truncated or of an unknown version."""
        self.not_read = 0
        """Messages, and subframes in them, of other kinds or systems."""
        self.without_time = 0
        """Messages without a week, before one was known."""
        self.other_systems = 0
        """Measurements of SBAS, NavIC."""
        self.unknown_signals = 0
        """Measurements and satellites of NAV-SAT without a number in the interface description."""
        self.repeated_signals = 0
        """Measurements of a signal that is already in the epoch; satellites that are already in NAV-SAT."""
        self.bad_subframes = 0
        """Subframes with a wrong parity or CRC, or with inconsistent content."""
        self.epochs_without_position = 0
        """Epochs for which the receiver reports no position, none in three dimensions, or none within its masks."""
        self.late = 0
        """NAV messages of an epoch after its end, and NAV-SAT of earlier ones."""
        self.has_positions = False
        """Whether the receiver sends NAV-PVT."""
        self.has_satellites = False
        """Whether it sends NAV-SAT, too."""
        self._report = IntegrityReport() if report is None else report
        self._locks = LossOfLockDetector()
        self._subframes = EphemerisAssembler()
        self._epoch: nav.NavigationEpoch | None = None
        self._ended_ms: int | None = None
        self._report_changed = False

    def take(self, frame: bytes) -> list[UbxResult]:
        """Return the results that one frame with a correct checksum completes."""
        message_class, message_id, payload = frame[2], frame[3], frame[6:-2]
        try:
            if message_class == _NAV and message_id in _NAVIGATION_IDS:
                return self._navigation(message_id, payload)
            if message_class == _RXM and message_id == 0x15:
                return self._raw_measurements(payload)
            if message_class == _RXM and message_id == 0x13:
                return self._subframe(payload)
            if (message_class, message_id) in ((_SEC, 0x09), (_MON, 0x38)):
                return self._signal_state(message_class, payload)
        except (ValueError, struct.error):
            self.malformed += 1
            return []
        self.not_read += 1
        return []

    def finish(self) -> list[UbxResult]:
        """Return the results of the pending epoch of NAV messages, at the end of the stream."""
        return self._end_epoch()

    def _raw_measurements(self, payload: bytes) -> list[UbxResult]:
        epoch, omitted = read_raw_measurements(payload, self._locks, self._reference_ns)
        self.near_ns = epoch.epoch.time_ns
        self.other_systems += omitted.other_systems
        self.unknown_signals += omitted.unknown_signals
        self.repeated_signals += omitted.repeated
        return [epoch]

    def _subframe(self, payload: bytes) -> list[UbxResult]:
        if len(payload) < 8 or len(payload) != 8 + 4 * payload[4]:
            raise ValueError(f"RXM-SFRBX of {len(payload)} bytes")
        if self.near_ns is None:
            self.without_time += 1
            return []
        words = struct.unpack_from(f"<{payload[4]}I", payload, 8)
        subframe = SubframeWords(
            gnss_id=payload[0],
            satellite=payload[1],
            signal_id=payload[2],
            words=words,
            frequency_id=payload[3],
        )
        try:
            results = self._subframes.take(subframe, self.near_ns)
        except ValueError:
            self.bad_subframes += 1
            return []
        self.not_read += results is None
        return [] if results is None else [*results]

    def _signal_state(self, message_class: int, payload: bytes) -> list[UbxResult]:
        epoch = self._epoch
        time_ns = self.near_ns if epoch is None else epoch.time_ns(self.near_ns, self._reference_ns)
        if time_ns is None:
            self.without_time += 1
            return []
        if message_class == _SEC:
            self._report.update("signals", time_ns, _signal_security(payload))
        else:
            self._report.update("front_ends", time_ns, {"jamming": _front_end_jamming(payload)})
        self._report_changed = True
        # Within an epoch the report is returned at its end.
        return [] if epoch is not None else self._integrity_report(time_ns)

    def _navigation(self, message_id: int, payload: bytes) -> list[UbxResult]:
        of_week_ms = nav.time_of_week_ms(message_id, payload)
        if message_id == nav.EOE:
            return self._end_epoch()
        results = list[UbxResult]()
        if message_id == nav.SAT and self._is_earlier(of_week_ms):
            # Receivers that navigate at high rates send it after the positions of later epochs.
            self.late += 1
            return []
        if self._epoch is None or self._epoch.of_week_ms != of_week_ms:
            if self._epoch is None and of_week_ms == self._ended_ms:
                self.late += 1
                return []
            results = self._end_epoch()
            self._epoch = nav.NavigationEpoch(of_week_ms)
        self.has_positions |= message_id == nav.PVT
        try:
            self._epoch.take(message_id, payload)
        except ValueError:
            self.malformed += 1
        return results

    def _is_earlier(self, of_week_ms: int) -> bool:
        """Whether a time is before the epoch's, or before the last one's where none has begun."""
        newest_ms = self._ended_ms if self._epoch is None else self._epoch.of_week_ms
        return newest_ms is not None and 0 < (newest_ms - of_week_ms) % MS_PER_WEEK < MS_PER_WEEK // 2

    def _end_epoch(self) -> list[UbxResult]:
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return []
        self._ended_ms = epoch.of_week_ms
        try:
            time_ns = epoch.time_ns(self.near_ns, self._reference_ns)
        except ValueError:
            self.malformed += 1
            return []
        if time_ns is None:
            self.without_time += 1
            return []
        self.near_ns = time_ns
        self.epochs_without_position += epoch.lacks_position
        for kind, fields in epoch.integrity.items():
            self._report.update(kind, time_ns, fields)
        solution, baseline = epoch.solution(time_ns), epoch.baseline
        results: list[UbxResult] = [] if solution is None else [solution]
        if baseline is not None:
            results.append(replace(baseline, time_ns=time_ns))
        if epoch.satellites is not None:
            self.unknown_signals += epoch.satellites.unknown
            self.repeated_signals += epoch.satellites.repeated
            report = epoch.satellite_report(time_ns)
            if report is not None:
                self.has_satellites = True
                results.append(report)
        if self._report_changed or epoch.integrity:
            results += self._integrity_report(time_ns)
        return results

    def _integrity_report(self, time_ns: int) -> list[UbxResult]:
        self._report_changed = False
        return [*self._report.at(time_ns)]


class UbxDecoder(FramedDecoder[UbxResult]):
    """Decodes a stream."""

    def __init__(self, source_name: str, near_ns: int | None = None) -> None:
        super().__init__("ubx")
        self.source_name = source_name
        self.messages = UbxMessages(near_ns)
        """With the counters of the messages."""

    def _take(self, frame: Frame) -> list[UbxResult]:
        return self.messages.take(frame.data)

    def _end(self) -> list[UbxResult]:
        return self.messages.finish()


def _signal_security(payload: bytes) -> dict[str, str]:
    """Return the states of jamming and spoofing of SEC-SIG, versions 1 and 2; unknown where detection is disabled."""
    version = payload[0] if payload else None
    if version == 1 and len(payload) >= 12:
        jamming, spoofing = payload[4], payload[8]
    elif version == 2 and len(payload) >= 4:
        jamming, spoofing = payload[1] & 0b111, payload[1] >> 3
    else:
        raise ValueError(f"SEC-SIG, version {version}, of {len(payload)} bytes")
    state = (spoofing >> 1 & 0b111) * (spoofing & 1)
    return {
        "jamming": JAMMING[(jamming >> 1 & 0b11) * (jamming & 1)],
        "spoofing": _SPOOFING[state] if state < len(_SPOOFING) else "unknown",
    }


def _front_end_jamming(payload: bytes) -> str:
    """Return the worst jamming state of the blocks of MON-RF, version 0; with one unknown, its absence is unknown."""
    if len(payload) < 4 or payload[0] != 0 or len(payload) != 4 + 24 * payload[1]:
        raise ValueError(f"MON-RF of {len(payload)} bytes")
    states = [payload[4 + 24 * block + 1] & 0b11 for block in range(payload[1])]
    worst = max(states, default=0)
    return JAMMING[worst if worst > 1 or 0 not in states else 0]
