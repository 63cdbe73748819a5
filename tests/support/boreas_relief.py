"""Two drives of one road (`boreas-tracks`): the height profile of one day is the map of the other day's drive.

The heights are those of the LiDAR, post-processed to centimetres, on both days on the same vehicle. A track knows the
slope along it and none across; only where both drives used the same lane is one the map of the other.

`PYTHONPATH=tests python -m support.boreas_relief` prints the tables of docs/theory/relief.md in some minutes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.relief_start import MAX_PRIOR_SHARE, PRIOR_SIGMA_M
from camber.localizer.relief.terrain import TerrainHeights
from camber.localizer.relief.terrain_contour_matching import HeightWindow, ShiftEstimate, estimate_shift

Floats = NDArray[np.float64]
DAYS = ("2021-08-05", "2021-09-02")
SAME_LANE_M = 1.5
"""Chosen: half of what two lanes are apart; a crossfall of 2 % is 3 cm over it."""
MAP_SIGMA_M = 0.025
"""Of the two days' difference within that distance; 0.021 m within 0.5 m (docs/theory/map-errors.md)."""
WHITE_M = 0.003
"""Chosen: a heave of the vehicle on its springs."""
_ROAD_M = 8.0  # half a road and the errors of a track's place
_HEADING_SCALE_M = 10.0  # opposite directions of a road are 20 m apart in the search
_SPACING_M = 1.0


def folder() -> Path | None:
    """Return the recordings' folder; None where it is absent."""
    path = Path(os.environ.get("CAMBER_DATA", "")) / "boreas-tracks"
    return path if os.environ.get("CAMBER_DATA") and path.is_dir() else None


@dataclass(frozen=True, kw_only=True)
class Track:
    """A drive, a place every metre: time (s), east, north, height (m), heading (rad, from east), path (m)."""

    time_s: Floats
    east_m: Floats
    north_m: Floats
    height_m: Floats
    heading_rad: Floats
    path_m: Floats


@cache
def track(day: str) -> Track:
    """Read a drive."""
    path = folder()
    assert path is not None
    rows = np.genfromtxt(path / f"{day}.csv", delimiter=",", skip_header=1)
    kept = [0]
    for index, place in enumerate(rows[:, 1:3]):
        if np.hypot(*(place - rows[kept[-1], 1:3])) >= _SPACING_M:
            kept.append(index)
    time_s, (east, north, height) = (rows[kept, 0] - rows[0, 0]) * 1e-6, rows[kept, 1:4].T
    path_m = np.append(0.0, np.cumsum(np.hypot(np.diff(east), np.diff(north))))
    heading = np.arctan2(np.gradient(north), np.gradient(east))
    return Track(
        time_s=time_s, east_m=east, north_m=north, height_m=height, heading_rad=heading, path_m=path_m
    )


class ProfileMap:
    """The road as one drive has measured it: elevation and slope along the track, level across.

    With the `other` day's drive only where both used one lane: elsewhere the track is no map of the other's lane.
    """

    def __init__(self, drive: Track, other: Track | None = None) -> None:
        self._drive = drive
        self._known = np.ones(len(drive.path_m), bool)
        if other is not None:
            there = ProfileMap(other).lateral_m(drive.east_m, drive.north_m, drive.heading_rad)
            self._known = there <= SAME_LANE_M
        self._tree = cKDTree(_keys(drive.east_m, drive.north_m, drive.heading_rad))
        path = drive.path_m
        ahead, back = np.interp([path + 3.0, path - 3.0], path, drive.height_m)
        self._slope = (ahead - back) / 6.0

    def lateral_m(self, east_m: Floats, north_m: Floats, heading_rad: Floats) -> Floats:
        """Return the distance (...) of places from the track, infinite beyond the road and the track's ends."""
        return self._project(east_m, north_m, heading_rad)[2]

    def at(self, heading_rad: Floats, east_m: Floats, north_m: Floats) -> TerrainHeights:
        """Return the road at places (..., n) driven in these directions (n,)."""
        index, along, lateral = self._project(east_m, north_m, heading_rad)
        slope, heading = self._slope[index], self._drive.heading_rad[index]
        elevation = self._drive.height_m[index] + slope * along
        elevation = np.where(np.isfinite(lateral) & self._known[index], elevation, np.nan)
        return TerrainHeights(elevation, slope * np.cos(heading), slope * np.sin(heading))

    def _project(
        self, east_m: Floats, north_m: Floats, heading_rad: Floats
    ) -> tuple[NDArray[np.int64], Floats, Floats]:
        _, index = self._tree.query(_keys(east_m, north_m, heading_rad))
        drive = self._drive
        east, north = east_m - drive.east_m[index], north_m - drive.north_m[index]
        cos, sin = np.cos(drive.heading_rad[index]), np.sin(drive.heading_rad[index])
        along, lateral = east * cos + north * sin, np.abs(north * cos - east * sin)
        beyond = (np.abs(along) > 3.0) | (lateral > _ROAD_M)
        return index, along, np.where(beyond, np.inf, lateral)


