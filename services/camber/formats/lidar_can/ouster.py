"""Lidar packets of Ouster's sensors, OS0, OS1, OS2 and OSDome: legacy, RNG19 (one or two returns), RNG15.

Source: "Lidar data packet format" and "Coordinate frames and XYZ calculation" of Ouster's firmware manual. A packet
is 16 columns; in each its time [ns], its place in the turn, whether it is valid, and for all beams range and
reflectivity. All beams of a column fire together. Of two returns the first, which is the stronger one, is taken. Points
are in the sensor frame: the lidar frame turned by the metadata's `lidar_to_sensor_transform`, x away from the plug.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.lidar_can.firings import Bools, Decoded, Firings, Int32, Int64, Refusal, accepted_packets
from camber.formats.lidar_can.ouster_metadata import COLUMNS_OF_PACKET, OusterMetadata

LIDAR_PACKET = 1  # "Lidar data packet format": packet type


@dataclass(frozen=True, slots=True, kw_only=True)
class _Profile:
    """Layout of a pixel; RNG profiles are `framed`: a header and a footer around a packet's columns."""

    bytes: int = 12
    range_type: str = "<u4"
    reflectivity_at: int = 4
    range_mask: int = 0x7FFFF
    range_m: float = 0.001
    framed: bool = True

    @property
    def pixel(self) -> np.dtype[Any]:
        offsets = [0, self.reflectivity_at]
        formats = [self.range_type, "u1"]
        names = ["range", "reflectivity"]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.bytes})


_PROFILES = {
    "LEGACY": _Profile(range_mask=0xFFFFF, framed=False),
    "RNG19_RFL8_SIG16_NIR16": _Profile(),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(bytes=16, reflectivity_at=3),
    "RNG15_RFL8_NIR8": _Profile(
        bytes=4, range_type="<u2", reflectivity_at=2, range_mask=0x7FFF, range_m=0.008
    ),
}


def packet_type(profile: str, beams: int) -> np.dtype[Any]:
    """Return a packet's layout: `columns` (16,) of `stamp_ns`, `place`, `status`, `pixels` (beams,)."""
    layout = _PROFILES[profile]
    pixels = ("pixels", layout.pixel, beams)
    fields: list[Any] = [("stamp_ns", "<u8"), ("place", "<u2")]
    if not layout.framed:
        fields += [("frame", "<u2"), ("encoder", "<u4"), pixels, ("status", "<u4")]
        return np.dtype([("columns", np.dtype(fields), COLUMNS_OF_PACKET)])
    header = [
        ("type", "<u2"),
        ("frame", "<u2"),
        ("session", "u1", 3),
        ("serial", "u1", 5),
        ("more", "u1", 20),
    ]
    columns = ("columns", np.dtype([*fields, ("status", "<u2"), pixels]), COLUMNS_OF_PACKET)
    return np.dtype([*header, columns, ("footer", "u1", 32)])


