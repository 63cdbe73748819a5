"""Lidar packets of Ouster's sensors, OS0, OS1, OS2 and OSDome: legacy, RNG19 (one or two returns), RNG15.

Source: "Lidar data packet format" and "Coordinate frames and XYZ calculation" of Ouster's firmware manual. A packet
is 16 columns; in each its time [ns], its place in the turn, whether it is valid, and for all beams range and
reflectivity. All beams of a column fire together. Of two returns the stronger one, which stands first, is taken. Points
are in the sensor frame: the lidar frame turned by the metadata's `lidar_to_sensor_transform`, x away from the plug.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.lidar_can.firings import Bools, Decoded, Firings, Int32
from camber.formats.lidar_can.ouster_metadata import COLUMNS_OF_PACKET, OusterMetadata

LIDAR_PACKET = 1


@dataclass(frozen=True, slots=True)
class _Profile:
    """Where things stand; `header` and `footer` frame a packet's columns, RNG formats have both."""

    pixel: np.dtype[Any]
    range_mask: int
    range_m: float
    framed: bool = True


def _pixel(size: int, range_type: str, reflectivity: str, at: int) -> np.dtype[Any]:
    return np.dtype(
        {
            "names": ["range", "reflectivity"],
            "formats": [range_type, reflectivity],
            "offsets": [0, at],
            "itemsize": size,
        }
    )


_PROFILES = {
    "LEGACY": _Profile(_pixel(12, "<u4", "u1", 4), 0xFFFFF, 0.001, framed=False),
    "RNG19_RFL8_SIG16_NIR16": _Profile(_pixel(12, "<u4", "u1", 4), 0x7FFFF, 0.001),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(_pixel(16, "<u4", "u1", 3), 0x7FFFF, 0.001),
    "RNG15_RFL8_NIR8": _Profile(_pixel(4, "<u2", "u1", 2), 0x7FFF, 0.008),
}


def packet_type(profile: str, beams: int) -> np.dtype[Any]:
    """A packet as numpy has it: `columns` (16,) of `stamp_ns`, `place`, `status`, `pixels` (beams,)."""
    one = _PROFILES[profile]
    fields: list[Any] = [("stamp_ns", "<u8"), ("place", "<u2")]
    if one.framed:
        fields += [("status", "<u2"), ("pixels", one.pixel, beams)]
    else:
        fields += [("frame", "<u2"), ("encoder", "<u4"), ("pixels", one.pixel, beams), ("status", "<u4")]
    columns = ("columns", np.dtype(fields), COLUMNS_OF_PACKET)
    if not one.framed:
        return np.dtype([columns])
    header = [
        ("type", "<u2"),
        ("frame", "<u2"),
        ("session", "u1", 3),
        ("serial", "u1", 5),
        ("more", "u1", 20),
    ]
    return np.dtype([*header, columns, ("footer", "u1", 32)])


