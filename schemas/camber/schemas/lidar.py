"""Sweeps of a surround sensor."""

from __future__ import annotations

from typing import Annotated

from camber.schemas.base import ArrayOf, Float32, Int32, Message, Name


class Sweep(Message):
    """One sweep; points in the sensor's frame, in the order they were measured.

    `time_ns` is that of the sweep's end, `offset_ns` (≤ 0) that of each point against it.
    """

    sensor: Name
    points_m: Annotated[Float32, ArrayOf("<f4", ("points", 3))]
    intensity: Annotated[Float32, ArrayOf("<f4", ("points",))]
    offset_ns: Annotated[Int32, ArrayOf("<i4", ("points",))]