class OusterDecoder:
    """Packets of one sensor, by its metadata, as firings; any other packet is refused with a reason."""

    def __init__(self, metadata: OusterMetadata) -> None:
        self._metadata = metadata
        self._profile = _PROFILES[metadata.profile]
        self._beams = len(metadata.elevation_rad)
        self._packet = packet_type(metadata.profile, self._beams)
        self.interval_ns = round(1e9 / (metadata.columns * metadata.turns_hz))
        self.beam_after_ns: Int32 = np.zeros(self._beams, np.int32)
        self._direction, self._origin = _rays(metadata)
        self._last = (0, 0)  # position and stamp of the packet before
        self._wrong_rotation = False

    def decode(self, payloads: Sequence[bytes]) -> Decoded:
        """Decode packets in the order of arrival; stamps are nanoseconds of the sensor's clock."""
        decoded, packets, numbers = accepted_packets(payloads, self._refusal, self._packet)
        if not len(packets):
            self._wrong_rotation |= bool(decoded.wrong_rotation)
            return decoded
        columns = packets["columns"]
        first = self._valid(columns).argmax(axis=1)
        stamps = columns["stamp_ns"][np.arange(len(packets)), first]
        for number, stamp_ns in zip(numbers.tolist(), stamps.tolist(), strict=True):
            decoded.stamp_ns[number] = stamp_ns
        if self._profile.framed:
            decoded.session = int.from_bytes(packets[-1]["session"].tobytes(), "little")
        fits = self._fits(columns, numbers, sorted(decoded.wrong_rotation))
        misfit = (
            f"columns that are not {self.interval_ns} ns apart or not {self._metadata.columns} a turn: lidar_mode is"
            " not that of the metadata, or the motor is not at its speed"
        )
        for number in numbers[~fits].tolist():
            decoded.refuse(number, "turn", misfit)
        if fits.any():
            decoded.firings = self._firings(columns[fits], numbers[fits], stamps[fits])
        return decoded

    def _refusal(self, payload: bytes) -> Refusal:
        size, metadata = self._packet.itemsize, self._metadata
        if len(payload) != size:
            by = f"by the metadata ({self._beams} beams, {metadata.profile})"
            return "size", f"a packet of {len(payload)} bytes, expected {size} {by}"
        if self._profile.framed:
            kind = int.from_bytes(payload[:2], "little")
            if kind != LIDAR_PACKET:
                return "type", f"a packet of type {kind}, expected {LIDAR_PACKET} (lidar)"
            serial = int.from_bytes(payload[7:12], "little")
            if metadata.serial and serial != metadata.serial:
                return "model", f"a packet of sensor {serial}, the metadata are of {metadata.serial}"
        columns = np.frombuffer(payload, self._packet)[0]["columns"]
        valid = self._valid(columns)
        wrong = columns["place"][valid & (columns["place"] >= metadata.columns)]
        if len(wrong):
            return (
                "turn",
                f"column {wrong[0]}, expected one of {metadata.columns} (lidar_mode of the metadata)",
            )
        return None if valid.any() else ("empty", "a packet without a valid column")

    def _fits(self, columns: NDArray[Any], numbers: Int64, wrong_before: Sequence[int]) -> Bools:
        """Return which packets (p,) rotate as the metadata say: columns are as far apart in time as in position.

        `wrong_before` are the numbers of refused packets between them. Adjacent columns show it at
        once; positions that begin again too early or too late show it once a rotation. From then on nothing is accepted
        until positions have begun again at the right time.
        """
        valid = self._valid(columns)
        place, stamp = columns["place"].astype(np.int64), columns["stamp_ns"].astype(np.int64)
        turn_ns = self._metadata.columns * self.interval_ns
        apart_ns = np.diff(place, axis=1) % self._metadata.columns * self.interval_ns
        pairs = valid[:, 1:] & valid[:, :-1]
        alike = pairs & _alike(apart_ns, np.diff(stamp, axis=1))
        fits: Bools = 2 * alike.sum(axis=1) >= pairs.sum(axis=1)
        rows, first = np.arange(len(columns)), valid.argmax(axis=1)
        begins = zip(place[rows, first].tolist(), stamp[rows, first].tolist(), strict=True)
        passed = np.searchsorted(wrong_before, numbers)
        for k, (at, at_ns) in enumerate(begins):
            self._wrong_rotation |= bool(passed[k] > (passed[k - 1] if k else 0))
            (before, before_ns), self._last = self._last, (at, at_ns)
            if at < before and 0 < at_ns - before_ns < turn_ns:
                on_ns = (at - before) % self._metadata.columns * self.interval_ns
                self._wrong_rotation = not _alike(on_ns, at_ns - before_ns)
            fits[k] &= not self._wrong_rotation
        self._wrong_rotation |= bool(len(wrong_before) > passed[-1])
        return fits

    def _valid(self, columns: NDArray[Any]) -> Bools:
        status = columns["status"]
        valid: Bools = status & 1 != 0 if self._profile.framed else status == 0xFFFF_FFFF
        return valid

    def _firings(self, columns: NDArray[Any], numbers: Int64, stamps: NDArray[np.uint64]) -> Firings:
        valid = self._valid(columns)
        after = (columns["stamp_ns"] - stamps[:, None]).view(np.int64)
        # A column whose time is far from the others of its packet is damaged.
        limit_ns = 100 * COLUMNS_OF_PACKET * self.interval_ns
        valid &= (after > -limit_ns) & (after < limit_ns)
        flat = columns[valid]
        place = flat["place"].astype(np.int64)
        steps = (flat["pixels"]["range"] & self._profile.range_mask).astype(np.float64)
        distance = steps * self._profile.range_m
        points = (self._direction[place] * distance[:, :, None] + self._origin[place]).astype(np.float32)
        return Firings(
            packet=np.repeat(numbers, valid.sum(axis=1)),
            after_ns=after[valid],
            turn=place / self._metadata.columns,
            points_m=points,
            intensity=flat["pixels"]["reflectivity"].astype(np.float32),
            returned=distance != 0.0,
        )


def _alike(expected_ns: Any, measured_ns: Any) -> Any:
    """Whether within a quarter: a motor at its speed never differs by that much, another mode always."""
    return abs(measured_ns - expected_ns) <= expected_ns / 4.0


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
