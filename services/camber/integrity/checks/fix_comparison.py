"""One fix against pose, road and antenna: difference, covariance if the fix is right, and outcomes of the tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.integrity.checks.chi2_test import Floats, covariance_of_difference
from camber.integrity.checks.consistency_tests import ConsistencyLimits, consistency_of
from camber.integrity.checks.height_model import HeightModel, RoadPoint
from camber.integrity.checks.pose_offset import offset_from_pose, unsteady_m2
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixComparison:
    """The difference (3,) of a fix, its covariance S (3, 3) if the fix is right, and the outcomes of the tests.

    Fix less pose to the east and north at the fix's time, and fix less road, antenna and correction at its place
    upwards, NaN where that is not known; metres. `outcome` is an index into `consistency.REASONS`, `position` the
    outcome of the horizontal test; `height_m` is the difference of JP7707657B2 eq. (3), which counts the other way.
    """

    difference_m: Floats
    covariance_m2: Floats
    outcome: int
    position: int
    height_m: float | None
    height_sigma_m: float
    tolerance_m: float | None
    acceptance_radius_m: float
    joint_distance2: float | None
    joint_limit: float | None

    @property
    def position_m(self) -> tuple[float, float]:
        """Fix less pose, east and north."""
        return float(self.difference_m[0]), float(self.difference_m[1])

    @property
    def position_sigma_m(self) -> float:
        """Of that difference in its worst direction."""
        (ee, en, _), (_, nn, _), _ = self.covariance_m2.tolist()
        return math.sqrt(larger_eigenvalue(ee, en, nn))

    def describe(self, pose_sigma_m: float) -> str:
        """All figures, for the detail of a verdict."""
        apart_m = math.hypot(*self.position_m)
        parts = [
            f"{apart_m:.2f} m from the pose of σ {pose_sigma_m:.2f} m, {self.acceptance_radius_m:.2f} m would agree"
        ]
        if self.height_m is not None:
            sigma = f"σ {self.height_sigma_m:.2f} m, {self.tolerance_m:.2f} m would agree"
            parts.insert(0, f"height {self.height_m:+.2f} m of {sigma}")
        if self.joint_distance2 is not None and self.joint_limit is not None:
            parts.append(f"together {self.joint_distance2:.1f} of {self.joint_limit:.1f}")
        return "; ".join(parts)


def compare(
    fix: Fix,
    pose: Pose,
    road: RoadPoint | None,
    height: HeightModel | None,
    sigma: TrueSigma,
    limits: ConsistencyLimits,
) -> FixComparison:
    """The comparison of one fix; without road and antenna its height is infinitely far off.

    Raises ValueError for a fix or a pose without covariance or place.
    """
    if fix.covariance_enu_m2 is None or pose.covariance_east_north_yaw is None:
        raise ValueError("a covariance is missing")
    east_m, north_m = offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, fix.time_ns)
    up_m, variance_m2, slope = math.nan, math.inf, (0.0, 0.0)
    if road is not None and height is not None:
        up_m = fix.height_m - height.expected_m(road)
        variance_m2, slope = height.variance_m2(road), (road.slope_east, road.slope_north)
    pose_m2 = _pose_covariance(pose, fix.time_ns)
    fix_m2 = inflate_covariance(fix.covariance_enu_m2, sigma)
    covariance_m2 = covariance_of_difference(fix_m2, pose_m2, variance_m2, slope)
    result = consistency_of((east_m, north_m, up_m), covariance_m2, pose_m2, limits)
    asks_height = limits.rules.asks_height
    ee, en, eu, nn, nu, uu = covariance_m2
    return FixComparison(
        difference_m=np.array([east_m, north_m, up_m]),
        covariance_m2=np.array([[ee, en, eu], [en, nn, nu], [eu, nu, uu]]),
        outcome=result.outcome,
        position=result.position,
        height_m=-up_m if asks_height and math.isfinite(up_m) else None,
        height_sigma_m=result.distances.height_sigma_m,
        tolerance_m=result.tolerance_m if asks_height else None,
        acceptance_radius_m=result.acceptance_radius_m,
        joint_distance2=_finite(result.distances.joint),
        joint_limit=_finite(limits.joint[1]),
    )


def _pose_covariance(pose: Pose, at_ns: int) -> tuple[float, float, float]:
    """(ee, en, nn) of the pose, and what a car may have accelerated by between its time and the fix's."""
    assert pose.covariance_east_north_yaw is not None
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    moved_m2 = unsteady_m2(pose, at_ns)
    return ee + moved_m2, en, nn + moved_m2


def _finite(value: float) -> float | None:
    return value if value < math.inf else None
