"""Protection levels by Kikuchi (TUMSAT), reliability index, as one of the two modes.

    RTK       HPL = a σ_RTK
    Doppler   HPL_t = HPL_{t−1} + a σ_GV      each 0.1 s
    sensors   HPL_t = HPL_{t−1} + a σ_DR      each 0.1 s

with a = √C, C = −2 ln(1 − P); b_p of R is the error of its reference and zero in operation. Upwards, where R has none,
the same with the normal distribution's quantile. A scan match, which R does not know, has an ellipse of its own. A
wrong fix is not bounded, as R states: the other mode is for that.
"""

from __future__ import annotations

import math
from dataclasses import replace

from camber.geodesy.covariance import confidence_scale
from camber.integrity.checks.chi2_test import chi2_limit
from camber.integrity.protection.position_bounds import Bounds, IndexRules

_STEP_S = 0.1  # Kikuchi (TUMSAT), reliability index: σ grows in each 0.1 s


class ReliabilityIndex:
    """Remembers the levels of the position before."""

    def __init__(self, rules: IndexRules) -> None:
        self._rules = rules
        self._horizontal = math.sqrt(confidence_scale(rules.probability))
        self._vertical = math.sqrt(chi2_limit(1.0 - rules.probability, 1))
        self._last: tuple[int, Bounds] | None = None

    def keep(self, time_ns: int, bounds: Bounds) -> None:
        """These are those of the position that was chosen."""
        if self._last is None or time_ns >= self._last[0]:
            self._last = (time_ns, bounds)

    def forget_future(self, limit_ns: int) -> None:
        """Drop what is dated later than this."""
        if self._last is not None and self._last[0] > limit_ns:
            self._last = None

    def bounds(self, source: str, time_ns: int, risk_bounds: Bounds, *, known: bool) -> Bounds:
        """With R's levels in place of its own, which go on from the last; `known`: there is a height."""
        rules = self._rules
        if source == "rtk":
            return self._with(risk_bounds, 0.0, 0.0, rules.rtk_m)
        if source == "scan_match":
            return replace(risk_bounds, horizontal_level_m=risk_bounds.semi_major_99_m)
        a_step_m = rules.doppler_m if source == "doppler" else rules.sensors_m
        if self._last is None:
            return replace(risk_bounds, horizontal_level_m=risk_bounds.semi_major_99_m)
        steps = max((time_ns - self._last[0]) / 1e9, 0.0) / _STEP_S
        before = self._last[1]
        vertical_m = before.vertical_level_m if known else math.inf
        return self._with(risk_bounds, before.horizontal_level_m, vertical_m, steps * a_step_m)

    def _with(self, risk_bounds: Bounds, horizontal_m: float, vertical_m: float, sigma_m: float) -> Bounds:
        return replace(
            risk_bounds,
            horizontal_level_m=horizontal_m + self._horizontal * sigma_m,
            vertical_level_m=vertical_m + self._vertical * sigma_m,
        )
