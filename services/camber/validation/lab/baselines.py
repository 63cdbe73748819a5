"""The judge's determination and its baselines side by side: the same limits, fewer tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Integers
from camber.integrity.checks.chi2_test import Floats, TestOutcomes, difference_covariance
from camber.integrity.checks.consistency_tests import (
    ALL_AGREE,
    BOTH_CONTRADICT,
    HEIGHT_CONTRADICTS,
    ConsistencyLimits,
    consistency_of_arrays,
)
from camber.integrity.rules import Rules
from camber.validation.lab.error_model import ASSUMPTIONS, Scene, inflated_covariance, largest_variance

Booleans = NDArray[np.bool_]

JUDGE = "height and LiDAR"
ALL = "all, with residuals"
BASELINES = ("ratio only", "residuals only", "height only", "LiDAR only", JUDGE, ALL, "always no")
"""In the order of tables. `JUDGE` is the judge's determination without the engine's residual test."""


class BaselineDecisions:
    """Which fixes each baseline confirms by the product's limits, in a scene."""

    def __init__(self, rules: Rules, scene: Scene) -> None:
        self._rules, self._scene = rules, scene
        self._pose_m2 = np.eye(2)[None] * scene.pose_sigma_m**2
        limits = rules.determination
        self._all = limits.limits()
        self._height = replace(limits, tests=("height",)).limits()
        self._position = replace(limits, tests=("position",)).limits()

    def covariance(self, claimed_m2: Floats, slope: Floats) -> Floats:
        """S (n, 3, 3) as the judge makes it, of fixes with claimed covariances (n, 3, 3) on slopes (n, 2)."""
        n = len(claimed_m2)
        height_m2 = np.full(n, self._scene.map_sigma_m**2 + ASSUMPTIONS.antenna_sigma_m**2)
        fix_m2 = inflated_covariance(claimed_m2, self._rules)
        return difference_covariance(fix_m2, np.broadcast_to(self._pose_m2, (n, 2, 2)), height_m2, slope)

    def confirmed(
        self, difference_m: Floats, covariance_m2: Floats, of: Integers, residuals_agree: Booleans
    ) -> dict[str, Booleans]:
        """Of differences (m, 3) with the covariances (n, 3, 3) and residual tests (n,) of fixes `of` (m,).

        Only what could agree is computed: beyond the largest tolerance no height agrees, beyond the limit along the
        widest axis no position.
        """
        s, tolerance_m = covariance_m2, self._all.rules.largest_tolerance_m
        radius2 = max(self._all.position[0], self._position.position[0]) * largest_variance(s)
        height_near = np.abs(difference_m[:, 2]) <= tolerance_m
        position_near = difference_m[:, 0] ** 2 + difference_m[:, 1] ** 2 <= radius2[of]

        def where(could: Booleans, limits: ConsistencyLimits) -> Booleans:
            rows = np.flatnonzero(could)
            agrees = np.zeros(len(could), np.bool_)
            agrees[rows] = self._outcome(difference_m[rows], s[of[rows]], limits) == ALL_AGREE
            return agrees

        both, residuals = where(height_near & position_near, self._all), residuals_agree[of]
        return {
            "ratio only": np.ones(len(both), np.bool_),
            "residuals only": residuals,
            "height only": where(height_near, self._height),
            "LiDAR only": where(position_near, self._position),
            JUDGE: both,
            ALL: both & residuals,
            "always no": np.zeros(len(both), np.bool_),
        }

    def contradicted(self, difference_m: Floats, covariance_m2: Floats) -> Booleans:
        """Which of them the judge calls contradictory: of right fixes false alarms."""
        outcome = self._outcome(difference_m, covariance_m2, self._all)
        return np.asarray((outcome >= HEIGHT_CONTRADICTS) & (outcome <= BOTH_CONTRADICT))

    def agreed(self, difference_m: Floats, covariance_m2: Floats) -> Booleans:
        """Which of them the judge confirms."""
        return np.asarray(self._outcome(difference_m, covariance_m2, self._all) == ALL_AGREE)

    def _outcome(
        self, difference_m: Floats, covariance_m2: Floats, limits: ConsistencyLimits
    ) -> TestOutcomes:
        return consistency_of_arrays(difference_m, covariance_m2, self._pose_m2, limits).outcome
