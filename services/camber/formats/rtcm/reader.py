"""RTCM 3.3 decoder of a byte stream: base stations, observations (MSM4 to MSM7), ephemerides.

Source: RTCM 10403.3, 4.2 (frame). No input raises: malformed content is counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from camber.formats.broadcast.bit_fields import BitField, BitLayout, combine_parts, decode_layout
from camber.formats.broadcast.ephemeris_fields import FIELDS, ephemeris_from_integers
from camber.formats.broadcast.glonass_strings import glonass_ephemeris_from_integers
from camber.formats.observations import (
    GLONASS_CHANNELS,
    MAX_SATELLITE_NUMBER,
    OBSERVABLES,
    Ephemeris,
    GlonassEphemeris,
    ObservationEpoch,
)
from camber.formats.receiver.frame_buffer import Frame, FramedDecoder
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.rtcm.ephemeris_messages import (
    EPHEMERIS_MESSAGES,
    GLONASS_LAYOUT,
    GLONASS_MESSAGE,
    GLONASS_MESSAGE_FIELDS,
)
from camber.formats.rtcm.msm_reader import MsmMessage, is_msm, msm_header, read_msm, unknown_channels
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

# Chosen, as bounds on memory: an epoch has 8 messages at most, a port one base station; beyond, the oldest goes.
_MAX_MESSAGES, _MAX_STATIONS = 32, 16
_NUMBER_BITS = 12  # of a message, 4.2
# Messages 1005 and 1006: coordinates in 0.1 mm; before x is DF141, before y and z two flags or reserved bits.
_STATION: BitLayout = (_NUMBER_BITS, "station_id", 6 + 3, "is_virtual", "x", 2, "y", 2, "z")
_STATION_FIELDS = {
    "station_id": BitField(12),
    "is_virtual": BitField(1),
    **dict.fromkeys("xyz", BitField(38, signed=True)),
    "height": BitField(16),
}
# RINEX 3.04, table A8: F/NAV from E5a with the clock of E5a, E1; I/NAV from E1-B, E5b with that of E5b, E1.
_DATA_SOURCES = {1045: 258.0, 1046: 517.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceStation:
    """Message 1005 or 1006: the antenna reference point, and (1006) its height above the marker.

    `is_virtual` (DF141): computed by a network, not observed by a receiver there.
    """

    station_id: int
    position_ecef_m: tuple[float, float, float]
    antenna_height_m: float | None
    is_virtual: bool = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BaseStationEpoch:
    """All observations of one epoch; not `complete` where another epoch began before the last message of this one."""

    station_id: int
    epoch: ObservationEpoch
    complete: bool


RtcmResult = ReferenceStation | BaseStationEpoch | Ephemeris | GlonassEphemeris


class RtcmDecoder(FramedDecoder[RtcmResult]):
    """Decodes a stream.

    RTCM does not contain the week: `near_ns` (GPS time) must be within half a week of the first epoch, later ones
    follow the stream. `loss_of_lock` of the observations is derived from the lock time. An ephemeris'
    `transmission_ns` is the last epoch's time.
    """

    def __init__(self, near_ns: int) -> None:
        super().__init__("rtcm")
        self.malformed = 0
        """Frames with a correct CRC whose content is inconsistent or truncated."""
        self.not_read = 0
        """Messages of other kinds or systems."""
        self.unknown_signals = 0
        """Cells of signals without a number in the standard's tables."""
        self.incomplete = 0
        """Epochs whose last message is missing."""
        self._near_ns = near_ns
        self._messages: dict[int, list[MsmMessage]] = {}
        self._locks: dict[int, LossOfLockDetector] = {}
        self._channels = unknown_channels()

    @property
    def stations(self) -> int:
        """Base stations whose lock times are kept."""
        return len(self._locks)

    def take(self, frame: bytes) -> list[RtcmResult]:
        """Return the results that a whole frame with a correct CRC completes."""
        try:
            return self._decode(frame[3:-3])
        except ValueError:
            self.malformed += 1
            return []

    def _take(self, frame: Frame) -> list[RtcmResult]:
        return self.take(frame.data)

    def _end(self) -> list[RtcmResult]:
        return [self._complete(station, complete=False) for station in sorted(self._messages)]

    def _decode(self, payload: bytes) -> list[RtcmResult]:
        if len(payload) < 2:
            raise ValueError(f"message of {len(payload)} bytes, expected a number")
        number = payload[0] << 4 | payload[1] >> 4
        if is_msm(number):
            return self._observations(payload, number)
        if number in EPHEMERIS_MESSAGES:
            return [_ephemeris(payload, number, self._near_ns)]
        if number == GLONASS_MESSAGE:
            ephemeris = _glonass_ephemeris(payload, self._near_ns)
            self._channels[ephemeris.satellite & 255] = ephemeris.channel
            return [ephemeris]
        if number in (1005, 1006):
            return [_reference_station(payload, number)]
        self.not_read += 1
        return []

    def _observations(self, payload: bytes, number: int) -> list[RtcmResult]:
        message = read_msm(payload, number, self._near_ns, self._channels)
        if message is None:
            # The epoch may also end with a message of an unsupported system.
            self.not_read += 1
            station, more = msm_header(payload)
            return [] if more or station not in self._messages else [self._complete(station, complete=True)]
        self.unknown_signals += message.unknown_signals
        station, results = message.station_id, list[RtcmResult]()
        begun = self._messages.get(station)
        if begun and (begun[0].time_ns != message.time_ns or len(begun) == _MAX_MESSAGES):
            results.append(self._complete(station, complete=False))
        elif not begun and len(self._messages) == _MAX_STATIONS:
            results.append(self._complete(next(iter(self._messages)), complete=False))
        self._near_ns = message.time_ns
        self._messages.setdefault(station, []).append(message)
        if not message.more_follow:
            results.append(self._complete(station, complete=True))
        return results

    def _complete(self, station: int, *, complete: bool) -> BaseStationEpoch:
        messages = self._messages.pop(station)
        self.incomplete += not complete
        time_ns = messages[0].time_ns
        integers = np.concatenate([message.integers for message in messages], axis=1)
        floats = np.concatenate([message.floats for message in messages], axis=1)
        keys = (integers[0] << 16) + integers[1]
        if len(set(keys.tolist())) < keys.size:
            # A station may send one signal in two kinds of messages: the first one counts.
            rows = np.sort(np.unique(keys, return_index=True)[1])
            integers, floats, keys = integers[:, rows], floats[:, rows], keys[rows]
        observed, (lock_time_s, max_lock_s) = dict(zip(OBSERVABLES, floats, strict=False)), floats[4:]
        locks = self._locks.pop(station, None) or LossOfLockDetector()
        if len(self._locks) == _MAX_STATIONS:
            del self._locks[next(iter(self._locks))]
        self._locks[station] = locks
        loss_of_lock = locks.detect(
            time_ns,
            keys,
            has_phase=~np.isnan(observed["carrier_phase_cycles"]),
            min_lock_s=lock_time_s,
            max_lock_s=max_lock_s,
        )
        epoch = ObservationEpoch(
            time_ns=time_ns,
            satellite=integers[0],
            signal=integers[1],
            **observed,
            lock_time_s=lock_time_s,
            loss_of_lock=loss_of_lock,
            half_cycle=integers[2].astype(np.bool_),
        )
        return BaseStationEpoch(station_id=station, epoch=epoch, complete=complete)


