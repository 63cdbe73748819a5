"""By how much each vehicle is off: a random effect of the vehicle and, within it, of its session.

    value = height of the surface + bias of the vehicle + of its session + error of the vote

A linear mixed model (Henderson 1975, "Best linear unbiased estimation and prediction under a selection model"): the
surfaces' heights are free, the biases are normal about zero, their variances are estimated from the data. What all
vehicles have in common is therefore the surfaces', not the vehicles'. Heights and biases are found in turns, each by
the biweight given the other, from medians on: a few rounds of backfitting (Buja, Hastie & Tibshirani 1989).

The bias that is taken off a vote is the prediction from the vehicle's votes **on other streets only** (blocks, squares
of some 300 m). A changed street is thus not explained away by the vehicles that drive there, whoever lies about one
street has nothing taken off there, and a vehicle seen nowhere else has no known bias: its prediction is zero and its
variance that of an unknown vehicle, which is what its vote then weighs.

Weight of a vote: its σ² over σ² + variance of the bias taken off + what the surface's shape adds, times (floor / σ
stated)² where a vehicle states a σ beyond the floor: nobody is louder by claiming to be surer. A session that is off by
six times what vehicles are is set aside as one whose cause is not known (a wrong fix of a whole drive, another
antenna): it has no say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.biweight import TUNING
from camber.map_update.fusion.votes import Floats, Integers

_MAD = 1.4826
_ROUNDS = 12
_DONE_M = 5e-5
_FEW_VOTES = 4.0
"""Sessions of less than this tell nothing of how sessions differ."""
_SET_ASIDE = 6.0


class Components(NamedTuple):
    """Standard deviations of the three parts of a vote."""

    vote_m: float = 0.014
    session_m: float = 0.015
    vehicle_m: float = 0.02


@dataclass(frozen=True, slots=True)
class BiasModel:
    """What is believed before there are data, and how firmly; see `Rules` of the fusion."""

    prior: Components = field(default_factory=Components)
    prior_count: float = 20.0
    """The prior is worth as many votes, sessions, vehicles."""
    least_vote_m: float = 0.005
    sigma_floor_m: float = 0.03
    known_share: float = 0.5
    """A bias is known when less than this share of an unknown one's variance is left."""


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Of each vote (n,): the bias to take off, its variance, its weight, and whether it is known from other streets."""

    bias_m: Floats
    variance_m2: Floats
    weight: Floats
    known: NDArray[np.bool_]
    components: Components
    voters: int


class _Groups(NamedTuple):
    """Votes in the order of voter, session and block; and where each begins, as rows of the one below."""

    order: Integers
    cell_begins: Integers
    """Cells, a session's votes in one block, in votes."""
    session_begins: Integers
    """In cells."""
    voter_begins: Integers
    """In sessions."""
    block: Integers
    """Of each cell, counted from 0."""


def biases_of(
    begins: Integers,
    block: Integers,
    voter: Integers,
    session: Integers,
    value_m: Floats,
    sigma_m: Floats,
    shape_m2: Floats,
    model: BiasModel,
) -> Biases:
    """Biases of votes (n,); those of surface i are rows `begins[i]` to `begins[i + 1]`, `block` (n,) is its street.

    `shape_m2` (surfaces,) is what a surface's shape adds to the variance of its votes.
    """
    groups = _grouped(block, voter, session)
    surface = np.repeat(np.arange(len(begins) - 1), np.diff(begins))
    own = np.minimum(1.0, (model.sigma_floor_m / np.maximum(sigma_m, model.sigma_floor_m)) ** 2)
    height_m = _medians(begins, value_m)
    components = model.prior
    session_m = np.zeros(len(groups.session_begins) - 1)
    uneven_m2 = shape_m2[surface]
    bias_m, variance_m2, weight = np.zeros(len(value_m)), np.zeros(len(value_m)), own
    for number in range(_ROUNDS):
        session_m, session_weight, cell_m, cell_weight = _session_means(
            groups.order,
            groups.cell_begins,
            groups.session_begins,
            value_m,
            own * components.vote_m**2 / (components.vote_m**2 + uneven_m2),
            height_m[surface],
            session_m,
            components.vote_m,
            number == 0,
        )
        residual_m = value_m - height_m[surface]
        components = _components(groups, residual_m, session_m, session_weight, begins, model)
        cell_bias_m, cell_variance_m2 = _predicted(
            groups.session_begins,
            groups.voter_begins,
            groups.block,
            session_m,
            session_weight,
            cell_m,
            cell_weight,
            *components,
        )
        bias_m, variance_m2 = _of_votes(groups.order, groups.cell_begins, cell_bias_m, cell_variance_m2)
        spread_m = math.hypot(components.session_m, components.vehicle_m)
        aside = np.maximum(1.0 - (bias_m / (_SET_ASIDE * spread_m)) ** 2, 0.0) ** 2
        weight = own * aside * components.vote_m**2 / (components.vote_m**2 + variance_m2 + uneven_m2)
        if number < 2:
            before_m, height_m = height_m, _medians(begins, value_m - bias_m)
        else:
            before_m = height_m
            height_m = _steps(begins, value_m - bias_m, weight, height_m, components.vote_m)
        if number > 2 and np.abs(height_m - before_m).max(initial=0.0) < _DONE_M:
            break
    unknown = components.session_m**2 + components.vehicle_m**2
    return Biases(
        bias_m,
        variance_m2,
        weight,
        variance_m2 < model.known_share * unknown,
        components,
        len(groups.voter_begins) - 1,
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
        order,
        np.append(np.flatnonzero(new_cell), len(order)),
        np.append(np.flatnonzero(new_session[new_cell]), np.count_nonzero(new_cell)),
        np.append(np.flatnonzero(new_voter[new_session]), np.count_nonzero(new_session)),
        b[new_cell],
    )


