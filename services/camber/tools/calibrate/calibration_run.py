"""Pair a recorded drive's fixes with poses that are independent of them: the observations of calibration."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.height_check import road_at
from camber.integrity.checks.pose_gate import can_move_on, offset_from_pose, pose_sigma_m
from camber.integrity.learning.common_offset import CommonOffset, HeightDifferences, estimate_common_offset
from camber.integrity.learning.residuals import CellCollector, FixResidual, ResidualCell, cell_of
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose
from camber.tools.calibrate.calibration import FixPosePairs

_NEAR_S = 0.1  # chosen: the period of poses
_MAP_CORRELATION_M = 20.0  # chosen: map heights of neighbouring stretches are taken as correlated
_STRETCH_M = 20.0  # chosen: one mean height per correlation length
_LEAST_STRETCHES = 5  # chosen: 100 m of road
_SIGMA_LIMIT_M = 0.3  # chosen: a less precise pose has hardly any weight
_ANY_HEIGHT_M = 10.0  # chosen: σ of an uninformative prior of the antenna height


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibrationData:
    """Fixes paired with scan-matched poses, mean heights of stretches of road, and the number of fixes."""

    pairs: FixPosePairs
    cells: tuple[ResidualCell, ...]
    fixes: int


def pair(fixes: Sequence[Fix], poses: Sequence[Pose]) -> CalibrationData:
    """Pair each fixed position with the pose nearest in time; both sequences in time order."""
    rows: list[tuple[int, float, float, float, float]] = []
    cells, collector, last = list[ResidualCell](), CellCollector(_STRETCH_M), list[FixResidual]()
    times_ns = [pose.time_ns for pose in poses]
    fixed = [fix for fix in fixes if fix.quality == "fixed" and fix.covariance_enu_m2 is not None]
    for fix in fixed:
        pose = _nearest(poses, times_ns, fix.time_ns)
        if pose is None:
            continue
        row = _row(fix, pose)
        if row is not None:
            rows.append(row)
        residual = _height(fix, pose)
        if residual is not None:
            ended = collector.add(residual)
            if ended is not None:
                cells.append(ended)
                last = []
            last.append(residual)
    if last:
        cells.append(cell_of(last))
    table = np.array(rows, np.float64).reshape(-1, 5)
    time_ns = np.array([row[0] for row in rows], np.int64)
    pairs = FixPosePairs(
        time_ns=time_ns, east_north_m=table[:, 1:3], yaw_rad=table[:, 3], sigma_m=table[:, 4]
    )
    return CalibrationData(pairs=pairs, cells=tuple(cells), fixes=len(fixed))


def estimate_antenna_height(cells: Sequence[ResidualCell]) -> CommonOffset | None:
    """Estimate the antenna's height above the road for a base without vertical error; None: too little road."""
    if len(cells) < _LEAST_STRETCHES:
        return None
    known = [cell for cell in cells if cell.up_m is not None]
    first = known[0]
    origin = first.latitude_rad, first.longitude_rad
    up_m = np.array([cell.up_m for cell in known], np.float64)
    differences = HeightDifferences(
        up_m=up_m,
        variance_m2=np.array([cell.fix_sigma_m**2 for cell in known], np.float64),
        map_sigma_m=np.array([cell.map_sigma_m for cell in known], np.float64),
        place_m=np.array(
            [east_north_between(*origin, cell.latitude_rad, cell.longitude_rad) for cell in known]
        ),
        time_s=np.array([(cell.begin_ns - first.begin_ns) / 1e9 for cell in known], np.float64),
    )
    return estimate_common_offset(differences, _MAP_CORRELATION_M, float(np.median(up_m)), _ANY_HEIGHT_M)


def _nearest(poses: Sequence[Pose], times_ns: Sequence[int], at_ns: int) -> Pose | None:
    after = bisect_left(times_ns, at_ns)
    near = poses[max(after - 1, 0) : after + 1]
    pose = min(near, key=lambda p: abs(p.time_ns - at_ns), default=None)
    if pose is None or pose.latitude_rad is None or not can_move_on(pose):
        return None
    return pose if abs(pose.time_ns - at_ns) <= _NEAR_S * 1e9 else None


def _row(fix: Fix, pose: Pose) -> tuple[int, float, float, float, float] | None:
    """Return time, east, north, yaw, σ; None where the pose is not from a scan match, or not precise."""
    sigma_m = pose_sigma_m(pose)
    if pose.mode != "scan_match" or pose.yaw_rad is None or not 0.0 < sigma_m <= _SIGMA_LIMIT_M:
        return None
    assert fix.covariance_enu_m2 is not None
    ee, _, _, nn, _, _ = inflate_covariance(fix.covariance_enu_m2, TrueSigma())
    east_m, north_m = offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, fix.time_ns)
    return fix.time_ns, east_m, north_m, pose.yaw_rad, math.hypot(sigma_m, math.sqrt(max(ee, nn)))


def _height(fix: Fix, pose: Pose) -> FixResidual | None:
    """Return the height of the fix above the road below it."""
    assert fix.covariance_enu_m2 is not None
    if pose.road.datum != fix.datum:
        return None
    road = road_at(pose.road, *offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, pose.time_ns))
    if road is None:
        return None
    sigma_m = math.sqrt(inflate_covariance(fix.covariance_enu_m2, TrueSigma())[5])
    return FixResidual(
        time_ns=fix.time_ns,
        verdict="unknown",
        latitude_rad=fix.latitude_rad,
        longitude_rad=fix.longitude_rad,
        up_m=fix.height_m - road.elevation_m,
        fix_sigma_m=sigma_m,
        map_sigma_m=road.sigma_m,
        surface_id=road.surface_id,
    )
