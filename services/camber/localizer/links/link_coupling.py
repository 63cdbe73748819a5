"""Coupling of the pose with a link: row 1 of h, CN101360971 eq. (3), `-x sin(alpha) + y cos(alpha) + c - r = 0`.

`r` is the signed offset of the vehicle from the link's line, positive to its left; the document's unsigned one has
another form of `h` to the right. The optimum, eq. (9) to (13), is a Kalman update with these Jacobians.

A coarse link departs from its road by up to metres, and slowly: applied at every epoch as if independent, row 1
would claim `sigma / sqrt(n)`. So `r = lane + deviation` is part of the state. `lane`, the vehicle's offset from the
road's line, lasts (a random walk with the distance, more in a turn). `deviation` is a Gauss-Markov process along the
distance, of the link's σ and the length `deviation_length_m`, after which a link, by the distance of its vertices,
has another error: a longer one would claim the position along the road from a bend too precisely. All links of a
neighbourhood may also share a shift east and north, as those drawn from one aerial picture, by a share of their σ.

As an exact observation of `(X, r)`, row 1 may be applied repeatedly: what is not new has no gain. The document's "r
stays as when the satellites were lost" is the case of zero distance; every anchor observes r through the
correlations.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.filter.dead_reckoning_time_update import EAST, NORTH, YAW
from camber.localizer.filter.filter_state import DEVIATION, LANE, SHIFT_EAST, SHIFT_NORTH, FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_matching import LinkId, LinkMatch
from camber.localizer.links.link_offset_memory import LinkOffsetMemory

CouplingOutcome: TypeAlias = (
    Literal["coupled", "rejected", "no_pose", "no_heading", "standing"]
    | Literal["not_matched", "too_soon", "not_parallel", "near_bend"]
)


class LinkCoupling:
    """The link in use, and the states of the vehicle's offset from it."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self._memory = LinkOffsetMemory(state, model)
        self.match = LinkMatch(status="none")
        self.sigma_m = 0.0  # of the link in use
        self.forget()

    def forget(self) -> None:
        """Reset the offset: the pose is another one."""
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
        """Set the current link, whether it is coupled or not."""
        self.match = match
        if match.status == "none":
            self._alpha = None

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        if self.match.line is not None:
            self.match = replace(self.match, line=self.match.line.shifted(east_m, north_m))

    def couple(self, travelled_m: float, *, standing: bool, heading_known: bool) -> CouplingOutcome:
        """Couple with the current link, where due and where its direction is meaningful."""
        refusal = self._refusal(travelled_m, standing, heading_known)
        if refusal is not None or self.match.line is None:
            return refusal or "not_matched"
        self._enter_link()
        self._coupled_at_m = travelled_m
        self._memory.recall(self.match, self._along_sigma_m(self.match.line.alpha_rad))
        outcome = self._couple_offset()
        if outcome == "coupled":
            self._memory.keep(self.match)
        return outcome

    def _refusal(self, travelled_m: float, standing: bool, heading_known: bool) -> CouplingOutcome | None:
        model, match, p = self._model, self.match, self._state.p
        if match.status != "matched" or match.line is None:
            return "not_matched"
        if not heading_known:
            return "no_heading"
        if standing:
            return "standing"
        if travelled_m - self._coupled_at_m < model.couple_every_m:
            return "too_soon"
        turn = abs(wrap_pi(float(self._state.x[YAW]) - match.line.alpha_rad))
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

    def _enter_link(self) -> None:
        """Adapt the offset to a new link: the lane stays within what a turn changes; the deviation stays on a road that
        runs straight on and is new on one in another direction."""
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
        elif abs(wrap_pi(match.line.alpha_rad - before)) > model.new_road_rad:
            cos = math.cos(match.line.alpha_rad - before)
            self._state.renew(DEVIATION, max(0.0, cos), match.sigma_m)
            p[LANE, LANE] += (1.0 - cos) * model.lane_turn_sigma_m**2
        self._alpha, self._link = match.line.alpha_rad, match.link_id
        self._forward = match.forward

    def _couple_offset(self) -> CouplingOutcome:
        match, state = self.match, self._state
        assert match.line is not None
        x = state.x
        offset_m = match.line.offset_m(float(x[EAST]), float(x[NORTH]))
        innovation = np.array([-(offset_m - float(x[LANE] + x[DEVIATION]))])
        h = self._state.rows(1)
        h[0, EAST], h[0, NORTH] = match.line.normal
        h[0, LANE] = h[0, DEVIATION] = -1.0
        shift_m = self._model.link_shift_share * match.sigma_m
        h[0, SHIFT_EAST] = shift_m * math.sin(match.line.alpha_rad)
        h[0, SHIFT_NORTH] = -shift_m * math.cos(match.line.alpha_rad)
        innovation -= h[0, SHIFT_EAST] * x[SHIFT_EAST] + h[0, SHIFT_NORTH] * x[SHIFT_NORTH]
        noise = np.array([[self._model.road_noise_m**2]])
        variance = float((h @ state.p @ h.T)[0, 0] + noise[0, 0])
        if float(innovation[0]) ** 2 / variance > self._model.coupling_gate:
            self._rejections += 1
            if self._rejections < self._model.lane_change_after_rejections:
                return "rejected"
            state.set_independent(LANE, self._model.lane_sigma_m**2 + float(innovation[0]) ** 2)
            state.set_independent(DEVIATION, match.sigma_m**2)
        self._rejections = 0
        state.update(h, innovation, noise)
        return "coupled"
