"""The determination: tests of height and horizontal position, alone and together, for n fixes at once.

Each test that is asked has two limits, from a rate of false alarms and from a rate of right fixes that may be held
back; both rates are shared evenly by the tests asked, so that all of them together keep to it, whatever they have in
common. The height has a cap besides: however badly road and antenna are known, a difference beyond it never agrees.
With a fixed tolerance, JP7707657B2 eqs. (2) and (3), the height agrees or contradicts and there is nothing between.
The position has a cap too: however wide a fix claims to be, it agrees only as near to the pose as a right fix is.

The judge tests one fix, in plain floats, the lab millions: there is one implementation (`scalar_or_array`). numpy only;
metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Generic, Literal, TypeVar

import numpy as np

from camber.integrity.checks.chi2_test import (
    AGREES,
    CONTRADICTS,
    UNVERIFIED,
    Distances,
    Floats,
    TestOutcomes,
    UpperTriangle,
    chi2_limit,
    distances,
    outcome_of,
    upper_triangle,
)
from camber.integrity.scalar_or_array import (
    FloatOrArray,
    larger_eigenvalue,
    logical_not,
    positive_or_nan,
    sqrt,
    where,
)
from camber.schemas.integrity import Reason

Test = Literal["height", "position", "joint", "phase_residuals", "subset_agreement", "continuity", "receiver"]
ALL_TESTS: tuple[Test, ...] = (
    "height",
    "position",
    "joint",
    "phase_residuals",
    "subset_agreement",
    "continuity",
    "receiver",
)
_SPEAK_FOR: frozenset[Test] = frozenset(
    {"height", "position", "joint", "phase_residuals", "subset_agreement"}
)
OutcomeT = TypeVar("OutcomeT")
_DEGREES: dict[Test, int] = {"height": 1, "position": 2, "joint": 3}

ALL_AGREE, HEIGHT_UNVERIFIED, POSITION_UNVERIFIED = 0, 1, 2
HEIGHT_CONTRADICTS, POSITION_CONTRADICTS, BOTH_CONTRADICT = 3, 4, 5
REASONS: tuple[Reason, ...] = (
    "height_agrees",
    "height_unverified",
    "position_unverified",
    "height_disagrees",
    "position_disagrees",
    "height_and_position_disagree",
)
"""The reason for each outcome."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencyParameters:
    """Which tests are asked, and by which limits.

    `height_cap_m` is for tolerances from covariances: 0.3 m is the gate below which map and antenna of σ 0.1 m let a
    right fix through. `position_cap_m` is how far agreement with the pose may reach and still say something: errors of
    wrong fixes are metres wide. `fix_sigma_cap_m`, each axis, is how much of a fix's own σ may widen the agreement of
    the position: integers that are right leave centimetres (multipath of the phase, reference point, frame), and what
    claims more by a weak geometry is where wrong integers hide.
    """

    tests: tuple[Test, ...] = ALL_TESTS
    tolerance: Literal["from_covariances", "fixed"] = "from_covariances"
    tolerance_m: float = 0.2
    height_cap_m: float = 0.3
    position_cap_m: float = 1.0
    false_alarm_rate: float = 1e-6
    hold_back_rate: float = 1e-3
    fix_sigma_cap_m: float = 0.06

    def __post_init__(self) -> None:
        """Raises ValueError where nothing could ever speak for a fix, or the limits are the wrong way round."""
        if not _SPEAK_FOR.intersection(self.tests):
            names = ", ".join(test for test in ALL_TESTS if test in _SPEAK_FOR)
            raise ValueError(f"tests: expected one at least of {names}")
        if not 0.0 < self.false_alarm_rate <= self.hold_back_rate < 1.0:
            raise ValueError("false_alarm_rate: expected above 0 and at most hold_back_rate, below 1")

    @property
    def asks_height(self) -> bool:
        """Does a verdict need road and antenna height?"""
        return "height" in self.tests or "joint" in self.tests

    @property
    def asks_position(self) -> bool:
        """Is the horizontal position tested?"""
        return "position" in self.tests or "joint" in self.tests

    @property
    def largest_tolerance_m(self) -> float:
        """No difference beyond it agrees; a height that is known worse than it says nothing."""
        return self.tolerance_m if self.tolerance == "fixed" else self.height_cap_m

    def limits(self) -> ConsistencyLimits:
        """The squared distances of these rates."""
        asked = sum(test in self.tests for test in _DEGREES)

        def pair(test: Test, needed: bool) -> tuple[float, float]:
            if not needed:
                return math.inf, math.inf
            within, beyond = (
                chi2_limit(rate / asked, _DEGREES[test])
                for rate in (self.hold_back_rate, self.false_alarm_rate)
            )
            return within, beyond

        return ConsistencyLimits(
            rules=self,
            height=pair("height", "height" in self.tests),
            position=pair("position", self.asks_position),
            joint=pair("joint", "joint" in self.tests),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencyLimits:
    """Of each test the squared distance up to which a fix agrees, and that beyond which it contradicts.

    Infinite, both, for a test that is not asked; the position's are there for the joint test too.
    """

    rules: ConsistencyParameters
    height: tuple[float, float]
    position: tuple[float, float]
    joint: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Consistency(Generic[OutcomeT]):
    """Outcomes of the tests of fixes, and what they rest on; each one number or (n,), a fixed tolerance always one.

    `tolerance_m` is the largest height difference that would agree, `acceptance_radius_m` how far from the pose a fix
    may be and agree in any direction. `position` is the outcome of the horizontal position where it or the joint test
    is asked.
    """

    outcome: OutcomeT
    position: OutcomeT
    distances: Distances
    tolerance_m: FloatOrArray
    acceptance_radius_m: FloatOrArray


def consistency_of_arrays(
    difference_m: Floats, covariance_m2: Floats, pose_covariance_m2: Floats, limits: ConsistencyLimits
) -> Consistency[TestOutcomes]:
    """Test differences (n, 3), if those of right fixes have the covariances (n, 3, 3); see `chi2_test`.

    `pose_covariance_m2` (n, 2, 2) is the part of the pose in that.
    """
    pose = pose_covariance_m2[:, 0, 0], pose_covariance_m2[:, 0, 1], pose_covariance_m2[:, 1, 1]
    east_m, north_m, up_m = difference_m.T
    with np.errstate(all="ignore"):  # what is not finite agrees with nothing
        result = consistency_of((east_m, north_m, up_m), upper_triangle(covariance_m2), pose, limits)
    return replace(result, outcome=result.outcome.astype(np.int8), position=result.position.astype(np.int8))


def consistency_of(
    difference_m: tuple[FloatOrArray, FloatOrArray, FloatOrArray],
    covariance_m2: UpperTriangle,
    pose_m2: tuple[FloatOrArray, FloatOrArray, FloatOrArray],
    limits: ConsistencyLimits,
) -> Consistency[FloatOrArray]:
    """The same of differences east, north, up, with `pose_m2` (ee, en, nn); each part a float or (n,)."""
    rules, result = limits.rules, distances(difference_m, covariance_m2)
    east_m, north_m, up_m = difference_m
    ee, en, _, nn, _, _ = covariance_m2
    off_m = abs(up_m)
    tolerance_m = _tolerance_m(result.height_sigma_m, limits)
    if rules.tolerance == "fixed" and "height" in rules.tests:
        height = where(off_m <= tolerance_m, AGREES, CONTRADICTS)
    else:
        height = outcome_of(result.height, *limits.height)
    horizontal_outcome, joint = (
        outcome_of(result.position, *limits.position),
        outcome_of(result.joint, *limits.joint),
    )
    cap_m2 = rules.fix_sigma_cap_m**2
    near_m2 = pose_m2[0] + cap_m2, pose_m2[1], pose_m2[2] + cap_m2
    acceptance_radius_m, near_acceptance_radius_m = _reach_m((ee, en, nn), limits), _reach_m(near_m2, limits)
    acceptance_radius_m = where(
        near_acceptance_radius_m >= acceptance_radius_m, acceptance_radius_m, near_acceptance_radius_m
    )
    near = horizontal_distance2(east_m, north_m, near_m2) <= limits.position[0]
    far = (horizontal_outcome == AGREES) & logical_not(near) & rules.asks_position
    position = where(far, UNVERIFIED, horizontal_outcome)
    # However wide σ is, no height agrees beyond the tolerance; and a test of the position alone has to have power.
    exceeds_height_cap = logical_not(off_m <= tolerance_m) & rules.asks_height
    insufficient_power = logical_not(acceptance_radius_m <= rules.position_cap_m) & (
        rules.asks_position and not rules.asks_height
    )
    horizontal_outcome = position if "position" in rules.tests else where(far, UNVERIFIED, AGREES)
    outcome: FloatOrArray = ALL_AGREE
    # A later row overrides the rows before it.
    for applies, code in (
        (joint == UNVERIFIED, POSITION_UNVERIFIED),
        ((joint == UNVERIFIED) & (result.height >= result.position), HEIGHT_UNVERIFIED),
        ((horizontal_outcome == UNVERIFIED) | insufficient_power, POSITION_UNVERIFIED),
        ((height == UNVERIFIED) | exceeds_height_cap, HEIGHT_UNVERIFIED),
        (joint == CONTRADICTS, BOTH_CONTRADICT),
        (horizontal_outcome == CONTRADICTS, POSITION_CONTRADICTS),
        (height == CONTRADICTS, HEIGHT_CONTRADICTS),
        ((height == CONTRADICTS) & (horizontal_outcome == CONTRADICTS), BOTH_CONTRADICT),
    ):
        outcome = where(applies, code, outcome)
    return Consistency(
        outcome=outcome,
        position=position,
        distances=result,
        tolerance_m=tolerance_m,
        acceptance_radius_m=acceptance_radius_m,
    )


def _tolerance_m(sigma_m: FloatOrArray, limits: ConsistencyLimits) -> FloatOrArray:
    rules = limits.rules
    if rules.tolerance == "fixed":
        return rules.tolerance_m
    tolerance_m = math.sqrt(limits.height[0]) * sigma_m
    return where(tolerance_m < rules.height_cap_m, tolerance_m, rules.height_cap_m)


def horizontal_distance2(
    east_m: FloatOrArray,
    north_m: FloatOrArray,
    covariance_m2: tuple[FloatOrArray, FloatOrArray, FloatOrArray],
) -> FloatOrArray:
    """dᵀ C⁻¹ d of a difference east, north with C (ee, en, nn); not a number where C is no covariance."""
    a, b, c = covariance_m2
    determinant = where(a > 0.0, positive_or_nan(a * c - b * b), math.nan)
    return (c * east_m * east_m - 2.0 * b * east_m * north_m + a * north_m * north_m) / determinant


def _reach_m(
    covariance_m2: tuple[FloatOrArray, FloatOrArray, FloatOrArray], limits: ConsistencyLimits
) -> FloatOrArray:
    larger = larger_eigenvalue(*covariance_m2)
    return sqrt(where(larger > 0.0, limits.position[0] * larger, math.nan))
