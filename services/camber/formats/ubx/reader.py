"""UBX out of a byte stream: observations, ephemerides, the receiver's own position, and what it says of its integrity.

Source: u-blox ZED-F9P, interface description (UBX-18010854), 3.2 (frame), 3.17.9 (RXM-SFRBX); ZED-F9R (UBX-20039643),
MON-RF, SEC-SIG. Whatever the bytes are, nothing is raised: what cannot be read is counted.
"""

from __future__ import annotations

import struct
from dataclasses import replace

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris
from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.receiver.integrity_report import IntegrityReport
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.ubx.ephemeris_assembly import EphemerisAssembler
from camber.formats.ubx.nav_epochs import NavigationEpoch
from camber.formats.ubx.nav_reader import (
    COV,
    EOE,
    HPPOSLLH,
    PL,
    PVT,
    RELPOSNED,
    ReceiverBaseline,
    time_of_week_ms,
)
from camber.formats.ubx.rawx_reader import RawxEpoch, read_raw_measurements
from camber.schemas.gnss import ReceiverIntegrity

UbxResult = (
    RawxEpoch | Ephemeris | IonosphereCoefficients | ReceiverSolution | ReceiverBaseline | ReceiverIntegrity
)
_NAV, _RXM, _MON, _SEC = 0x01, 0x02, 0x0A, 0x27
_NAVIGATION_IDS = {PVT, HPPOSLLH, COV, RELPOSNED, PL, EOE}


class UbxMessages:
    """Reads messages that have been found already; with `UbxDecoder` around it, a stream.

    `near_ns` (GPS time) settles which 1024 weeks are meant, and the week of what comes before the first RXM-RAWX or
    dated NAV-PVT: without it such messages are not read. One epoch of NAV messages, told by their `iTOW`, becomes one
    position, one baseline and one statement of integrity when NAV-EOE comes, which should be switched on; else when the
    next epoch begins, one epoch late. SEC-SIG and MON-RF after NAV-EOE become a statement of their own.
    """

    def __init__(self, near_ns: int | None = None, statements: IntegrityReport | None = None) -> None:
        self.near_ns = near_ns
        """Of the last epoch, at first as given."""
        # Only what is given settles roll-overs: a message that lies may lead the time astray, but not for long.
        self._reference_ns = near_ns
        self.malformed = 0
        """Messages whose content contradicts itself, is cut short or of a version that is not known."""
        self.not_read = 0
        """Messages, and subframes in them, of other kinds or systems."""
        self.without_time = 0
        """Messages that say no week, before one was known."""
        self.other_systems = 0
        """Measurements of GLONASS, SBAS, NavIC."""
        self.unknown_signals = 0
        """Measurements of satellites or signals without a number in the interface description."""
        self.repeated_signals = 0
        """Measurements of a signal that was there already in the same epoch."""
        self.bad_subframes = 0
        """Subframes whose own check is wrong or whose content contradicts itself."""
        self.epochs_without_position = 0
        """The receiver said that it has none, none in three dimensions, or none within its own limits."""
        self.late = 0
        """NAV messages of an epoch after its end."""
        self.has_positions = False
        """Whether the receiver sends NAV-PVT."""
        self._statements = IntegrityReport() if statements is None else statements
        self._locks = LossOfLockDetector()
        self._subframes = EphemerisAssembler()
        self._epoch: NavigationEpoch | None = None
        self._ended_ms: int | None = None
        self._stated = False

    def take(self, frame: bytes) -> list[UbxResult]:
        """What one frame with a right checksum completes."""
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
        """Call at the end of the stream: the epoch of NAV messages that is waiting."""
        return self._end_epoch()

    def _raw_measurements(self, payload: bytes) -> list[UbxResult]:
        epoch, left_out = read_raw_measurements(payload, self._locks, self._reference_ns)
        self.near_ns = epoch.epoch.time_ns
        self.other_systems += left_out.other_systems
        self.unknown_signals += left_out.unknown_signals
        self.repeated_signals += left_out.repeated
        return [epoch]

    def _subframe(self, payload: bytes) -> list[UbxResult]:
        if len(payload) < 8 or len(payload) != 8 + 4 * payload[4]:
            raise ValueError(f"RXM-SFRBX of {len(payload)} bytes")
        if self.near_ns is None:
            self.without_time += 1
            return []
        words = struct.unpack_from(f"<{payload[4]}I", payload, 8)
        try:
            found = self._subframes.take(payload[0], payload[1], payload[2], words, self.near_ns)
        except ValueError:
            self.bad_subframes += 1
            return []
        self.not_read += found is None
        return [] if found is None else [*found]

    def _signal_state(self, message_class: int, payload: bytes) -> list[UbxResult]:
        time_ns = (
            self.near_ns if self._epoch is None else self._epoch.time_ns(self.near_ns, self._reference_ns)
        )
        if time_ns is None:
            self.without_time += 1
            return []
        if message_class == _SEC:
            self._statements.say_signal_security(time_ns, *_signal_security(payload))
        else:
            self._statements.say_front_ends(time_ns, _front_ends(payload))
        self._stated = True
        # Within an epoch the statement is made at its end.
        return [] if self._epoch is not None else self._state(time_ns)

    def _navigation(self, message_id: int, payload: bytes) -> list[UbxResult]:
        of_week_ms = time_of_week_ms(message_id, payload)
        if message_id == EOE:
            return self._end_epoch()
        results = list[UbxResult]()
        if self._epoch is None or self._epoch.of_week_ms != of_week_ms:
            if self._epoch is None and of_week_ms == self._ended_ms:
                self.late += 1
                return []
            results = self._end_epoch()
            self._epoch = NavigationEpoch(of_week_ms)
        self.has_positions |= message_id == PVT
        try:
            self._epoch.take(message_id, payload)
        except ValueError:
            self.malformed += 1
        return results

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
        if epoch.pvt is not None:
            self._statements.say_fix(
                time_ns, within_masks=epoch.pvt.within_masks, authenticated=epoch.pvt.authenticated
            )
        if epoch.protection is not None:
            self._statements.say_protection_levels(time_ns, epoch.protection.levels_m, epoch.protection.risk)
        solution, baseline = epoch.solution(time_ns), epoch.baseline
        results: list[UbxResult] = [] if solution is None else [solution]
        if baseline is not None:
            results.append(replace(baseline, time_ns=time_ns))
        if self._stated or epoch.pvt is not None or epoch.protection is not None:
            results += self._state(time_ns)
        return results

    def _state(self, time_ns: int) -> list[UbxResult]:
        self._stated = False
        return [*self._statements.at(time_ns)]


