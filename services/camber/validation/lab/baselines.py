"""The judge's determination, and its controls side by side: the same limits, fewer tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from camber.integrity.checks.chi2_test import Floats, TestOutcomes
from camber.integrity.checks.consistency import (
    ALL_AGREE,
    BOTH_CONTRADICT,
    HEIGHT_CONTRADICTS,
    ConsistencyLimits,
    ConsistencyParameters,
    consistency_of_arrays,
)

Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

JUDGE = "height and LiDAR"
ALL = "all, with residuals"
BASELINES = ("ratio only", "residuals only", "height only", "LiDAR only", JUDGE, ALL, "always no")
"""In the order of tables. `JUDGE` is the judge's determination without what the engine says of its residuals."""


class BaselineDecisions:
    """Which of n fixes each control confirms, by the product's limits, beside poses of one σ."""

    def __init__(self, rules: ConsistencyParameters, pose_sigma_m: float) -> None:
        self._pose_m2 = np.eye(2)[None] * pose_sigma_m**2
        self._all = rules.limits()
        self._height = replace(rules, tests=("height",)).limits()
        self._position = replace(rules, tests=("position",)).limits()

    def confirmed(
        self, difference_m: Floats, covariance_m2: Floats, of: Integers, residuals_agree: Booleans
    ) -> dict[str, Booleans]:
        """Of differences (m, 3), of which the covariances (n, 3, 3) and the residuals' word (n,) are those `of` (m,).

        Only what could agree is computed: beyond the largest tolerance no height agrees, beyond the limit along the
        widest axis no position.
        """
        s, tolerance_m = covariance_m2, self._all.rules.largest_tolerance_m
        wide_m2 = 0.5 * (s[:, 0, 0] + s[:, 1, 1]) + np.hypot(0.5 * (s[:, 0, 0] - s[:, 1, 1]), s[:, 0, 1])
        reach2 = max(self._all.position[0], self._position.position[0]) * wide_m2
        level = np.abs(difference_m[:, 2]) <= tolerance_m
        aside = difference_m[:, 0] ** 2 + difference_m[:, 1] ** 2 <= reach2[of]

        def where(could: Booleans, limits: ConsistencyLimits) -> Booleans:
            rows = np.flatnonzero(could)
            agrees = np.zeros(len(could), np.bool_)
            agrees[rows] = self._outcome(difference_m[rows], s[of[rows]], limits) == ALL_AGREE
            return agrees

        both, residuals = where(level & aside, self._all), residuals_agree[of]
        return {
            "ratio only": np.ones(len(both), np.bool_),
            "residuals only": residuals,
            "height only": where(level, self._height),
            "LiDAR only": where(aside, self._position),
            JUDGE: both,
            ALL: both & residuals,
            "always no": np.zeros(len(both), np.bool_),
        }

    def contradicted(self, difference_m: Floats, covariance_m2: Floats) -> Booleans:
        """Which of them the judge calls contradictory: of right fixes false alarms."""
        outcome = self._outcome(difference_m, covariance_m2, self._all)
        found: Booleans = (outcome >= HEIGHT_CONTRADICTS) & (outcome <= BOTH_CONTRADICT)
        return found

    def agreed(self, difference_m: Floats, covariance_m2: Floats) -> Booleans:
        """Which of them the judge confirms."""
        found: Booleans = self._outcome(difference_m, covariance_m2, self._all) == ALL_AGREE
        return found

    def _outcome(
        self, difference_m: Floats, covariance_m2: Floats, limits: ConsistencyLimits
    ) -> TestOutcomes:
        return consistency_of_arrays(difference_m, covariance_m2, self._pose_m2, limits).outcome
