"""Height of the antenna above the road."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from camber.schemas.base import Message, Model, Sigma, Text

HeightMethod = Literal["fixed", "stroke", "ranging", "scan_matching"]


class HeightByMethod(Model):
    """The height by one method."""

    way: HeightMethod
    height_m: Annotated[float, Field(ge=-1.0, le=100.0)]
    sigma_m: Sigma


class AntennaHeight(Message):
    """`h_a` of JP7707657B2: height of the antenna above the road, by the chosen method, and by the other methods."""

    status: Literal["known", "unknown", "disagreement"]
    reason: Text = ""
    way: HeightMethod | None = None
    height_m: Annotated[float, Field(ge=-1.0, le=100.0)] | None = None
    sigma_m: Sigma | None = None
    others: tuple[HeightByMethod, ...] = Field((), max_length=8)