class UbxDecoder:
    """Reads a stream piece by piece; the results do not depend on how it is cut."""

    def __init__(self, source_name: str, near_ns: int | None = None) -> None:
        self.source_name = source_name
        self.messages = UbxMessages(near_ns)
        """Counts what is in the frames."""
        self._frames = FrameBuffer("ubx")

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no frame with a right checksum."""
        return self._frames.bytes_skipped

    @property
    def failed_checks(self) -> int:
        """Things that began like a frame and had a wrong checksum."""
        return self._frames.failed_checks["ubx"]

    def feed(self, data: bytes) -> list[UbxResult]:
        """What the bytes complete, in order. Never raises; keeps one partial frame and one epoch at most."""
        return [result for frame in self._frames.feed(data) for result in self.messages.take(frame.data)]

    def finish(self) -> list[UbxResult]:
        """Call at the end of the stream: what is left."""
        frames = self._frames.finish()
        results = [result for frame in frames for result in self.messages.take(frame.data)]
        return results + self.messages.finish()


def _signal_security(payload: bytes) -> tuple[int, int]:
    """SEC-SIG, versions 1 and 2: the states of jamming and spoofing; 0 where they are not looked for."""
    version = payload[0] if payload else None
    if version == 1 and len(payload) >= 12:
        jamming, spoofing = payload[4], payload[8]
    elif version == 2 and len(payload) >= 4:
        jamming, spoofing = payload[1] & 0b111, payload[1] >> 3
    else:
        raise ValueError(f"SEC-SIG, version {version}, of {len(payload)} bytes")
    return (jamming >> 1 & 0b11) * (jamming & 1), (spoofing >> 1 & 0b111) * (spoofing & 1)


def _front_ends(payload: bytes) -> list[int]:
    """MON-RF, version 0: the state of jamming of each block."""
    if len(payload) < 4 or payload[0] != 0 or len(payload) != 4 + 24 * payload[1]:
        raise ValueError(f"MON-RF of {len(payload)} bytes")
    return [payload[4 + 24 * block + 1] & 0b11 for block in range(payload[1])]
