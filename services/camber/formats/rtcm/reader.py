"""RTCM 3.3 out of a byte stream: reference stations, observations (MSM4 to MSM7), ephemerides.

Source: RTCM 10403.3, 4.2 (frame). Whatever the bytes are, nothing is raised: what cannot be read is counted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from camber.formats.broadcast.ephemeris_fields import FIELDS, ephemeris_from_integers
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.rtcm.ephemeris_messages import EPHEMERIS_MESSAGES
from camber.formats.rtcm.msm_reader import MsmMessage, is_msm, msm_header, read_msm
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

# A stream that never ends its epochs, or is of ever new stations, must not fill the memory: the oldest goes.
_MOST_MESSAGES, _MOST_STATIONS = 32, 16
_MOST_SATELLITES = {"G": 63, "J": 10, "E": 63, "C": 63}
# RINEX 3.04, table A8: F/NAV from E5a with the clock of E5a, E1; I/NAV from E1-B, E5b with that of E5b, E1.
_DATA_SOURCES = {1045: 258.0, 1046: 517.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceStation:
    """Message 1005 or 1006: the antenna reference point, and (1006) its height above the marker."""

    station_id: int
    position_ecef_m: tuple[float, float, float]
    antenna_height_m: float | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BaseStationEpoch:
    """All observations of one epoch. Not `complete`: another epoch began before the last message of this one."""

    station_id: int
    epoch: ObservationEpoch
    complete: bool


RtcmResult = ReferenceStation | BaseStationEpoch | Ephemeris


class RtcmDecoder:
    """Reads a stream piece by piece; the results do not depend on how it is cut.

    RTCM does not say the week: `near_ns` (GPS time) must be within half a week of the first epoch, later ones follow
    the stream. `loss_of_lock` of the observations is set where the lock time says that the phase broke since the
    signal's last epoch. An ephemeris' `transmission_ns` is the last epoch's time.
    """

    def __init__(self, near_ns: int) -> None:
        self.malformed = 0
        """Frames with a right CRC whose content contradicts itself or is cut short."""
        self.not_read = 0
        """Messages of other kinds or systems."""
        self.unknown_signals = 0
        """Cells of signals without a number in the standard's tables."""
        self.incomplete = 0
        """Epochs whose last message did not come."""
        self._frames = FrameBuffer("rtcm")
        self._near_ns = near_ns
        self._parts: dict[int, list[MsmMessage]] = {}
        self._locks: dict[int, LossOfLockDetector] = {}

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no frame with a right CRC."""
        return self._frames.bytes_skipped

    @property
    def failed_checks(self) -> int:
        """Things that began like a frame and had a wrong CRC."""
        return self._frames.failed_checks["rtcm"]

    def feed(self, data: bytes) -> list[RtcmResult]:
        """What the bytes complete, in order."""
        return [result for frame in self._frames.feed(data) for result in self.take(frame.data)]

    def take(self, frame: bytes) -> list[RtcmResult]:
        """What a whole frame, whose CRC is right, completes."""
        try:
            return self._message(frame[3:-3])
        except ValueError:
            self.malformed += 1
            return []

    def finish(self) -> list[RtcmResult]:
        """Call at the end of the stream: what is left, an epoch without its last message among it."""
        results = [result for frame in self._frames.finish() for result in self.take(frame.data)]
        for station in sorted(self._parts):
            results += self._flush(station, complete=False)
        return results

    def _message(self, payload: bytes) -> list[RtcmResult]:
        if len(payload) < 2:
            raise ValueError(f"message of {len(payload)} bytes, expected a number")
        number = payload[0] << 4 | payload[1] >> 4
        if is_msm(number):
            return self._observations(payload, number)
        if number in EPHEMERIS_MESSAGES:
            return [_ephemeris(payload, number, self._near_ns)]
        if number in (1005, 1006):
            return [_reference_station(payload, number)]
        self.not_read += 1
        return []

    def _observations(self, payload: bytes, number: int) -> list[RtcmResult]:
        message = read_msm(payload, number, self._near_ns)
        if message is None:
            # Of other systems too the last message ends the epoch.
            self.not_read += 1
            station, more = msm_header(payload)
            return [] if more or station not in self._parts else self._flush(station, complete=True)
        self.unknown_signals += message.unknown_signals
        station, results = message.station_id, list[RtcmResult]()
        begun = self._parts.get(station)
        if begun and begun[0].time_ns != message.time_ns:
            results += self._flush(station, complete=False)
        elif (begun and len(begun) == _MOST_MESSAGES) or (not begun and len(self._parts) == _MOST_STATIONS):
            results += self._flush(station if begun else next(iter(self._parts)), complete=False)
        self._near_ns = message.time_ns
        self._parts.setdefault(station, []).append(message)
        return results if message.more_follow else results + self._flush(station, complete=True)

    def _flush(self, station: int, *, complete: bool) -> list[RtcmResult]:
        parts = self._parts.pop(station)
        self.incomplete += not complete
        time_ns = parts[0].time_ns
        integers = np.concatenate([part.integers for part in parts], axis=1)
        floats = np.concatenate([part.floats for part in parts], axis=1)
        keys = (integers[0] << 16) + integers[1]
        if len(set(keys.tolist())) < keys.size:
            # A station may send one signal in two kinds of messages: the first one counts.
            rows = np.sort(np.unique(keys, return_index=True)[1])
            integers, floats, keys = integers[:, rows], floats[:, rows], keys[rows]
        satellite, signal, half_cycle = integers
        pseudorange_m, carrier_phase_cycles, doppler_hz, cn0_dbhz, lock_time_s, most_lock_s = floats
        locks = self._locks.pop(station, None) or LossOfLockDetector()
        if len(self._locks) == _MOST_STATIONS:
            del self._locks[next(iter(self._locks))]
        self._locks[station] = locks
        epoch = ObservationEpoch(
            time_ns=time_ns,
            satellite=satellite,
            signal=signal,
            pseudorange_m=pseudorange_m,
            carrier_phase_cycles=carrier_phase_cycles,
            doppler_hz=doppler_hz,
            cn0_dbhz=cn0_dbhz,
            lock_time_s=lock_time_s,
            loss_of_lock=locks.lost(time_ns, keys, ~np.isnan(carrier_phase_cycles), lock_time_s, most_lock_s),
            half_cycle=half_cycle.astype(np.bool_),
        )
        return [BaseStationEpoch(station_id=station, epoch=epoch, complete=complete)]


class _Fields:
    """Takes integers one after another."""

    def __init__(self, payload: bytes) -> None:
        self._bits = int.from_bytes(payload, "big")
        self._left = 8 * len(payload)

    def take(self, width: int, *, signed: bool = False) -> int:
        self._left -= width
        if self._left < 0:
            raise ValueError("message is cut short")
        value = self._bits >> self._left & (1 << width) - 1
        return value - (1 << width) if signed and value >> (width - 1) else value


def _reference_station(payload: bytes, number: int) -> ReferenceStation:
    bits = _Fields(payload)
    bits.take(12)
    station_id = bits.take(12)
    bits.take(6 + 4)
    x = bits.take(38, signed=True)
    bits.take(2)
    y = bits.take(38, signed=True)
    bits.take(2)
    z = bits.take(38, signed=True)
    height_m = bits.take(16) * 1e-4 if number == 1006 else None
    return ReferenceStation(
        station_id=station_id, position_ecef_m=(x * 1e-4, y * 1e-4, z * 1e-4), antenna_height_m=height_m
    )


def _ephemeris(payload: bytes, number: int, near_ns: int) -> Ephemeris:
    system, layout, _ = EPHEMERIS_MESSAGES[number]
    bits = _Fields(payload)
    bits.take(12)
    integers = {
        name: bits.take(FIELDS[system][name].width, signed=FIELDS[system][name].signed) for name in layout
    }
    if not 1 <= integers["satellite"] <= _MOST_SATELLITES[system]:
        raise ValueError(f"satellite {integers['satellite']} of {system}")
    for time in ("toe_s", "toc_s"):
        if integers[time] * FIELDS[system][time].resolution * NS_PER_SECOND >= NS_PER_WEEK:
            raise ValueError(f"{time} is after the end of the week")
    ephemeris = ephemeris_from_integers(system, integers, near_ns)
    if number in _DATA_SOURCES:
        return replace(ephemeris, other={**ephemeris.other, "data_sources": _DATA_SOURCES[number]})
    return ephemeris
