"""Data packets of Velodyne's sensors: VLP-16 (also Puck LITE), Puck Hi-Res, HDL-32E, VLP-32C.

Source: the sensors' user manuals, chapter "Sensor Data" (VLP-16 63-9243, VLP-32C 63-9325, HDL-32E 63-9113). A packet is
1,206 bytes: twelve blocks of a flag, an azimuth in 0.01° and 32 × (distance, reflectivity), then microseconds since the
hour, the return mode and the model. The azimuth is that of the block's first firing, clockwise from the sensor's y;
here that axis is x, forward. Of two returns the last one is taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.lidar_can.firings import (
    Bools,
    Decoded,
    Firings,
    Float64,
    Int32,
    Int64,
    Refusal,
    accepted_packets,
    joined,
)
from camber.geodesy.gps_time import NS_PER_SECOND

# The manuals, "Sensor Data": packet, flag of a block, units of azimuth.
PACKET_BYTES, BLOCK_FLAG = 1206, 0xEEFF
HOUR_NS = 3600 * NS_PER_SECOND  # unit
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
_FLAG = b"\xff\xee"
_FLAGS = {_FLAG, b"\xff\xdd", b"\xff\xcc", b"\xff\xbb"}  # the others: sensors with more than 32 lasers
_BLOCKS, _CHANNELS, _TURN = 12, 32, 36_000
_FASTEST_BLOCK = 500  # 5° in one block: no sensor turns so fast
BLOCK = np.dtype(
    [("flag", "<u2"), ("azimuth", "<u2"), ("beams", [("distance", "<u2"), ("brightness", "u1")], 32)]
)
PACKET = np.dtype([("blocks", BLOCK, _BLOCKS), ("stamp_us", "<u4"), ("mode", "u1"), ("model", "u1")])


@dataclass(frozen=True, slots=True, kw_only=True)
class VelodyneModel:
    """A model, its beams (b,) in the order of the packet; lasers fire `together` at a time, each `beam_ns` later."""

    name: str
    code: int
    elevation_deg: tuple[float, ...]
    azimuth_deg: tuple[float, ...] = ()
    up_mm: tuple[float, ...] = ()
    firing_ns: float = 55_296.0
    beam_ns: float = 2_304.0
    together: int = 1
    step_m: float = 0.002

    @property
    def beam_after_ns(self) -> Float64:
        """When each beam fires after its firing's time (b,)."""
        fired = np.arange(len(self.elevation_deg)) // self.together
        return fired.astype(np.float64) * self.beam_ns


_ODD, _EVEN = tuple(range(1, 16, 2)), tuple(range(-15, 0, 2))
_UP_16 = (11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2)
_HI_RES_MM = (7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7, 3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4)
_HI_RES = (-10.0, -8.67, -7.33, -6.0, -4.67, -3.33, -2.0, -0.67)
_VLP_32C = (
    (-25.0, 1.4), (-1.0, -4.2), (-1.667, 1.4), (-15.639, -1.4), (-11.31, 1.4), (0.0, -1.4), (-0.667, 4.2),
    (-8.843, -1.4), (-7.254, 1.4), (0.333, -4.2), (-0.333, 1.4), (-6.148, -1.4), (-5.333, 4.2), (1.333, -1.4),
    (0.667, 4.2), (-4.0, -1.4), (-4.667, 1.4), (1.667, -4.2), (1.0, 1.4), (-3.667, -4.2), (-3.333, 4.2),
    (3.333, -1.4), (2.333, 1.4), (-2.667, -1.4), (-3.0, 1.4), (7.0, -1.4), (4.667, 1.4), (-2.333, -4.2),
    (-2.0, 4.2), (15.0, -1.4), (10.333, 1.4), (-1.333, -1.4),
)  # fmt: skip
_HDL_32E = tuple(e / 3.0 for k in range(16) for e in (-92.0 + 4.0 * k, -28.0 + 4.0 * k))
_UP_32E = tuple(-29.0 * math.tan(math.radians(elevation)) for elevation in _HDL_32E)
"""Lasers are 29 mm from the axis, from which distances count: maker's viewer; the manual does not state it."""


def _alternating(first: tuple[float, ...], second: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(one) for pair in zip(first, second, strict=True) for one in pair)


_VLP_32C_ELEVATION, _VLP_32C_AZIMUTH = zip(*_VLP_32C, strict=True)
MODELS = {
    model.name: model
    for model in (
        VelodyneModel(name="VLP-16", code=0x22, elevation_deg=_alternating(_EVEN, _ODD), up_mm=_UP_16),
        VelodyneModel(
            name="Puck Hi-Res",
            code=0x24,
            elevation_deg=_alternating(_HI_RES, tuple(-e for e in reversed(_HI_RES))),
            up_mm=_HI_RES_MM,
        ),
        VelodyneModel(
            name="HDL-32E",
            code=0x21,
            elevation_deg=_HDL_32E,
            up_mm=_UP_32E,
            firing_ns=46_080.0,
            beam_ns=1_152.0,
        ),
        VelodyneModel(
            name="VLP-32C",
            code=0x28,
            elevation_deg=_VLP_32C_ELEVATION,
            azimuth_deg=_VLP_32C_AZIMUTH,
            together=2,
            step_m=0.004,
        ),
    )
}
"""The supported models by name."""
_NAMES = {model.code: name for name, model in MODELS.items()} | {
    0xA1: "VLS-128",
    0x63: "VLS-128",
    0x31: "Velarray",
}