def _components(
    groups: _Groups,
    residual_m: Floats,
    session_m: Floats,
    session_weight: Floats,
    begins: Integers,
    model: BiasModel,
) -> Components:
    """The variances by medians of absolute deviations, each drawn to its prior where there is little to go by."""
    prior, votes, sessions = model.prior, len(residual_m), len(session_m)
    per_session = np.diff(groups.cell_begins[groups.session_begins])
    error_m = residual_m[groups.order] - np.repeat(session_m, per_session)
    free = votes - sessions - np.count_nonzero(np.diff(begins))
    own = _mad(error_m) ** 2 * votes / free if free > 0 else 0.0
    vote = max(_drawn(own, float(free), prior.vote_m, model.prior_count), model.least_vote_m**2)

    many = session_weight >= _FEW_VOTES
    voter = np.repeat(np.arange(len(groups.voter_begins) - 1), np.diff(groups.voter_begins))
    pair = np.flatnonzero(many[1:] & many[:-1] & (voter[1:] == voter[:-1]))
    inverse = np.zeros(sessions)
    inverse[many] = 1.0 / session_weight[many]
    difference = _mad(session_m[pair + 1] - session_m[pair]) ** 2 / 2.0
    noise = vote * float(np.mean(inverse[many])) if many.any() else 0.0
    session = _drawn(max(difference - noise, 0.0), len(pair), prior.session_m, model.prior_count)

    tells, first = np.unique(voter[many], return_index=True)
    middle = _mad_about_zero(_medians(np.append(first, np.count_nonzero(many)), session_m[many]))
    each = np.count_nonzero(many) / max(len(tells), 1)
    noise = (session + noise) / max(each, 1.0)
    vehicle = _drawn(max(middle**2 - noise, 0.0), len(tells), prior.vehicle_m, model.prior_count)
    return Components(math.sqrt(vote), math.sqrt(session), math.sqrt(vehicle))


def _drawn(own: float, count: float, prior_m: float, prior_count: float) -> float:
    count = max(count, 0.0)
    return (prior_count * prior_m**2 + count * own) / (prior_count + count)


def _mad(x: Floats) -> float:
    return _MAD * float(np.median(np.abs(x - np.median(x)))) if len(x) else 0.0


def _mad_about_zero(x: Floats) -> float:
    return _MAD * float(np.median(np.abs(x))) if len(x) else 0.0


@compiled_without_gil
def _medians(begins: Integers, value_m: Floats) -> Floats:
    n = len(begins) - 1
    middle_m = np.zeros(n)
    for i in range(n):
        if begins[i + 1] > begins[i]:
            middle_m[i] = np.median(value_m[begins[i] : begins[i + 1]])
    return middle_m


@compiled_without_gil
def _steps(begins: Integers, value_m: Floats, weight: Floats, height_m: Floats, vote_m: float) -> Floats:
    """One step of the biweight for each surface, from where it is."""
    stepped_m = height_m.copy()
    for i in range(len(begins) - 1):
        total, moment = 0.0, 0.0
        for k in range(begins[i], begins[i + 1]):
            off_m = value_m[k] - height_m[i]
            u2 = off_m * off_m * weight[k] / (TUNING * vote_m) ** 2
            if u2 < 1.0:
                say = weight[k] * (1.0 - u2) ** 2
                total += say
                moment += say * off_m
        if total > 0.0:
            stepped_m[i] += moment / total
    return stepped_m