def _keys(east_m: Floats, north_m: Floats, heading_rad: Floats) -> Floats:
    cos, sin = _HEADING_SCALE_M * np.cos(heading_rad), _HEADING_SCALE_M * np.sin(heading_rad)
    return np.stack(np.broadcast_arrays(east_m, north_m, cos, sin), axis=-1)


@dataclass(frozen=True, kw_only=True)
class ReliefDrive:
    """Height observations of one drive every `spacing_m` where both drives used one lane, and the map to them."""

    window: HeightWindow
    heading_rad: Floats
    path_m: Floats
    road: ProfileMap

    def part(self, from_m: float, to_m: float) -> ReliefDrive:
        """Return the observations of a part of the path."""
        kept = (self.path_m >= from_m) & (self.path_m < to_m)
        window = HeightWindow(*(values[kept] for values in self.window[:6]))
        return ReliefDrive(
            window=window, heading_rad=self.heading_rad[kept], path_m=self.path_m[kept], road=self.road
        )

    def terrain(self, east_m: Floats, north_m: Floats) -> TerrainHeights:
        """Return the road of each observation at other places (..., n)."""
        return self.road.at(self.heading_rad, east_m, north_m)


def relief_drive(
    map_day: str, drive_day: str, *, spacing_m: float = 10.0, lane_m: float = SAME_LANE_M
) -> ReliefDrive:
    """Return one day's drive over the other day's map; `time_s`, places and heights are those of the drive."""
    drive, road = track(drive_day), ProfileMap(track(map_day))
    lateral = road.lateral_m(drive.east_m, drive.north_m, drive.heading_rad)
    kept: list[int] = []
    for index in np.flatnonzero(lateral <= lane_m).tolist():
        if not kept or drive.path_m[index] - drive.path_m[kept[-1]] >= spacing_m:
            kept.append(index)
    window = HeightWindow(
        time_s=drive.time_s[kept],
        east_m=drive.east_m[kept],
        north_m=drive.north_m[kept],
        height_m=drive.height_m[kept],
        sigma_m=np.full(len(kept), WHITE_M),
        map_sigma_m=np.full(len(kept), MAP_SIGMA_M),
    )
    return ReliefDrive(
        window=window, heading_rad=drive.heading_rad[kept], path_m=drive.path_m[kept], road=road
    )


_ALARM_CHI2 = 27.6
"""Chi-square, 2 degrees of freedom, 1 in 10⁶."""
_LEAST_KNOWN = 0.7


@dataclass(frozen=True, kw_only=True)
class Estimated:
    """A window's result against the truth: errors along and across (m), σ of both (m), squared error over covariance,
    and whether the heights determine the position (`MAX_PRIOR_SHARE`)."""

    from_m: float
    along_m: float
    across_m: float
    along_sigma_m: float
    across_sigma_m: float
    chi2: float
    determined: bool


def estimate(part: ReliefDrive) -> ShiftEstimate | None:
    """Return the shift of a part of a drive by heights, from a prior of `PRIOR_SIGMA_M`."""
    return estimate_shift(part.window, part.terrain, HeightErrorModel(), prior=np.eye(2) * PRIOR_SIGMA_M**2)


