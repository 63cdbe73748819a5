"""Bias of each vehicle: a random effect of the vehicle and, within it, of its session.

    value = height of the surface + bias of the vehicle + bias of its session + error of the vote

A linear mixed model (Henderson 1975, "Best linear unbiased estimation and prediction under a selection model"): the
heights of the surfaces are free, the biases are normal about zero, and their variances are estimated from the data.
What all vehicles have in common is therefore attributed to the surfaces. Heights and biases are estimated in turns,
each by the biweight given the other, starting from medians (backfitting: Buja, Hastie & Tibshirani 1989).

The bias subtracted from a vote is predicted from the vehicle's votes **on other streets only** (blocks: squares of
some 300 m). A changed street is thus not explained away by the vehicles that drive there, and a vehicle that reports
false heights for one street gains nothing there. A vehicle seen nowhere else has no known bias: its prediction is zero
with the variance of an unknown vehicle, which determines the weight of its vote.

Weight of a vote: σ² / (σ² + variance of the predicted bias + variance of the surface's shape), times
(floor / stated σ)² where the stated σ exceeds the floor: claiming a smaller σ gains no weight. A session that deviates
by six times the spread of vehicles has an unknown cause (wrong fixes of a whole drive, another antenna) and gets no
weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.robust_surface_heights import MAD_TO_SIGMA, TUNING
from camber.map_update.fusion.surface_shape import finite_medians
from camber.map_update.fusion.votes import Floats, Integers

# Chosen: backfitting converges in five to eight iterations; the tolerance is half the step of published heights.
_ITERATIONS = 12
_TOLERANCE_M = 5e-5
_LEAST_SESSION_WEIGHT = 4.0
"""Chosen: sessions with a smaller sum of weights say nothing about the spread of sessions."""
_SESSION_CUTOFF = 6.0
"""Chosen: spreads of an unknown vehicle beyond which a session gets no weight; a right drive never reaches it."""


class VarianceComponents(NamedTuple):
    """Standard deviations of the three random parts of a vote."""

    vote_m: float
    session_m: float
    vehicle_m: float


# Chosen on the fleet scenario, seeds 1, 2 and 4 (docs/fusion.md).
_PRIOR = VarianceComponents(vote_m=0.014, session_m=0.015, vehicle_m=0.02)
_PRIOR_COUNT = 20.0
"""The prior counts as this many votes, sessions, vehicles."""
_LEAST_VOTE_M = 0.005
"""Floor of the estimated spread of a vote."""
_SIGMA_FLOOR_M = 0.03
"""A vote gains no weight by stating a smaller σ."""
_KNOWN_SHARE = 0.5
"""A bias is known when its variance is below this share of an unknown vehicle's."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Biases:
    """For each vote (n,): predicted bias, its variance, the vote's weight, and whether the bias is known."""

    bias_m: Floats
    variance_m2: Floats
    weight: Floats
    known: NDArray[np.bool_]
    components: VarianceComponents
    voters: int


class _Groups(NamedTuple):
    """Votes sorted by voter, session and block, and where each group begins, counted in the groups one level below."""

    order: Integers
    cell_begins: Integers
    """Cells, a session's votes in one block, in votes."""
    session_begins: Integers
    """In cells."""
    voter_begins: Integers
    """In sessions."""
    block: Integers
    """Of each cell, counted from 0."""


class _SessionMeans(NamedTuple):
    """Mean residual and weight of each session; sum of weighted residuals and weight of each cell."""

    session_m: Floats
    session_weight: Floats
    cell_m: Floats
    cell_weight: Floats


def estimate_biases(
    begins: Integers,
    *,
    block: Integers,
    voter: Integers,
    session: Integers,
    value_m: Floats,
    sigma_m: Floats,
    shape_m2: Floats,
) -> Biases:
    """Return the biases of votes (n,); those of surface i are rows `begins[i]` to `begins[i + 1]`.

    `block` (n,) is the street of a vote; `shape_m2` (surfaces,) the variance that a surface's shape adds to its votes.
    """
    groups = _grouped(block, voter, session)
    surface = np.repeat(np.arange(len(begins) - 1), np.diff(begins))
    stated = np.minimum(1.0, (_SIGMA_FLOOR_M / np.maximum(sigma_m, _SIGMA_FLOOR_M)) ** 2)
    height_m = finite_medians(begins, value_m)
    components = _PRIOR
    session_m = np.zeros(len(groups.session_begins) - 1)
    vote_shape_m2 = shape_m2[surface]
    bias_m, variance_m2, weight = np.zeros(len(value_m)), np.zeros(len(value_m)), stated
    for iteration in range(_ITERATIONS):
        means = _session_means(
            groups,
            value_m - height_m[surface],
            stated * components.vote_m**2 / (components.vote_m**2 + vote_shape_m2),
            centre_m=session_m,
            vote_m=components.vote_m,
            from_medians=iteration == 0,
        )
        session_m = means.session_m
        components = _estimate_components(groups, value_m - height_m[surface], means, begins)
        bias_m, variance_m2 = _predict_biases(groups, means, components)
        spread_m = math.hypot(components.session_m, components.vehicle_m)
        robust = np.maximum(1.0 - (bias_m / (_SESSION_CUTOFF * spread_m)) ** 2, 0.0) ** 2
        weight = stated * robust * components.vote_m**2 / (components.vote_m**2 + variance_m2 + vote_shape_m2)
        previous_m = height_m
        if iteration < 2:
            height_m = finite_medians(begins, value_m - bias_m)
        else:
            height_m = _biweight_step(begins, value_m - bias_m, weight, height_m, vote_m=components.vote_m)
        if iteration > 2 and np.abs(height_m - previous_m).max(initial=0.0) < _TOLERANCE_M:
            break
    unknown_m2 = components.session_m**2 + components.vehicle_m**2
    return Biases(
        bias_m=bias_m,
        variance_m2=variance_m2,
        weight=weight,
        known=variance_m2 < _KNOWN_SHARE * unknown_m2,
        components=components,
        voters=len(groups.voter_begins) - 1,
    )