class VelodyneDecoder:
    """Packets of one model as firings; any other packet is refused with a reason.

    Sweeps begin where the azimuth, clockwise from straight ahead, passes `seam_deg`.
    """

    def __init__(self, model: VelodyneModel, seam_deg: float = 180.0) -> None:
        self._model, self._seam = model, seam_deg / 360.0
        self._beams = len(model.elevation_deg)
        self._per_block = _CHANNELS // self._beams
        self.interval_ns = round(model.firing_ns)
        self.beam_after_ns: Int32 = np.rint(model.beam_after_ns).astype(np.int32)
        elevation = np.radians(model.elevation_deg)
        self._flat, self._up = np.cos(elevation), np.sin(elevation)
        self._azimuth = np.radians(model.azimuth_deg or (0.0,) * self._beams)
        self._up_m = np.array(model.up_mm or (0.0,) * self._beams) / 1000.0

    def decode(self, payloads: Sequence[bytes]) -> Decoded:
        """Decode packets in the order of arrival; stamps are nanoseconds since the hour."""
        decoded, packets, numbers = accepted_packets(payloads, self._refusal, PACKET)
        if not len(packets):
            return decoded
        for number, stamp_us in zip(numbers.tolist(), packets["stamp_us"].tolist(), strict=True):
            decoded.stamp_ns[number] = stamp_us * 1000
        rotating = _rotating(packets)
        for number in numbers[~rotating].tolist():
            decoded.refuse(number, "azimuth", "azimuths that no turning sensor has")
        packets, numbers = packets[rotating], numbers[rotating]
        single = packets["mode"] != DUAL
        parts = [
            self._firings(packets[rows], numbers[rows], blocks)
            for rows, blocks in ((single, slice(None)), (~single, slice(0, None, 2)))
            if rows.any()
        ]
        if parts:
            decoded.firings = parts[0] if len(parts) == 1 else joined(parts)
        return decoded

    def _refusal(self, payload: bytes) -> Refusal:
        if len(payload) != PACKET_BYTES:
            return "size", f"a packet of {len(payload)} bytes, expected {PACKET_BYTES}"
        mode, code = payload[1204], payload[1205]
        flags = {payload[at : at + 2] for at in range(0, 1200, 100)}
        if code != self._model.code and flags <= _FLAGS:
            name = _NAMES.get(code, "a model that is not known")
            return "model", f"a packet of {name} (0x{code:02X}), expected {self._model.name}"
        if flags != {_FLAG}:
            wrong_flag = min(flags - {_FLAG}).hex(" ").upper()
            return "flag", f"a block that begins with {wrong_flag}, expected FF EE"
        if mode not in (STRONGEST, LAST, DUAL):
            return "mode", f"return mode 0x{mode:02X}, expected strongest, last or dual (0x37, 0x38, 0x39)"
        if int.from_bytes(payload[1200:1204], "little") >= 3_600_000_000:
            return "stamp", "a time of an hour or more since the hour"
        return None

    def _firings(self, packets: Any, numbers: Int64, blocks: slice) -> Firings:
        """`blocks`: all, or with two returns per firing those of the last return."""
        part = packets["blocks"][:, blocks]
        n, b = part.shape
        per = self._per_block
        azimuth = part["azimuth"].astype(np.float64)
        # Rotation within a block: from all steps of the packet, but for those over a sector that is not measured.
        steps = np.diff(azimuth, axis=1) % _TURN
        even = steps <= 2.0 * np.median(steps, axis=1, keepdims=True)
        turned = (steps * even).sum(axis=1) / even.sum(axis=1)
        block_ns = per * self._model.firing_ns
        per_ns = turned / block_ns
        # A packet that is not full at the begin of a sector that is not measured is filled up after it.
        blocks_on = np.ones(steps.shape)
        np.divide(steps, turned[:, None], out=blocks_on, where=~even & (turned[:, None] > 0.0))
        block_at_ns = np.zeros((n, b))
        np.cumsum(blocks_on * block_ns, axis=1, out=block_at_ns[:, 1:])
        firing = np.arange(b * per)
        begins = np.repeat(azimuth, per, axis=1) + per_ns[:, None] * (firing % per * self._model.firing_ns)
        after = self._model.beam_after_ns
        angle = np.radians((begins[:, :, None] + per_ns[:, None, None] * after) / 100.0) + self._azimuth
        beams = part["beams"].reshape(n, b * per, self._beams)
        distance = beams["distance"].astype(np.float64) * self._model.step_m
        flat = distance * self._flat
        points = np.empty((n, b * per, self._beams, 3), np.float32)
        points[..., 0] = flat * np.cos(angle)
        points[..., 1] = -flat * np.sin(angle)
        points[..., 2] = distance * self._up + self._up_m
        after_ns = np.repeat(block_at_ns, per, axis=1) + firing % per * self._model.firing_ns
        return Firings(
            packet=np.repeat(numbers, b * per),
            after_ns=np.rint(after_ns).astype(np.int64).reshape(-1),
            turn=((begins.reshape(-1) / _TURN) - self._seam) % 1.0,
            points_m=points.reshape(-1, self._beams, 3),
            intensity=beams["brightness"].reshape(-1, self._beams).astype(np.float32),
            returned=beams["distance"].reshape(-1, self._beams) != 0,
        )


def _rotating(packets: Any) -> Bools:
    """Return which packets (n,) have azimuths of a rotating or a standing sensor."""
    azimuth = packets["blocks"]["azimuth"].astype(np.int64)
    # In dual mode two blocks each have the same azimuth.
    steps = (azimuth[:, 2:] - azimuth[:, :-2]) % _TURN
    rotating: Bools = (azimuth.max(axis=1) < _TURN) & (np.median(steps, axis=1) <= 2 * _FASTEST_BLOCK)
    return rotating