def _glonass_ephemeris(payload: bytes, near_ns: int) -> GlonassEphemeris:
    layout, width = (_NUMBER_BITS, *GLONASS_LAYOUT), 8 * len(payload)
    fields = decode_layout(int.from_bytes(payload, "big"), width, layout, GLONASS_MESSAGE_FIELDS)
    if not 1 <= fields["satellite"] <= MAX_SATELLITE_NUMBER["R"]:
        raise ValueError(f"satellite {fields['satellite']} of R")
    return glonass_ephemeris_from_integers(
        fields, channel=fields["channel"] + GLONASS_CHANNELS.start, near_ns=near_ns
    )


def _integers(payload: bytes, layout: BitLayout, fields: Mapping[str, BitField]) -> dict[str, int]:
    bits = decode_layout(int.from_bytes(payload, "big"), 8 * len(payload), layout, fields)
    return combine_parts([bits], fields)


def _reference_station(payload: bytes, number: int) -> ReferenceStation:
    layout = _STATION if number == 1005 else (*_STATION, "height")
    integers = _integers(payload, layout, _STATION_FIELDS)
    x, y, z = (integers[axis] * 1e-4 for axis in "xyz")
    return ReferenceStation(
        station_id=integers["station_id"],
        position_ecef_m=(x, y, z),
        antenna_height_m=integers["height"] * 1e-4 if number == 1006 else None,
        is_virtual=bool(integers["is_virtual"]),
    )


def _ephemeris(payload: bytes, number: int, near_ns: int) -> Ephemeris:
    system, names, _ = EPHEMERIS_MESSAGES[number]
    fields = FIELDS[system]
    integers = _integers(payload, (_NUMBER_BITS, *names), fields)
    if not 1 <= integers["satellite"] <= MAX_SATELLITE_NUMBER[system]:
        raise ValueError(f"satellite {integers['satellite']} of {system}")
    for time in ("toe_s", "toc_s"):
        if integers[time] * fields[time].resolution * NS_PER_SECOND >= NS_PER_WEEK:
            raise ValueError(f"{time} is after the end of the week")
    ephemeris = ephemeris_from_integers(system, integers, near_ns)
    if number in _DATA_SOURCES:
        return replace(ephemeris, other={**ephemeris.other, "data_sources": _DATA_SOURCES[number]})
    return ephemeris
