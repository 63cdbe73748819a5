"""Estimate lever arm, base-station offset and antenna height from fixes and poses that are independent of them.

The pose is that of the antenna at the lever arm set. Fix minus pose is then

    d = R(yaw) (lever arm − lever arm set) + base offset + errors

and a fix's height above the road is antenna height + vertical base offset. A lever arm turns with the vehicle and a
base offset does not, so the two are separable only with turns; antenna height and vertical base offset are not
separable on board.

Errors of scan matches are correlated over seconds: σ are cluster-robust, with stretches of ten seconds as clusters
(Liang and Zeger, Biometrika 73, 1986). Wrong fixes are rejected by Tukey's biweight.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.formats.observations import Floats, Integers
from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.height_model import road_at
from camber.integrity.checks.pose_offset import can_move_on, offset_from_pose, pose_sigma_m
from camber.integrity.learning.common_offset import CommonOffset, HeightDifferences, estimate_common_offset
from camber.integrity.learning.residuals import CellCollector, FixResidual, ResidualCell, cell_of
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.road_map.map_error_model import MAP_ERRORS
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose

CLUSTER_S = 10.0  # chosen: longer than the seconds over which errors of scan matches are correlated
LEAST_FIXES = 50  # chosen: ten seconds of fixes at 5 Hz
LEAST_CLUSTERS = 4  # chosen: as many as there are parameters, fewer give no covariance
LEAST_SPREAD = 0.05
"""Chosen: 1 − |mean of exp(i yaw)|; below it (headings within some 18°) lever arm and base are not separable."""
_TUKEY = 4.685  # 95 % efficiency for normal errors (Beaton and Tukey, Technometrics 16, 1974)
_LEAST_SCALE_M = 0.02  # chosen: noise of an RTK fix, keeps the scale above zero for noiseless data
_LEAST_SIGMA_M = 0.005  # chosen: a few clusters estimate their scatter poorly
_NEAR_S = 0.1  # chosen: the period of poses
_STRETCH_M = 20.0  # chosen: one mean height per stretch, half the shorter correlation length of map errors
_LEAST_STRETCHES = 5  # chosen: 100 m of road
_SIGMA_LIMIT_M = 0.3  # chosen: a less precise pose has hardly any weight
_ANY_HEIGHT_M = 10.0  # chosen: σ of an uninformative prior of the antenna height
_ITERATIONS = 50  # chosen: bound; iterations end once the values change by less than 1 µm


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixPosePairs:
    """n pairs of fix and pose: time, fix minus pose (n, 2) east and north, yaw, σ (n,) in the worst direction."""

    time_ns: Integers
    east_north_m: Floats
    yaw_rad: Floats
    sigma_m: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HorizontalCalibration:
    """Lever arm error (forward, left), base offset (east, north), their σ, and the share of pairs `used`.

    Where `separable` is false there were no turns: `lever_m` assumes a correct base, `base_m` a correct lever arm.
    """

    lever_m: Floats
    lever_sigma_m: Floats
    base_m: Floats
    base_sigma_m: Floats
    separable: bool
    used: float


def calibrate_horizontal(pairs: FixPosePairs) -> HorizontalCalibration | None:
    """Estimate lever arm error and base offset; None where there are too few pairs for values and σ."""
    clusters = clusters_of(pairs.time_ns)
    if len(pairs.time_ns) < LEAST_FIXES or len(np.unique(clusters)) < LEAST_CLUSTERS:
        return None
    of_lever = _lever_columns(pairs.yaw_rad)
    of_base = np.broadcast_to(np.eye(2), of_lever.shape)
    separable = circular_variance(pairs.yaw_rad) >= LEAST_SPREAD
    if separable:
        values, sigma, used = _fit(np.concatenate((of_lever, of_base), axis=2), pairs, clusters)
        lever, base, lever_sigma, base_sigma = values[:2], values[2:], sigma[:2], sigma[2:]
    else:
        lever, lever_sigma, used = _fit(of_lever, pairs, clusters)
        base, base_sigma, _ = _fit(of_base, pairs, clusters)
    return HorizontalCalibration(
        lever_m=lever,
        lever_sigma_m=lever_sigma,
        base_m=base,
        base_sigma_m=base_sigma,
        separable=separable,
        used=used,
    )


def circular_variance(yaw_rad: Floats) -> float:
    """Return 1 − |mean of exp(i yaw)|: 0 where all headings agree, 1 where they cancel."""
    return 1.0 - float(np.abs(np.exp(1j * yaw_rad).mean()))


def clusters_of(time_ns: Integers) -> Integers:
    """Return the number (n,) of the stretch of time that each epoch belongs to."""
    clusters: Integers = (time_ns - time_ns.min(initial=0)) // round(CLUSTER_S * 1e9)
    return clusters


def _lever_columns(yaw_rad: Floats) -> Floats:
    """Return the partial derivatives (n, 2, 2) of east and north by forward and left."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack((np.stack((cos, -sin), axis=1), np.stack((sin, cos), axis=1)), axis=1)


