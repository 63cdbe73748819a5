"""Fixes along a road, right ones and others, to the judge of their own track: on `boreas-tracks`, and on made-up hills.

The fixes are one a second. `PYTHONPATH=tests python -m support.fix_track_drives` prints the table of
docs/theory/relief.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.integrity.learning.fix_track_offset import (
    JudgedTrackOffset,
    TrackFault,
    TrackFaultRules,
    TrackFaults,
)
from camber.integrity.learning.height_residual import track_offset_of
from camber.localizer.filter.track import TrackPoint
from camber.localizer.fix_track import FixTrack
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.schemas.gnss import Fix
from camber.schemas.pose import FixesOffset, Road
from support.boreas_relief import DAYS, MAP_SIGMA_M, ProfileMap, track
from support.made_up_relief import Hills

Floats = NDArray[np.float64]
FRAME = LocalFrame(math.radians(43.78), math.radians(-79.46), 0.0)
ANTENNA_M = 1.8
Vector = Callable[[float, float, float], tuple[float, float]]
"""East and north (m) of a fix less the truth, from seconds, path (m) and heading (rad)."""
RoadHeights = Callable[[float, float, float], tuple[float, float, float]]
"""Elevation and slopes east and north at east and north (m), driven in a direction (rad); NaN: not known."""


class DrivenRoad(NamedTuple):
    """A place every few metres: time (s), path, east, north, height by the fix (m), heading (rad)."""

    time_s: Floats
    path_m: Floats
    east_m: Floats
    north_m: Floats
    height_m: Floats
    heading_rad: Floats


@dataclass
class _Path:
    """Stands for the localizer's driven track."""

    path_m: float = 0.0

    def at(self, time_ns: int) -> TrackPoint:
        return TrackPoint(path_m=self.path_m)


def offsets(drive: DrivenRoad, road: RoadHeights, fault: Vector) -> Iterator[tuple[float, FixesOffset]]:
    """Send a drive's fixes through the localizer's `FixTrack`: its estimates and the path (m) where each was
    made."""
    fixes, path = FixTrack(HeightErrorModel(), antenna_z_m=ANTENNA_M), _Path()
    last: FixesOffset | None = None
    fix_s = -math.inf
    for time_s, path_m, east_m, north_m, height_m, heading in zip(
        *(row.tolist() for row in drive), strict=True
    ):
        off = fault(time_s, path_m, heading)
        place = FRAME.geodetic_from_east_north(east_m + off[0], north_m + off[1], 0.0)[:2]
        below = _road(*road(east_m + off[0], north_m + off[1], heading))
        fixes.note_road(*place, below)
        if time_s - fix_s < 1.0:
            continue
        fix_s, path.path_m = time_s, path_m
        fixes.on_fix(_fix(time_s, *place, height_m), path, below)  # type: ignore[arg-type]
        new = fixes.offset
        if new is not None and new is not last:
            yield path_m, new
        last = new


def _fix(time_s: float, latitude_rad: float, longitude_rad: float, height_m: float) -> Fix:
    return Fix(
        time_ns=round(1e9 * time_s) + 10**18,
        fix_id=round(10.0 * time_s),
        origin="receiver",
        quality="fixed",
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=height_m,
        covariance_enu_m2=(4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-4),
    )


def _road(elevation_m: float, slope_east: float, slope_north: float) -> Road:
    if not math.isfinite(elevation_m):
        return Road(status="unknown", reason="no_surface", datum="WGS84", map_version=1)
    return Road(
        status="known",
        surface_id=1,
        elevation_m=elevation_m,
        sigma_m=MAP_SIGMA_M,
        slope_east=slope_east,
        slope_north=slope_north,
        datum="WGS84",
        map_version=1,
    )


def judged(
    drive: DrivenRoad, road: RoadHeights, fault: Vector
) -> tuple[tuple[float, JudgedTrackOffset] | None, float]:
    """Return the first fault that is named, with the path (m) where it is, and the largest χ² of an offset."""
    judge, most = TrackFaults(TrackFaultRules()), 0.0
    for path_m, offset in offsets(drive, road, fault):
        of_judge = track_offset_of(offset)
        judge.update(of_judge, "base")
        most = max(most, of_judge.chi2(judge.rules.common_sigma_m))
        if judge.fault is not None:
            return (path_m - float(drive.path_m[0]), judge.fault), most
    return None, most