@compiled_without_gil
def _session_means(
    order: Integers,
    cell_begins: Integers,
    session_begins: Integers,
    value_m: Floats,
    own: Floats,
    height_m: Floats,
    centre_m: Floats,
    vote_m: float,
    from_medians: bool,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Of each session its mean residual and weight, of each cell its sum of weighted residuals and weight.

    A vote's say is the biweight's about the session's last mean, or its median at first: the votes of a session that
    are of changed roads or wrong fixes have none.
    """
    sessions, cells = len(session_begins) - 1, len(cell_begins) - 1
    mean_m, weight = np.zeros(sessions), np.zeros(sessions)
    cell_m, cell_weight = np.zeros(cells), np.zeros(cells)
    for g in range(sessions):
        first, last = cell_begins[session_begins[g]], cell_begins[session_begins[g + 1]]
        residual_m = np.empty(last - first)
        for k in range(first, last):
            residual_m[k - first] = value_m[order[k]] - height_m[order[k]]
        middle_m = np.median(residual_m) if from_medians else centre_m[g]
        for c in range(session_begins[g], session_begins[g + 1]):
            for k in range(cell_begins[c], cell_begins[c + 1]):
                u2 = ((residual_m[k - first] - middle_m) / (TUNING * vote_m)) ** 2 * own[order[k]]
                if u2 < 1.0:
                    say = own[order[k]] * (1.0 - u2) ** 2
                    cell_weight[c] += say
                    cell_m[c] += say * residual_m[k - first]
            weight[g] += cell_weight[c]
            mean_m[g] += cell_m[c]
        mean_m[g] = mean_m[g] / weight[g] if weight[g] > 0.0 else middle_m
    return mean_m, weight, cell_m, cell_weight


@compiled_without_gil
def _predicted(
    session_begins: Integers,
    voter_begins: Integers,
    block: Integers,
    session_m: Floats,
    session_weight: Floats,
    cell_m: Floats,
    cell_weight: Floats,
    vote_m: float,
    of_session_m: float,
    of_vehicle_m: float,
) -> tuple[Floats, Floats]:
    """Best linear prediction, and its variance, of each cell's bias from what the voter said in other blocks.

    A session's mean of weight W over other blocks is the vehicle's bias plus N(0, session² + vote² / W); the vehicle's
    is predicted from all its sessions, then the session's from its own mean and the vehicle's. Sessions far from the
    vehicle's median have no say in its bias.
    """
    cells = len(block)
    bias_m, variance_m2 = np.zeros(cells), np.zeros(cells)
    blocks = block.max() + 1 if cells else 0
    less, less_m = np.zeros(blocks), np.zeros(blocks)
    vote2, session2, vehicle2 = vote_m**2, max(of_session_m**2, 1e-8), max(of_vehicle_m**2, 1e-8)
    for v in range(len(voter_begins) - 1):
        first, last = voter_begins[v], voter_begins[v + 1]
        middle_m = np.median(session_m[first:last])
        total, total_m = 0.0, 0.0
        for g in range(first, last):
            u2 = (session_m[g] - middle_m) ** 2 / (TUNING**2 * (session2 + vote2))
            trust = (1.0 - u2) ** 2 if u2 < 1.0 else 0.0
            if session_weight[g] <= 0.0:
                continue
            say = trust / (session2 + vote2 / session_weight[g])
            total += say
            total_m += say * session_m[g]
            for c in range(session_begins[g], session_begins[g + 1]):
                rest = session_weight[g] - cell_weight[c]
                less[block[c]] -= say
                less_m[block[c]] -= say * session_m[g]
                if rest > 1e-6 * session_weight[g]:
                    other = trust / (session2 + vote2 / rest)
                    less[block[c]] += other
                    less_m[block[c]] += other * (session_weight[g] * session_m[g] - cell_m[c]) / rest
        for g in range(first, last):
            for c in range(session_begins[g], session_begins[g + 1]):
                of_vehicle = 1.0 / (1.0 / vehicle2 + max(total + less[block[c]], 0.0))
                mean_m = of_vehicle * (total_m + less_m[block[c]])
                rest = session_weight[g] - cell_weight[c]
                if rest <= 1e-6 * max(session_weight[g], 1e-6):
                    bias_m[c], variance_m2[c] = mean_m, of_vehicle + session2
                    continue
                rest_m = (session_weight[g] * session_m[g] - cell_m[c]) / rest
                spread = 1.0 / (rest / vote2 + 1.0 / session2)
                bias_m[c] = spread * (rest_m * rest / vote2 + mean_m / session2)
                variance_m2[c] = spread + (spread / session2) ** 2 * of_vehicle
        for c in range(session_begins[first], session_begins[last]):
            less[block[c]] = 0.0
            less_m[block[c]] = 0.0
    return bias_m, variance_m2


@compiled_without_gil
def _of_votes(
    order: Integers, cell_begins: Integers, cell_bias_m: Floats, cell_variance_m2: Floats
) -> tuple[Floats, Floats]:
    bias_m, variance_m2 = np.empty(len(order)), np.empty(len(order))
    for c in range(len(cell_begins) - 1):
        for k in range(cell_begins[c], cell_begins[c + 1]):
            bias_m[order[k]], variance_m2[order[k]] = cell_bias_m[c], cell_variance_m2[c]
    return bias_m, variance_m2