def _fit(columns: Floats, pairs: FixPosePairs, clusters: Integers) -> tuple[Floats, Floats, float]:
    """Fit values (k,) by Tukey's biweight; returns them, their σ, and the share of pairs used. `columns` (n, 2, k).

    Starts from least absolute deviations, so that a minority of wrong fixes, however large, has no influence.
    """
    n, _, k = columns.shape
    weight = 1.0 / pairs.sigma_m**2
    agreed = np.ones(n)
    values = _least_absolute_deviations(columns, pairs)
    for _ in range(_ITERATIONS):
        residual_m = pairs.east_north_m - columns @ values
        ratio = np.linalg.norm(residual_m, axis=1) / pairs.sigma_m
        scale = max(1.4826 * float(np.median(ratio)) / 1.2, _LEAST_SCALE_M / float(np.median(pairs.sigma_m)))
        agreed = np.clip(1.0 - (ratio / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        before, values = values, _solve(columns, pairs.east_north_m, weight * agreed)[0]
        if np.allclose(before, values, rtol=0.0, atol=1e-6):
            break
    values, normal = _solve(columns, pairs.east_north_m, weight * agreed)
    residual_m = pairs.east_north_m - columns @ values
    scores = np.einsum("nij,ni,n->nj", columns, residual_m, weight * agreed)
    numbers, inverse = np.unique(clusters, return_inverse=True)
    summed = np.zeros((len(numbers), k))
    np.add.at(summed, inverse, scores)
    few_clusters = len(numbers) / (len(numbers) - 1.0)
    covariance = few_clusters * normal @ (summed.T @ summed) @ normal
    return values, np.sqrt(np.diag(covariance) + _LEAST_SIGMA_M**2), float(np.mean(agreed > 0.0))


def _least_absolute_deviations(columns: Floats, pairs: FixPosePairs) -> Floats:
    """Approximate least absolute deviations by iteratively reweighted least squares."""
    n, _, k = columns.shape
    weight, values = np.ones(n), np.zeros(k)
    for _ in range(_ITERATIONS):
        values = _solve(columns, pairs.east_north_m, weight)[0]
        distance_m = np.linalg.norm(pairs.east_north_m - columns @ values, axis=1)
        weight = 1.0 / np.maximum(distance_m, _LEAST_SCALE_M)
    return values


def _solve(columns: Floats, observed_m: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the weighted least-squares values and the inverse of the normal matrix."""
    normal = np.linalg.inv(np.einsum("nij,nik,n->jk", columns, columns, weight))
    return normal @ np.einsum("nij,ni,n->j", columns, observed_m, weight), normal


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
    return estimate_common_offset(differences, MAP_ERRORS, float(np.median(up_m)), _ANY_HEIGHT_M)


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