def _grouped(block: Integers, voter: Integers, session: Integers) -> _Groups:
    _, block = np.unique(block, return_inverse=True)
    order = np.lexsort((block, session, voter))
    v, s, b = voter[order], session[order], block[order]
    new_voter = np.ones(len(order), bool)
    new_voter[1:] = v[1:] != v[:-1]
    new_session = new_voter.copy()
    new_session[1:] |= s[1:] != s[:-1]
    new_cell = new_session.copy()
    new_cell[1:] |= b[1:] != b[:-1]
    return _Groups(
        order=order,
        cell_begins=np.append(np.flatnonzero(new_cell), len(order)),
        session_begins=np.append(np.flatnonzero(new_session[new_cell]), np.count_nonzero(new_cell)),
        voter_begins=np.append(np.flatnonzero(new_voter[new_session]), np.count_nonzero(new_session)),
        block=b[new_cell],
    )


def _estimate_components(
    groups: _Groups, residual_m: Floats, means: _SessionMeans, begins: Integers
) -> VarianceComponents:
    """Return the components by median absolute deviations, each pooled with its prior."""
    votes, sessions = len(residual_m), len(means.session_m)
    per_session = np.diff(groups.cell_begins[groups.session_begins])
    error_m = residual_m[groups.order] - np.repeat(means.session_m, per_session)
    free = votes - sessions - np.count_nonzero(np.diff(begins))
    observed = _mad(error_m) ** 2 * votes / free if free > 0 else 0.0
    vote = max(_pooled(observed, float(free), _PRIOR.vote_m), _LEAST_VOTE_M**2)

    many = means.session_weight >= _LEAST_SESSION_WEIGHT
    voter = np.repeat(np.arange(len(groups.voter_begins) - 1), np.diff(groups.voter_begins))
    pair = np.flatnonzero(many[1:] & many[:-1] & (voter[1:] == voter[:-1]))
    inverse = np.zeros(sessions)
    inverse[many] = 1.0 / means.session_weight[many]
    difference = _mad(means.session_m[pair + 1] - means.session_m[pair]) ** 2 / 2.0
    noise = vote * float(np.mean(inverse[many])) if many.any() else 0.0
    session = _pooled(max(difference - noise, 0.0), len(pair), _PRIOR.session_m)

    seen, first = np.unique(voter[many], return_index=True)
    centre_m = finite_medians(np.append(first, np.count_nonzero(many)), means.session_m[many])
    spread_m = MAD_TO_SIGMA * float(np.median(np.abs(centre_m))) if len(centre_m) else 0.0
    each = np.count_nonzero(many) / max(len(seen), 1)
    noise = (session + noise) / max(each, 1.0)
    vehicle = _pooled(max(spread_m**2 - noise, 0.0), len(seen), _PRIOR.vehicle_m)
    return VarianceComponents(math.sqrt(vote), math.sqrt(session), math.sqrt(vehicle))


def _pooled(observed: float, count: float, prior_m: float) -> float:
    """Return the mean of an observed and a prior variance, weighted by their counts."""
    count = max(count, 0.0)
    return (_PRIOR_COUNT * prior_m**2 + count * observed) / (_PRIOR_COUNT + count)


def _mad(x: Floats) -> float:
    return MAD_TO_SIGMA * float(np.median(np.abs(x - np.median(x)))) if len(x) else 0.0


@compiled_without_gil
def _biweight_step(
    begins: Integers, value_m: Floats, weight: Floats, height_m: Floats, vote_m: float
) -> Floats:
    """Return the heights after one iteration of the biweight for each surface."""
    stepped_m = height_m.copy()
    for i in range(len(begins) - 1):
        total, moment = 0.0, 0.0
        for k in range(begins[i], begins[i + 1]):
            residual_m = value_m[k] - height_m[i]
            u2 = residual_m * residual_m * weight[k] / (TUNING * vote_m) ** 2
            if u2 < 1.0:
                robust = weight[k] * (1.0 - u2) ** 2
                total += robust
                moment += robust * residual_m
        if total > 0.0:
            stepped_m[i] += moment / total
    return stepped_m


