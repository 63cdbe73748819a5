"""Row 1 of h (3), `-x sin(alpha) + y cos(alpha) + c - r = 0`: the map's link holds the pose across the road.

A coarse link departs from its road by up to metres, and slowly: applied at every epoch as if independent, row 1
would claim `sigma / sqrt(n)`. So `r = lane + deviation` is part of the state: `lane`, the vehicle's offset from
the road's line, stays (it walks a little with the distance, and more in a turn); `deviation` is a Gauss-Markov
process along the distance travelled, of the link's own sigma and a length of `deviation_length_m`; and all links
of a neighbourhood may lie off to one side, as those do that were drawn from one picture: a shift east and north by a
share of their sigma, which no amount of driving along them shows. As a perfect
measurement of the state `(X, r)` row 1 may then be applied as often as one likes: what is old in it brings no
gain. Its length is that after which a link has another error, which is set by its vertices: with one taken too long
a bend seems to lie off as the road before it does, and shows the way along better than it can. The document's "r stays
what it was when the satellites were lost" is the case of a zero distance; every anchor measures r anew through the
correlations. At a standstill there is nothing to gain and nothing is coupled.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.filter.dead_reckoning import EAST, NORTH, YAW
from camber.localizer.filter.filter_state import DEVIATION, LANE, SHIFT_EAST, SHIFT_NORTH, FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_filter import jacobian_s, jacobian_x, observation, wrapped
from camber.localizer.links.link_matching import LinkId, LinkMatch
from camber.localizer.links.link_offset_memory import LinkOffsetMemory

CouplingOutcome: TypeAlias = Literal[
    "coupled",
    "no_pose",
    "no_heading",
    "standing",
    "not_matched",
    "too_soon",
    "not_parallel",
    "near_bend",
    "rejected",
]


class CouplingResult(NamedTuple):
    """What became of a link; innovation of row 1 (m) and its normalised square (1 degree of freedom)."""

    outcome: CouplingOutcome
    innovation_m: float | None = None
    nis: float | None = None


class LinkCoupling:
    """The link in use, and what is known of the vehicle's offset from it."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self._memory = LinkOffsetMemory(state, model)
        self.match = LinkMatch("none")
        self.sigma_m = 0.0  # of the link in use
        self.coupled_ns: int | None = None
        self.forget()

    def forget(self) -> None:
        """The pose is another one: what was known of the offset says nothing any more."""
        state = self._state
        self._memory.forget()
        self._coupled_at_m = -math.inf
        self._alpha: float | None = None
        self._link: LinkId | None = None
        self._forward = True
        self._rejections = 0
        state.set_independent(LANE, self._model.lane_sigma_m**2)
        state.set_independent(DEVIATION, 0.0)
        state.x[LANE] = state.x[DEVIATION] = 0.0
        for index in (SHIFT_EAST, SHIFT_NORTH):
            state.set_independent(index, 1.0)
            state.x[index] = 0.0

    def set_link(self, match: LinkMatch) -> None:
        """The link of now, whether it is coupled or not."""
        self.match = match
        if match.status == "none":
            self._alpha = None

    def shifted(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north)."""
        if self.match.line is not None:
            self.match = replace(self.match, line=self.match.line.shifted(east_m, north_m))

    def couple(
        self, time_ns: int | None, travelled_m: float, *, standing: bool, heading_known: bool
    ) -> CouplingResult:
        """Couple with the link of now, where due and where its direction means something."""
        refusal = self._refuse(travelled_m, standing, heading_known)
        if refusal is not None or self.match.line is None:
            return CouplingResult(refusal or "not_matched")
        self._enter()
        self._coupled_at_m = travelled_m
        self._memory.recall(self.match, self._along_sigma_m(self.match.line.alpha_rad))
        result = self._couple_offset()
        if result.outcome == "coupled":
            self.coupled_ns = time_ns
            self._memory.keep(self.match)
        return result

    def _refuse(self, travelled_m: float, standing: bool, heading_known: bool) -> CouplingOutcome | None:
        model, match, p = self._model, self.match, self._state.p
        if match.status != "matched" or match.line is None:
            return "not_matched"
        if not heading_known:
            return "no_heading"
        if standing:
            return "standing"
        if travelled_m - self._coupled_at_m < model.couple_every_m:
            return "too_soon"
        turn = abs(wrapped(float(self._state.x[YAW]) - match.line.alpha_rad))
        sigma = math.sqrt(p[YAW, YAW] + model.parallel_sigma_rad**2)
        if turn > min(3.0 * sigma, model.parallel_max_rad):
            return "not_parallel"
        along_m = 2.0 * self._along_sigma_m(match.line.alpha_rad)
        clearance = model.bend_clearance_m + min(along_m, model.bend_max_sigma_m)
        return "near_bend" if match.to_sharp_m < clearance else None

    def _along_sigma_m(self, alpha_rad: float) -> float:
        p, cos, sin = self._state.p, math.cos(alpha_rad), math.sin(alpha_rad)
        along = p[EAST, EAST] * cos * cos + p[NORTH, NORTH] * sin * sin + 2.0 * p[EAST, NORTH] * sin * cos
        return math.sqrt(max(0.0, float(along)))

    def _enter(self) -> None:
        """On a new road alpha and c change and the lane stays, within what a turn does to it; the deviation
        of a road that runs straight on is the same, of one in another direction a new one."""
        match = self.match
        assert match.line is not None
        model, before, x, p = self._model, self._alpha, self._state.x, self._state.p
        self.sigma_m = match.sigma_m
        turned_back = self._link == match.link_id and self._forward != match.forward
        if before is None:
            x[DEVIATION] = 0.0
            self._state.set_independent(DEVIATION, match.sigma_m**2)
            p[LANE, LANE] += model.lane_turn_sigma_m**2
        elif turned_back:
            for index in (DEVIATION, LANE):
                self._state.negate(index)
            p[LANE, LANE] += 4.0 * model.lane_turn_sigma_m**2
        elif abs(wrapped(match.line.alpha_rad - before)) > model.new_road_rad:
            cos = math.cos(match.line.alpha_rad - before)
            self._state.renew(DEVIATION, max(0.0, cos), match.sigma_m)
            p[LANE, LANE] += (1.0 - cos) * model.lane_turn_sigma_m**2
        self._alpha, self._link = match.line.alpha_rad, match.link_id
        self._forward = match.forward

    def _couple_offset(self) -> CouplingResult:
        match, state = self.match, self._state
        assert match.line is not None
        x = state.x
        s = np.array([match.line.alpha_rad, match.line.c_m, x[LANE] + x[DEVIATION], 0.0])
        innovation = -observation(x[:3], s)[:1]
        h = self._state.rows(1)
        h[0, :3] = jacobian_x(s)[0]
        h[0, LANE] = h[0, DEVIATION] = jacobian_s(x[:3], s)[0, 2]
        shift_m = self._model.link_shift_share * match.sigma_m
        h[0, SHIFT_EAST] = shift_m * math.sin(match.line.alpha_rad)
        h[0, SHIFT_NORTH] = -shift_m * math.cos(match.line.alpha_rad)
        innovation -= h[0, SHIFT_EAST] * x[SHIFT_EAST] + h[0, SHIFT_NORTH] * x[SHIFT_NORTH]
        noise = np.array([[self._model.road_noise_m**2]])
        variance = float((h @ state.p @ h.T)[0, 0] + noise[0, 0])
        nis = float(innovation[0]) ** 2 / variance
        if nis > self._model.coupling_gate:
            self._rejections += 1
            if self._rejections < self._model.lane_change_after_rejections:
                return CouplingResult("rejected", float(innovation[0]), nis)
            state.set_independent(LANE, self._model.lane_sigma_m**2 + float(innovation[0]) ** 2)
            state.set_independent(DEVIATION, match.sigma_m**2)
        self._rejections = 0
        state.update(h, innovation, noise)
        return CouplingResult("coupled", float(innovation[0]), nis)
