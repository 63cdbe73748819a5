"""States of the errors of fixes' heights, beside a pose in one filter: common offset and its rate, fix, map.

The errors of fix and map have unit variance here, times their σ in an observation (`MapErrorModel`). With them as
states, repeated heights of one stretch give what they give once (SITAN with coloured noise: Hostetler and Andreas 1983,
by state augmentation, Gelb 1974, section 4.5).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from camber.localizer.filter.filter_state import FilterState
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.road_map.map_error_model import STATES

OFFSET: Final = 0  # index, from the first extra state
RATE: Final = 1  # index, of the offset
FIX: Final = 2  # index
MAP: Final = 3  # index of the first of the map's
HEIGHT_STATES: Final = 3 + STATES


class HeightStates:
    """The error states in `state.extra`, of which there are `HEIGHT_STATES`."""

    def __init__(self, state: FilterState, model: HeightErrorModel) -> None:
        self._state, self._model = state, model
        self._first = state.extra.start
        self._stepped = False
        self.reset()

    def reset(self) -> None:
        """Forget all of them: the position is another one."""
        self._reopen()
        stationary = self._model.map_errors.stationary_covariance
        for index in range(STATES):
            self._state.x[self._first + MAP + index] = 0.0
            self._state.set_independent(self._first + MAP + index, float(stationary[index, index]))

    def reopen(self) -> None:
        """Forget the fixes' part: they have stepped, and may have wrong integers from now on."""
        self._stepped = True
        self._reopen()

    def _reopen(self) -> None:
        model = self._model
        sigmas = {
            OFFSET: model.offset_sigma_m,
            RATE: model.stepped_rate_m_s if self._stepped else 0.0,
            FIX: 1.0,
        }
        for index, sigma in sigmas.items():
            self._state.x[self._first + index] = 0.0
            self._state.set_independent(self._first + index, sigma**2)

    def age(self, path_m: float, time_s: float) -> None:
        """Advance the errors over a path and a time."""
        model, x, p, extra = self._model, self._state.x, self._state.p, self._state.extra
        keep = math.exp(-time_s / model.fix_common_time_s)
        transition = np.eye(HEIGHT_STATES)
        transition[OFFSET, RATE] = time_s
        transition[FIX, FIX] = keep
        transition[MAP:, MAP:] = model.map_errors.transition(path_m)
        noise = np.zeros((HEIGHT_STATES, HEIGHT_STATES))
        noise[OFFSET, OFFSET] = model.offset_walk_m_sqrt_s**2 * time_s
        noise[FIX, FIX] = 1.0 - keep * keep
        noise[MAP:, MAP:] = model.map_errors.process_noise(path_m)
        x[extra] = transition @ x[extra]
        p[extra] = transition @ p[extra]
        p[:, extra] = p[:, extra] @ transition.T
        p[extra, extra] += noise

    def row(self, map_sigma_m: float, white_sigma_m: float) -> tuple[float, ...]:
        """Return the derivatives (`HEIGHT_STATES`,) of a height by the states, by σ of map and white noise."""
        common_m = float(self._model.fix_common_m(white_sigma_m))
        return 1.0, 0.0, common_m, *(map_sigma_m * self._model.map_errors.observation)