def boreas(
    map_day: str, drive_day: str, *, from_m: float = 0.0, to_m: float = math.inf
) -> tuple[DrivenRoad, RoadHeights]:
    """Return a part of one day's drive every 2 m or second, and the other day's profile as the road."""
    drive = track(drive_day)
    kept = np.flatnonzero((drive.path_m >= from_m) & (drive.path_m < to_m))
    rows: list[int] = []
    for k in kept.tolist():
        if (
            not rows
            or drive.path_m[k] - drive.path_m[rows[-1]] >= 2.0
            or drive.time_s[k] - drive.time_s[rows[-1]] >= 1.0
        ):
            rows.append(k)
    profile = ProfileMap(track(map_day), drive)
    origin = float(drive.east_m[0]), float(drive.north_m[0])

    def road(east_m: float, north_m: float, heading_rad: float) -> tuple[float, float, float]:
        at = profile.at(
            np.array([heading_rad]), np.array([east_m + origin[0]]), np.array([north_m + origin[1]])
        )
        return float(at.elevation_m[0]), float(at.slope_east[0]), float(at.slope_north[0])

    columns = drive.time_s, drive.path_m, drive.east_m - origin[0], drive.north_m - origin[1]
    height_m = drive.height_m + ANTENNA_M
    return DrivenRoad(*(column[rows] for column in (*columns, height_m, drive.heading_rad))), road


def over_hills(field: Hills, seed: int, *, length_m: float = 2500.0) -> tuple[DrivenRoad, RoadHeights]:
    """Return a bending road at 10 m/s over a height field, with errors of map and fixes drawn from the model."""
    rng, model = np.random.default_rng(seed), HeightErrorModel()
    path = np.arange(0.0, length_m, 5.0)
    heading = 0.8 * np.sin(path / 300.0) + path / 1500.0
    east, north = 5.0 * np.cumsum(np.cos(heading)), 5.0 * np.cumsum(np.sin(heading))
    places, time_s = np.column_stack([east, north]), 0.1 * path
    errors = model.covariance(
        places, time_s, map_sigma_m=np.full(len(path), MAP_SIGMA_M), fix_sigma_m=np.full(len(path), 0.005)
    )
    noise = np.linalg.cholesky(errors) @ rng.standard_normal(len(path))
    height = field.at(east, north).elevation_m + noise + ANTENNA_M

    def road(east_m: float, north_m: float, heading_rad: float) -> tuple[float, float, float]:
        at = field.at(np.array([east_m]), np.array([north_m]))
        return float(at.elevation_m[0]), float(at.slope_east[0]), float(at.slope_north[0])

    return DrivenRoad(time_s, path, east, north, height, heading), road


def base_off(size_m: float, yaw_rad: float) -> Vector:
    """Return the fault of a base that is off in a direction."""
    east_m, north_m = size_m * math.cos(yaw_rad), size_m * math.sin(yaw_rad)
    return lambda time_s, path_m, heading_rad: (east_m, north_m)


def led_away(along_m_s: float, across_m_s: float, from_s: float) -> Vector:
    """Return the fault of fixes that are led away along and to the left of the driven direction, from a time."""

    def fault(time_s: float, path_m: float, heading_rad: float) -> tuple[float, float]:
        seconds = max(0.0, time_s - from_s)
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return (
            seconds * (along_m_s * cos - across_m_s * sin),
            seconds * (along_m_s * sin + across_m_s * cos),
        )

    return fault


def main() -> None:
    """Print the figures of docs/theory/relief.md."""
    for days in (DAYS, DAYS[::-1]):
        named, most = judged(*boreas(*days), base_off(0.0, 0.0))
        print(f"right fixes, {days[1]}: named {named is not None}, largest χ² {most:.1f}", flush=True)
    starts = [(days, from_m) for days in (DAYS, DAYS[::-1]) for from_m in (500.0, 2500.0, 4500.0)]
    after_m, kinds = [], []
    for days, from_m in starts:
        for k in range(8):
            drive, road = boreas(*days, from_m=from_m, to_m=from_m + 1550.0)
            named, _ = judged(drive, road, base_off(1.7, k * math.pi / 4.0))
            after_m.append(math.inf if named is None else named[0])
            kinds.append(None if named is None else named[1].kind)
    shares = [round(float((np.array(after_m) <= m).mean()), 3) for m in (1200.0, 1550.0)]
    print(f"base 1.7 m off, {len(kinds)}: within 1.2 and 1.5 km {shares}, as {_count(kinds)}", flush=True)
    kinds = []
    for days, from_m in starts:
        for speed in ((0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.0, -0.05)):
            drive, road = boreas(*days, from_m=from_m, to_m=from_m + 3300.0)
            from_s = float(drive.time_s[np.searchsorted(drive.path_m, from_m + 1500.0)])
            named, _ = judged(drive, road, led_away(*speed, from_s))
            kinds.append(None if named is None else named[1].kind)
    print(f"led away by 0.05 m/s, {len(kinds)}: named as {_count(kinds)}", flush=True)


def _count(kinds: list[TrackFault | None]) -> dict[str, int]:
    return {str(kind): kinds.count(kind) for kind in ("base", "drift", None)}


if __name__ == "__main__":
    main()