class OusterDecoder:
    """Packets of one sensor, by its metadata, as firings; what is no packet of it is refused by its reason."""

    def __init__(self, metadata: OusterMetadata) -> None:
        self._metadata = metadata
        self._profile = _PROFILES[metadata.profile]
        self._beams = len(metadata.elevation_rad)
        self._packet = packet_type(metadata.profile, self._beams)
        self.interval_ns = round(1e9 / (metadata.columns * metadata.turns_hz))
        self.beam_after_ns: Int32 = np.zeros(self._beams, np.int32)
        self._direction, self._origin = _rays(metadata)
        self._last = (0, 0)  # place and stamp of the packet before
        self._turns_otherwise = False
        self._misfit = (
            f"columns that are not {self.interval_ns} ns apart or not {metadata.columns} a turn: lidar_mode is not that"
            " of the metadata, or the motor is not at its speed"
        )

    def decode(self, payloads: Sequence[bytes]) -> Decoded:
        """Of packets as they arrived; stamps are nanoseconds since whatever the sensor's clock counts from."""
        refused: Counter[str] = Counter()
        details: dict[str, str] = {}
        stamps: list[int | None] = []
        kept: list[tuple[int, NDArray[Any]]] = []
        session: int | None = None
        otherwise: list[int] = []
        for number, payload in enumerate(payloads):
            reason, words = self._refusal(payload)
            stamp_ns = None
            if not reason:
                packet = np.frombuffer(payload, self._packet)
                valid = self._valid(packet[0]["columns"])
                if valid.any():
                    stamp_ns = int(packet[0]["columns"]["stamp_ns"][valid][0])
                    kept.append((number, packet))
                    if self._profile.framed:
                        session = int.from_bytes(packet[0]["session"].tobytes(), "little")
                else:
                    reason, words = "empty", "a packet without a valid column"
            if reason:
                refused[reason] += 1
                details[reason] = words
            if reason == "turn":
                otherwise.append(number)
            stamps.append(stamp_ns)
        if not kept:
            self._turns_otherwise |= bool(otherwise)
            return Decoded(stamps, None, refused, details, otherwise=frozenset(otherwise))
        packets = np.concatenate([packet for _, packet in kept])
        numbers = np.array([number for number, _ in kept], np.int64)
        fits = self._fits(packets, numbers, otherwise)
        if not fits.all():
            refused["turn"] += int((~fits).sum())
            details["turn"] = self._misfit
            for number in numbers[~fits].tolist():
                stamps[number] = None
            otherwise += numbers[~fits].tolist()
            packets, numbers = packets[fits], numbers[fits]
        if not len(packets):
            return Decoded(stamps, None, refused, details, session, frozenset(otherwise))
        firings = self._firings(packets, numbers, np.array([stamps[number] for number in numbers], np.uint64))
        return Decoded(stamps, firings, refused, details, session, frozenset(otherwise))

    def _refusal(self, payload: bytes) -> tuple[str, str]:
        size = self._packet.itemsize
        if len(payload) != size:
            profile = self._metadata.profile
            return (
                "size",
                f"a packet of {len(payload)} bytes, expected {size} by the metadata ({self._beams} beams, {profile})",
            )
        if self._profile.framed:
            kind = int.from_bytes(payload[:2], "little")
            if kind != LIDAR_PACKET:
                return "type", f"a packet of type {kind}, expected {LIDAR_PACKET} (lidar)"
            serial = int.from_bytes(payload[7:12], "little")
            if self._metadata.serial and serial != self._metadata.serial:
                return "model", f"a packet of sensor {serial}, the metadata are of {self._metadata.serial}"
        places = np.frombuffer(payload, self._packet)[0]["columns"]
        wrong = self._valid(places) & (places["place"] >= self._metadata.columns)
        if wrong.any():
            place = int(places["place"][wrong][0])
            return (
                "turn",
                f"column {place}, expected one of {self._metadata.columns} (lidar_mode of the metadata)",
            )
        return "", ""

    def _fits(self, packets: NDArray[Any], numbers: NDArray[np.int64], otherwise: list[int]) -> Bools:
        """Of packets (p,) those that turn as the metadata say: their columns are as far apart in time as in place.

        `otherwise` are numbers of those between them that cannot be of such a sensor.

        Of columns that are next to one another it is seen at once; that places begin anew too early or too late, once
        a turn, where they do. From then on nothing is taken until they have once begun anew at the right time.
        """
        columns = packets["columns"]
        valid = self._valid(columns)
        place, stamp = columns["place"].astype(np.int64), columns["stamp_ns"].astype(np.int64)
        turn_ns = self._metadata.columns * self.interval_ns
        apart_ns = np.diff(place, axis=1) % self._metadata.columns * self.interval_ns
        pairs = valid[:, 1:] & valid[:, :-1]
        alike = pairs & _alike(apart_ns, np.diff(stamp, axis=1))
        fits: Bools = 2 * alike.sum(axis=1) >= pairs.sum(axis=1)
        rows, first = np.arange(len(packets)), valid.argmax(axis=1)
        begins = zip(place[rows, first].tolist(), stamp[rows, first].tolist(), strict=True)
        passed = np.searchsorted(otherwise, numbers)
        for k, (at, at_ns) in enumerate(begins):
            self._turns_otherwise |= bool(passed[k] > (passed[k - 1] if k else 0))
            (before, before_ns), self._last = self._last, (at, at_ns)
            if at < before and 0 < at_ns - before_ns < turn_ns:
                on_ns = (at - before) % self._metadata.columns * self.interval_ns
                self._turns_otherwise = not _alike(on_ns, at_ns - before_ns)
            fits[k] &= not self._turns_otherwise
        self._turns_otherwise |= bool(len(otherwise) > passed[-1])
        return fits

    def _valid(self, columns: NDArray[Any]) -> Bools:
        valid: Bools = (
            columns["status"] & 1 != 0 if self._profile.framed else columns["status"] == 0xFFFF_FFFF
        )
        return valid

    def _firings(
        self, packets: NDArray[Any], numbers: NDArray[np.int64], stamps: NDArray[np.uint64]
    ) -> Firings:
        columns = packets["columns"]
        valid = self._valid(columns)
        after = (columns["stamp_ns"] - stamps[:, None]).view(np.int64)
        # A column that claims to be far from the others of its packet is damaged.
        limit_ns = 100 * COLUMNS_OF_PACKET * self.interval_ns
        valid &= (after > -limit_ns) & (after < limit_ns)
        flat = columns[valid]
        place = flat["place"].astype(np.int64)
        distance = (flat["pixels"]["range"] & self._profile.range_mask).astype(
            np.float64
        ) * self._profile.range_m
        points = (self._direction[place] * distance[:, :, None] + self._origin[place]).astype(np.float32)
        return Firings(
            np.repeat(numbers, valid.sum(axis=1)),
            after[valid],
            place / self._metadata.columns,
            points,
            flat["pixels"]["reflectivity"].astype(np.float32),
            distance != 0.0,
        )


def _alike(expected_ns: Any, found_ns: Any) -> Any:
    """Within a quarter: what a motor that is at its speed never differs by, and another mode always."""
    return abs(found_ns - expected_ns) <= expected_ns / 4.0


def _rays(metadata: OusterMetadata) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions and origins (columns, beams, 3) in the sensor frame: point = direction × range + origin."""
    encoder = 2.0 * np.pi * (1.0 - np.arange(metadata.columns) / metadata.columns)
    azimuth = encoder[:, None] - metadata.azimuth_rad
    level = np.cos(metadata.elevation_rad)
    up = np.broadcast_to(np.sin(metadata.elevation_rad), azimuth.shape)
    direction = np.stack((np.cos(azimuth) * level, np.sin(azimuth) * level, up), axis=-1)
    out, rise = metadata.beam_to_lidar[0, 3], metadata.beam_to_lidar[2, 3]
    origin = -np.hypot(out, rise) * direction
    origin[..., 0] += np.cos(encoder)[:, None] * out
    origin[..., 1] += np.sin(encoder)[:, None] * out
    origin[..., 2] += rise
    rotation, shift = metadata.lidar_to_sensor[:3, :3], metadata.lidar_to_sensor[:3, 3]
    return direction @ rotation.T, origin @ rotation.T + shift