@compiled_without_gil
def _session_means(
    groups: _Groups, residual_m: Floats, stated: Floats, centre_m: Floats, vote_m: float, from_medians: bool
) -> _SessionMeans:
    """Return the mean residual of each session and the sums of each cell.

    Votes are weighted by the biweight about the session's last mean, at first its median: votes of changed roads or
    wrong fixes get no weight.
    """
    order, cell_begins, session_begins = groups.order, groups.cell_begins, groups.session_begins
    sessions, cells = len(session_begins) - 1, len(cell_begins) - 1
    mean_m, weight = np.zeros(sessions), np.zeros(sessions)
    cell_m, cell_weight = np.zeros(cells), np.zeros(cells)
    for g in range(sessions):
        first, last = cell_begins[session_begins[g]], cell_begins[session_begins[g + 1]]
        of_session_m = residual_m[order[first:last]]
        middle_m = np.median(of_session_m) if from_medians else centre_m[g]
        for c in range(session_begins[g], session_begins[g + 1]):
            for k in range(cell_begins[c], cell_begins[c + 1]):
                u2 = ((of_session_m[k - first] - middle_m) / (TUNING * vote_m)) ** 2 * stated[order[k]]
                if u2 < 1.0:
                    robust = stated[order[k]] * (1.0 - u2) ** 2
                    cell_weight[c] += robust
                    cell_m[c] += robust * of_session_m[k - first]
            weight[g] += cell_weight[c]
            mean_m[g] += cell_m[c]
        mean_m[g] = mean_m[g] / weight[g] if weight[g] > 0.0 else middle_m
    return _SessionMeans(mean_m, weight, cell_m, cell_weight)


@compiled_without_gil
def _predict_biases(
    groups: _Groups, means: _SessionMeans, components: VarianceComponents
) -> tuple[Floats, Floats]:
    """Return the best linear prediction of each vote's bias, and its variance, from the voter's other blocks.

    A session's mean of weight W over other blocks is the vehicle's bias plus N(0, session² + vote² / W). The vehicle's
    bias is predicted from all its sessions, then the session's from its own mean and the vehicle's. Sessions far from
    the vehicle's median get no weight.
    """
    session_begins, voter_begins, block = groups.session_begins, groups.voter_begins, groups.block
    session_m, session_weight, cell_m, cell_weight = means
    cells = len(block)
    bias_m, variance_m2 = np.zeros(cells), np.zeros(cells)
    blocks = block.max() + 1 if cells else 0
    # Per block: the change of the sums where that block's votes are left out.
    less, less_m = np.zeros(blocks), np.zeros(blocks)
    vote2 = components.vote_m**2
    session2, vehicle2 = max(components.session_m**2, 1e-8), max(components.vehicle_m**2, 1e-8)
    for v in range(len(voter_begins) - 1):
        first, last = voter_begins[v], voter_begins[v + 1]
        median_m = np.median(session_m[first:last])
        total, total_m = 0.0, 0.0
        for g in range(first, last):
            u2 = (session_m[g] - median_m) ** 2 / (TUNING**2 * (session2 + vote2))
            robust = (1.0 - u2) ** 2 if u2 < 1.0 else 0.0
            if session_weight[g] <= 0.0:
                continue
            weight = robust / (session2 + vote2 / session_weight[g])
            total += weight
            total_m += weight * session_m[g]
            for c in range(session_begins[g], session_begins[g + 1]):
                rest = session_weight[g] - cell_weight[c]
                less[block[c]] -= weight
                less_m[block[c]] -= weight * session_m[g]
                if rest > 1e-6 * session_weight[g]:
                    other = robust / (session2 + vote2 / rest)
                    less[block[c]] += other
                    less_m[block[c]] += other * (session_weight[g] * session_m[g] - cell_m[c]) / rest
        for g in range(first, last):
            for c in range(session_begins[g], session_begins[g + 1]):
                vehicle_variance = 1.0 / (1.0 / vehicle2 + max(total + less[block[c]], 0.0))
                vehicle_m = vehicle_variance * (total_m + less_m[block[c]])
                rest = session_weight[g] - cell_weight[c]
                if rest <= 1e-6 * max(session_weight[g], 1e-6):
                    bias_m[c], variance_m2[c] = vehicle_m, vehicle_variance + session2
                    continue
                rest_m = (session_weight[g] * session_m[g] - cell_m[c]) / rest
                variance = 1.0 / (rest / vote2 + 1.0 / session2)
                bias_m[c] = variance * (rest_m * rest / vote2 + vehicle_m / session2)
                variance_m2[c] = variance + (variance / session2) ** 2 * vehicle_variance
        for c in range(session_begins[first], session_begins[last]):
            less[block[c]] = 0.0
            less_m[block[c]] = 0.0
    vote_bias_m, vote_variance_m2 = np.empty(len(groups.order)), np.empty(len(groups.order))
    for c in range(cells):
        for k in range(groups.cell_begins[c], groups.cell_begins[c + 1]):
            vote_bias_m[groups.order[k]], vote_variance_m2[groups.order[k]] = bias_m[c], variance_m2[c]
    return vote_bias_m, vote_variance_m2
