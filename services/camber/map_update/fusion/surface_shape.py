"""How much the offset from the reference varies within a surface, which one offset per surface cannot describe.

At the end of a resurfaced road the offset falls to zero within one surface. The samples of each vote then differ for
every vehicle alike, which distinguishes this case from vehicles that contradict one another.
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.votes import Floats, Integers

_MEDIAN_CHI2 = 0.839
"""Median of χ² with 4 degrees of freedom (3.357), divided by 4: the variance of five samples has four."""
_MEDIAN_VARIANCE_RATIO = 0.4
"""Variance of the median of five over that of one: 0.29 for normal, 0.43 for uniform errors (r² / 28 over r² / 12)."""


def shape_spread(begins: Integers, variance_m2: Floats) -> Floats:
    """Return the spread (surfaces,) of the offset within each surface, from the sample variances (n,) of its votes.

    The median over the votes rejects the noise of single vehicles; the noise of a pass is included.
    """
    spread_m: Floats = np.sqrt(finite_medians(begins, variance_m2) / _MEDIAN_CHI2)
    return spread_m


def shape_variance_m2(spread_m: Floats) -> Floats:
    """Return what the shape adds to the variance of votes on each surface (surfaces,), beyond the usual spread."""
    if len(spread_m) == 0:
        return spread_m
    added: Floats = _MEDIAN_VARIANCE_RATIO * np.maximum(spread_m**2 - np.median(spread_m) ** 2, 0.0)
    return added


@compiled_without_gil
def finite_medians(begins: Integers, value: Floats) -> Floats:
    """Return the median (groups,) of each group's values that are not NaN; 0 for groups without any."""
    n = len(begins) - 1
    median = np.zeros(n)
    for i in range(n):
        group = value[begins[i] : begins[i + 1]]
        group = group[~np.isnan(group)]
        if len(group) > 0:
            median[i] = np.median(group)
    return median