def is_determined(result: ShiftEstimate | None) -> bool:
    """Return whether the heights outweigh the prior, and no other shift fits as well."""
    return result is not None and result.unique and result.prior_share <= MAX_PRIOR_SHARE


def estimates(map_day: str, drive_day: str, *, length_m: float, spacing_m: float = 10.0) -> list[Estimated]:
    """Return the results of windows of a length, each half a window on, with 70 % of the road on the map."""
    drive = relief_drive(map_day, drive_day, spacing_m=spacing_m)
    results = []
    for from_m in np.arange(0.0, drive.path_m[-1] - length_m, 0.5 * length_m).tolist():
        part = drive.part(from_m, from_m + length_m)
        result = None if len(part.path_m) < _LEAST_KNOWN * length_m / spacing_m else estimate(part)
        if result is None:
            continue
        heading = float(np.angle(np.exp(1j * part.heading_rad).mean()))
        axes = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        along, across = axes @ result.shift
        sigma = np.sqrt(np.diag(axes @ result.covariance @ axes.T))
        results.append(
            Estimated(
                from_m=from_m,
                along_m=float(along),
                across_m=float(across),
                along_sigma_m=float(sigma[0]),
                across_sigma_m=float(sigma[1]),
                chi2=float(result.shift @ np.linalg.solve(result.covariance, result.shift)),
                determined=is_determined(result),
            )
        )
    return results


def fault_alarm(chi2: float) -> bool:
    """Return whether an offset of the fixes is significant."""
    return bool(chi2 > _ALARM_CHI2)


def base_offset(
    map_day: str, drive_day: str, *, from_m: float, yaw_rad: float, offset_m: float, to_m: float = 1500.0
) -> float | None:
    """Return the path (m) after which fixes that are off by a constant vector are named; None: not within `to_m`."""
    drive = relief_drive(map_day, drive_day)
    east, north = offset_m * np.cos(yaw_rad), offset_m * np.sin(yaw_rad)
    for length_m in np.arange(200.0, to_m + 1.0, 100.0).tolist():
        part = drive.part(from_m, from_m + length_m)
        if len(part.path_m) < 10:
            continue
        window = part.window
        off = window._replace(east_m=window.east_m + east, north_m=window.north_m + north)
        result = estimate(replace(part, window=off))
        if result is None or not is_determined(result):
            continue
        if fault_alarm(float(result.shift @ np.linalg.solve(result.covariance, result.shift))):
            return length_m
    return None


def main() -> None:
    """Print the tables of docs/theory/relief.md."""
    for length_m in (200.0, 500.0, 1000.0, 1500.0):
        windows = [window for days in (DAYS, DAYS[::-1]) for window in estimates(*days, length_m=length_m)]
        counted = [window for window in windows if window.determined]
        along = np.quantile(np.abs([window.along_m for window in counted]), [0.5, 0.95, 1.0])
        across = np.quantile(np.abs([window.across_m for window in counted]), [0.5, 0.95, 1.0])
        chi2 = np.array([window.chi2 for window in counted])
        sigma = np.median([window.along_sigma_m for window in counted])
        print(
            f"{length_m:5g} m: {len(counted)} of {len(windows)}; along {along.round(2)} across {across.round(2)} m, "
            f"σ along {sigma:.2f} m; in the 99 % ellipse {(chi2 < 9.21).mean():.3f}, largest χ² {chi2.max():.1f}",
            flush=True,
        )
    starts = np.arange(0.0, 6500.0, 500.0).tolist()
    for offset_m in (0.0, 1.7):
        named = [
            base_offset(*days, from_m=from_m, yaw_rad=k * np.pi / 4.0, offset_m=offset_m)
            for days in (DAYS, DAYS[::-1])
            for from_m in starts
            for k in range(8 if offset_m else 1)
        ]
        within = np.array([np.inf if distance is None else distance for distance in named])
        shares = [round(float((within <= m).mean()), 3) for m in (500.0, 1000.0, 1500.0)]
        print(
            f"base {offset_m} m off, {len(named)} cases: named within 500, 1000, 1500 m {shares}", flush=True
        )


if __name__ == "__main__":
    main()
