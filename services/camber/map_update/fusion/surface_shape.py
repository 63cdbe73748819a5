"""How much the road departs from the reference's shape within a surface: what one offset cannot describe.

Where a resurfaced road ends the offset goes from all to nothing within a surface. The samples of each vote then differ,
for every vehicle alike: that is told from vehicles which contradict one another.
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.votes import Floats, Integers

_MEDIAN_CHI2 = 0.839
"""Median of χ² of 4 degrees of freedom, over 4."""
_OF_MEDIANS = 0.4
"""Variance of the median of five over that of one: 0.29 if normal, 0.43 if uniform (n = 5: r² / 28 over r² / 12)."""


def shapes_of(begins: Integers, variance_m2: Floats) -> Floats:
    """Spread (surfaces,) of the offset within each surface, from the variances (n,) of its votes' samples.

    The median over the votes: one vehicle's noise is not the road's. The noise of a pass is in it.
    """
    shape_m: Floats = np.sqrt(_medians_of_known(begins, variance_m2) / _MEDIAN_CHI2)
    return shape_m


def votes_shape_m2(shape_m: Floats) -> Floats:
    """What the shape adds to the variance of votes on each surface (surfaces,), beyond what is usual."""
    if len(shape_m) == 0:
        return shape_m
    added: Floats = _OF_MEDIANS * np.maximum(shape_m**2 - np.median(shape_m) ** 2, 0.0)
    return added


@compiled_without_gil
def _medians_of_known(begins: Integers, value: Floats) -> Floats:
    """Medians (groups,) of values that are numbers; 0 where none is."""
    n = len(begins) - 1
    middle = np.zeros(n)
    for i in range(n):
        one = value[begins[i] : begins[i + 1]]
        one = one[~np.isnan(one)]
        if len(one) > 0:
            middle[i] = np.median(one)
    return middle
