"""White noise of a receiver's heights, measured by the differences of neighbours.

What a receiver claims is another figure in each program; how much its heights change from one to the next is not.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.relief.height_errors import HeightErrorModel

LEAST_WHITE_SIGMA_M: Final = 0.003  # chosen: a heave of the vehicle on its springs
_DEVIATIONS: Final = 1.4826  # σ of a normal distribution by its median deviation
_MOST: Final = 100  # chosen: heights of half a kilometre
_LEAST_COUNT: Final = 20  # derived: σ by the median of as many is known to a quarter


def white_sigma_m(
    residual_m: Floats, places: Floats, map_sigma_m: Floats, model: HeightErrorModel
) -> float | None:
    """Return σ of heights (n,) less the map's elevations at places (n, 2), without what the map's errors change.

    `map_sigma_m` (n,); None where no two neighbours are known.
    """
    steps_m = np.diff(residual_m)
    known = np.isfinite(steps_m)
    if not known.any():
        return None
    apart_m = np.hypot(*np.diff(places, axis=0).T)
    map_m2 = (map_sigma_m[1:] ** 2 * (1.0 - model.map_errors.correlation(apart_m)))[known]
    change_m = _DEVIATIONS * float(np.median(np.abs(steps_m[known])))
    white_m2 = 0.5 * change_m**2 - float(np.median(map_m2))
    return float(np.sqrt(max(white_m2, LEAST_WHITE_SIGMA_M**2)))


class _Residual(NamedTuple):
    residual_m: float
    east_m: float
    north_m: float
    map_sigma_m: float


class WhiteNoise:
    """Keeps the newest residuals of a drive."""

    def __init__(self, model: HeightErrorModel) -> None:
        self._model = model
        self._residuals: deque[_Residual] = deque(maxlen=_MOST)

    def add(self, residual_m: float, place_m: tuple[float, float], map_sigma_m: float) -> None:
        """Add a height less the map's elevation at the place where it was taken."""
        self._residuals.append(_Residual(residual_m, *place_m, map_sigma_m))

    def forget(self) -> None:
        """Forget all: the place is another one."""
        self._residuals.clear()

    def sigma_m(self, claimed_m: float) -> float:
        """Return what was measured, at most what is claimed: an error of the place changes residuals too."""
        if len(self._residuals) < _LEAST_COUNT:
            return claimed_m
        table = np.array(self._residuals)
        measured_m = white_sigma_m(table[:, 0], table[:, 1:3], table[:, 3], self._model)
        return claimed_m if measured_m is None else min(measured_m, claimed_m)
