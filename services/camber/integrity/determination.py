"""The determination: what height and horizontal position, alone and together, say of fixes. For n fixes at once.

Each test that is asked has two limits, from a rate of false alarms and from a rate of right fixes that may be held
back; both rates are shared evenly by the tests asked, so that all of them together keep to it, whatever they have in
common. The height has a cap besides: however badly road and antenna are known, a difference beyond it never agrees.
With a fixed tolerance, H (2) and (3), the height agrees or contradicts and there is nothing between. So has the
position: however wide a fix claims to be, it agrees only as near to the pose as a right fix is.

The judge asks with n = 1, the lab with millions: there is one implementation. numpy only, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.integrity.joint_test import (
    AGREES,
    CONTRADICTS,
    UNVERIFIED,
    Distances,
    Floats,
    Words,
    chi2_limit,
    distances,
    words,
)
from camber.schemas.integrity import Reason

Test = Literal["height", "position", "joint", "phase_residuals", "continuity", "receiver"]
ALL_TESTS: tuple[Test, ...] = ("height", "position", "joint", "phase_residuals", "continuity", "receiver")
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


@dataclass(frozen=True, slots=True)
class DeterminationRules:
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
        if not {"height", "position", "joint", "phase_residuals"}.intersection(self.tests):
            raise ValueError("tests: expected one at least of height, position, joint, phase_residuals")
        if not 0.0 < self.false_alarm_rate <= self.hold_back_rate < 1.0:
            raise ValueError("false_alarm_rate: expected above 0 and at most hold_back_rate, below 1")

    @property
    def asks_height(self) -> bool:
        """Does a verdict need road and antenna?"""
        return "height" in self.tests or "joint" in self.tests

    @property
    def asks_position(self) -> bool:
        """Does a verdict need the pose for more than the road below it?"""
        return "position" in self.tests or "joint" in self.tests

    @property
    def largest_tolerance_m(self) -> float:
        """No difference beyond it agrees; a height that is known worse than it says nothing."""
        return self.tolerance_m if self.tolerance == "fixed" else self.height_cap_m

    def limits(self) -> Limits:
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

        return Limits(
            self,
            pair("height", "height" in self.tests),
            pair("position", self.asks_position),
            pair("joint", "joint" in self.tests),
        )


@dataclass(frozen=True, slots=True)
class Limits:
    """Of each test the squared distance up to which a fix agrees, and that beyond which it contradicts.

    Infinite, both, for a test that is not asked; the position's are there for the joint test too.
    """

    rules: DeterminationRules
    height: tuple[float, float]
    position: tuple[float, float]
    joint: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Determination:
    """What the tests say of n fixes: one outcome each, the words of the tests, and what they rest on, all (n,).

    `tolerance_m` is the largest height difference that would agree, `reach_m` how far from the pose a fix may be and
    agree in any direction. `position` is the word of the horizontal position where it or the joint test is asked.
    """

    outcome: Words
    position: Words
    distances: Distances
    tolerance_m: Floats
    reach_m: Floats


def determine(
    difference_m: Floats, covariance_m2: Floats, pose_covariance_m2: Floats, limits: Limits
) -> Determination:
    """What differences (n, 3) say, if those of right fixes have the covariances (n, 3, 3); see `joint_test`.

    `pose_covariance_m2` (n, 2, 2) is the part of the pose in that.
    """
    rules, found = limits.rules, distances(difference_m, covariance_m2)
    off_m = np.abs(difference_m[:, 2])
    tolerance_m = _tolerance_m(found.height_sigma_m, limits)
    if rules.tolerance == "fixed" and "height" in rules.tests:
        height = np.where(off_m <= tolerance_m, AGREES, CONTRADICTS).astype(np.int8)
    else:
        height = words(found.height, *limits.height)
    position, joint = words(found.position, *limits.position), words(found.joint, *limits.joint)
    near_m2 = pose_covariance_m2 + np.eye(2) * rules.fix_sigma_cap_m**2
    reach_m = np.minimum(_reach_m(covariance_m2, limits), _reach_m(near_m2, limits))
    far = (position == AGREES) & ~(_squared(difference_m[:, :2], near_m2) <= limits.position[0])
    far &= rules.asks_position
    position[far] = UNVERIFIED
    # However wide σ is, no height agrees beyond the tolerance; and a test of the position alone has to have power.
    tall = ~(off_m <= tolerance_m) if rules.asks_height else np.zeros(off_m.shape, np.bool_)
    blunt = np.full(off_m.shape, rules.asks_position and not rules.asks_height) & ~(
        reach_m <= rules.position_cap_m
    )
    aside = position if "position" in rules.tests else np.where(far, UNVERIFIED, AGREES).astype(np.int8)
    nearer_up = found.height >= found.position
    outcome = np.full(off_m.shape, ALL_AGREE, np.int8)
    # What is said later overrides what was said before.
    for applies, said in (
        (joint == UNVERIFIED, POSITION_UNVERIFIED),
        ((joint == UNVERIFIED) & nearer_up, HEIGHT_UNVERIFIED),
        ((aside == UNVERIFIED) | blunt, POSITION_UNVERIFIED),
        ((height == UNVERIFIED) | tall, HEIGHT_UNVERIFIED),
        (joint == CONTRADICTS, BOTH_CONTRADICT),
        (aside == CONTRADICTS, POSITION_CONTRADICTS),
        (height == CONTRADICTS, HEIGHT_CONTRADICTS),
        ((height == CONTRADICTS) & (aside == CONTRADICTS), BOTH_CONTRADICT),
    ):
        outcome[applies] = said
    return Determination(outcome, position, found, tolerance_m, reach_m)


def _tolerance_m(sigma_m: Floats, limits: Limits) -> Floats:
    rules = limits.rules
    if rules.tolerance == "fixed":
        return np.full(sigma_m.shape, rules.tolerance_m)
    return np.minimum(rules.height_cap_m, math.sqrt(limits.height[0]) * sigma_m)


def _squared(aside_m: Floats, covariance_m2: Floats) -> Floats:
    """dᵀ C⁻¹ d (n,) of d (n, 2); not a number where C (n, 2, 2) is no covariance."""
    a, b, c = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    x, y = aside_m[:, 0], aside_m[:, 1]
    determinant = a * c - b * b
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        squared = (c * x * x - 2.0 * b * x * y + a * y * y) / np.where(
            (a > 0.0) & (determinant > 0.0), determinant, np.nan
        )
    return np.asarray(squared)


def _reach_m(covariance_m2: Floats, limits: Limits) -> Floats:
    ee, en, nn = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    larger: Floats = 0.5 * (ee + nn) + np.hypot(0.5 * (ee - nn), en)
    return np.sqrt(np.where(larger > 0.0, limits.position[0] * larger, np.nan))
