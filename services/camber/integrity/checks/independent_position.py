"""A fix against the independent position: the evidence in which no fix's east or north has had a part.

A pose that confirmed fixes have anchored is where they are. That a fix agrees with it shows that fixes agree with one
another: *consistency*. A base station whose coordinate is wrong, signals that lead fixes and pose away together, a pose
that a wrong fix has captured, all pass. The localizer's independent position (scan matches, a given pose, the road's
relief, carried by odometry) can contradict them, and only what agrees with it is *position* evidence.

It is moved on to the fix's time by the pose's speed and direction, as the pose is. If the fix is right their difference
has the covariance F + C + A, of fix, independent position and acceleration since; the limits are those of the test of
the pose. What odometry has lost since the last evidence is in C: an old one is wide, agrees with everything and so is
no evidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.chi2_test import AGREES, CONTRADICTS
from camber.integrity.checks.consistency_tests import ConsistencyLimits, consistency_of
from camber.integrity.checks.pose_offset import travelled_m, unsteady_m2
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.gnss import Fix
from camber.schemas.pose import IndependentBasis, Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetFromIndependent:
    """Metres east and north from the independent position to a point, and its covariance (ee, en, nn) at that time."""

    difference_m: tuple[float, float]
    covariance_m2: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class IndependentComparison:
    """A fix less the independent position, and whether they agree; `acceptance_radius_m` as in `Consistency`.

    `sigma_m` is the largest of the independent position, `basis` its last evidence, `distance_m` driven since.
    """

    difference_m: tuple[float, float]
    outcome: int
    acceptance_radius_m: float
    sigma_m: float
    basis: IndependentBasis
    distance_m: float

    @property
    def agrees(self) -> bool:
        """Could it have contradicted the fix, and does it not?"""
        return self.outcome == AGREES

    @property
    def contradicts(self) -> bool:
        """Is the fix farther from it than all but a few right ones?"""
        return self.outcome == CONTRADICTS

    def describe(self) -> str:
        """All figures, for the detail of a verdict."""
        apart_m = math.hypot(*self.difference_m)
        since = f"{self.basis}, {self.distance_m:.0f} m ago"
        return f"{apart_m:.2f} m from the independent position of σ {self.sigma_m:.2f} m ({since})"


def offset_from_independent(
    latitude_rad: float, longitude_rad: float, pose: Pose, at_ns: int
) -> OffsetFromIndependent | None:
    """Where a point lies from the pose's independent position at `at_ns`; None where the pose has none."""
    known = pose.independent
    if known is None:
        return None
    east_m, north_m = east_north_between(known.latitude_rad, known.longitude_rad, latitude_rad, longitude_rad)
    moved_east_m, moved_north_m = travelled_m(pose, at_ns)
    (ee, en, nn), moved_m2 = known.covariance_east_north, unsteady_m2(pose, at_ns)
    return OffsetFromIndependent(
        difference_m=(east_m - moved_east_m, north_m - moved_north_m),
        covariance_m2=(ee + moved_m2, en, nn + moved_m2),
    )


def compare_with_independent(
    fix: Fix, pose: Pose, sigma: TrueSigma, limits: ConsistencyLimits
) -> IndependentComparison | None:
    """The comparison of one fix; None where the pose has no independent position, or none with a covariance."""
    offset = offset_from_independent(fix.latitude_rad, fix.longitude_rad, pose, fix.time_ns)
    known = pose.independent
    if offset is None or known is None or fix.covariance_enu_m2 is None:
        return None
    ee, en, nn = offset.covariance_m2
    if not (ee > 0.0 and ee * nn - en * en > 0.0):
        return None
    fix_ee, fix_en, _, fix_nn, _, fix_uu = inflate_covariance(fix.covariance_enu_m2, sigma)
    # The height is tested against the road: here it differs by nothing.
    difference = (*offset.difference_m, 0.0)
    covariance = (fix_ee + ee, fix_en + en, 0.0, fix_nn + nn, 0.0, fix_uu)
    result = consistency_of(difference, covariance, offset.covariance_m2, limits)
    return IndependentComparison(
        difference_m=offset.difference_m,
        outcome=result.position,
        acceptance_radius_m=result.acceptance_radius_m,
        sigma_m=math.sqrt(larger_eigenvalue(ee, en, nn)),
        basis=known.basis,
        distance_m=known.distance_m,
    )
