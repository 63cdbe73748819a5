"""Memory of link deviations: a link that is driven again departs from its road as before.

Every `memory_cell_m` along a link the deviation is kept as a state, a clone of `DEVIATION` with all its
correlations. On return the deviation is that state again: errors that do not average are not averaged, and the
drift of dead reckoning since is observed. Without it a loop driven n times would claim a variance n times too small.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from camber.localizer.filter.filter_state import DEVIATION, FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_matching import LinkId, LinkMatch


class _LinkCell(NamedTuple):
    link_id: LinkId
    number: int


class _KeptDeviation(NamedTuple):
    cell: _LinkCell
    station_m: float
    forward: bool


class LinkOffsetMemory:
    """The deviations kept: one state each, after those of the filter, oldest first."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self._first = state.extra.stop
        self._kept: list[_KeptDeviation] = []
        self._here: _LinkCell | None = None

    def forget(self) -> None:
        """Delete all kept deviations: the pose is another one."""
        self._kept, self._here = [], None
        self._state.keep_first(self._first)

    def recall(self, match: LinkMatch, along_sigma_m: float) -> None:
        """Before a coupling: where a deviation was kept, make it the present one, plus variance for the distance
        to it."""
        cell = self._cell(match)
        if cell is None or cell == self._here:
            return
        for index, kept in enumerate(self._kept, self._first):
            if kept.cell == cell:
                self._here = cell
                state = self._state
                state.copy(index, DEVIATION)
                if kept.forward != match.forward:
                    state.negate(DEVIATION)
                apart_m = abs(match.station_m - kept.station_m) + along_sigma_m
                keep = math.exp(-apart_m / self._model.deviation_length_m)
                state.p[DEVIATION, DEVIATION] += 2.0 * (1.0 - keep) * match.sigma_m**2
                return

    def keep(self, match: LinkMatch) -> None:
        """After a coupling: keep the deviation, once per cell."""
        cell = self._cell(match)
        if cell is None or cell == self._here:
            return
        self._here = cell
        if len(self._kept) == self._model.memory_cells:
            del self._kept[0]
            self._state.drop(self._first)
        self._kept.append(_KeptDeviation(cell, match.station_m, match.forward))
        self._state.append_clone(DEVIATION)

    def _cell(self, match: LinkMatch) -> _LinkCell | None:
        if match.link_id is None:
            return None
        return _LinkCell(match.link_id, math.floor(match.station_m / self._model.memory_cell_m))
