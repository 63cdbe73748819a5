"""The faults, by name: what all fixes have in common that is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Scene = Literal["country", "open-sky", "city"]
"""`country` has no LiDAR; the others are the scenarios of those names with 32 beams."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonFault:
    """From `onset_s` on each fix is off by one vector, which may grow.

    `along_m_s`: the fix is that much farther along the vehicle's own path for each second; `across_m_s`: to its left.
    `east_m`, `north_m`: a base's coordinate. `along_m`: the same, along the heading at the onset. Heights stay those of
    the true place; with `height_of_road` they are those of the road where the fix is, as counterfeit signals can make
    them for one who has the map. `given`: the drive begins with a given pose. `named_within_s` is required on hilly
    ground, None: no time is.
    """

    name: str
    text: str
    onset_s: float = 0.0
    along_m_s: float = 0.0
    across_m_s: float = 0.0
    east_m: float = 0.0
    north_m: float = 0.0
    along_m: float = 0.0
    height_of_road: bool = False
    given: bool = True
    scene: Scene = "country"
    named_within_s: float | None = None


ONSET_S = 240.0
"""Chosen: after more than 2 km of driving, by when relief has had its time."""
_ONSET_OF_LIDAR_S = 20.0  # chosen: matches or none, a minute of sweeps costs minutes

CASES: tuple[CommonFault, ...] = (
    CommonFault(name="none", text="no fault", onset_s=ONSET_S),
    CommonFault(name="along-0.02", text="led away along the road, 0.02 m/s", onset_s=ONSET_S, along_m_s=0.02),
    CommonFault(name="along-0.05", text="led away along the road, 0.05 m/s", onset_s=ONSET_S, along_m_s=0.05),
    CommonFault(
        name="along-0.3",
        text="led away along the road, 0.3 m/s",
        onset_s=ONSET_S,
        along_m_s=0.3,
        named_within_s=20.0,
    ),
    CommonFault(
        name="across-0.05",
        text="led away across the road, 0.05 m/s",
        onset_s=ONSET_S,
        across_m_s=0.05,
        named_within_s=60.0,
    ),
    CommonFault(
        name="base-1.7",
        text="base 1.7 m north from the start, no given pose",
        north_m=1.7,
        given=False,
        named_within_s=300.0,
    ),
    CommonFault(
        name="base-12",
        text="base 12 m off along the road",
        onset_s=ONSET_S,
        along_m=12.0,
        named_within_s=120.0,
    ),
    CommonFault(
        name="base-12-start",
        text="base 12 m off along the road from the start, no given pose",
        along_m=12.0,
        given=False,
        named_within_s=120.0,
    ),
    CommonFault(
        name="along-0.05-road",
        text="led away along the road, 0.05 m/s, with the height of the road there",
        onset_s=ONSET_S,
        along_m_s=0.05,
        height_of_road=True,
    ),
    CommonFault(
        name="along-0.3-road",
        text="led away along the road, 0.3 m/s, with the height of the road there",
        onset_s=ONSET_S,
        along_m_s=0.3,
        height_of_road=True,
        named_within_s=20.0,
    ),
    CommonFault(
        name="open-sky-lidar",
        text="open sky, LiDAR that does not converge, along the road, 0.05 m/s",
        onset_s=_ONSET_OF_LIDAR_S,
        along_m_s=0.05,
        scene="open-sky",
    ),
    CommonFault(
        name="city-lidar",
        text="city with LiDAR, along the road, 0.05 m/s",
        onset_s=_ONSET_OF_LIDAR_S,
        along_m_s=0.05,
        scene="city",
    ),
    CommonFault(name="city-none", text="city with LiDAR, no fault", onset_s=_ONSET_OF_LIDAR_S, scene="city"),
)
BY_NAME = {case.name: case for case in CASES}
