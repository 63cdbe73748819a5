"""Information filter of the rover's position and of the ambiguities of unbroken arcs, carried from epoch to epoch.

State: one single-difference ambiguity N_i [m] for each arc (satellite and signal, unbroken at rover and base), and the
position x of the present epoch. The information matrix Λ = C⁻¹ and the vector Λ μ are kept, so that what is not known
has no information, instead of a large variance (P. S. Maybeck, "Stochastic models, estimation, and control", 1 (1979),
5.7). Of each epoch

    phase − datum = d · x + N_i + clock of its group,   code = d · x + clock of its group.

A clock is new in each epoch and group and is eliminated at once, and so is the position of the epoch before: by a
Schur complement, linked to the new one where Doppler gives a displacement. Without discounts the result is that of one
least squares adjustment of all epochs. Only differences of ambiguities within a group are estimable: the factorisation
fixes one of them wherever its pivot vanishes, which changes no difference (minimal constraints: W. Baarda, "S-
transformations and criterion matrices", 1973).

Integers are never fed back: each epoch resolves them anew from the floats, so that no wrong one persists by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.observations.differenced_observations import SingleDifferences
from camber.gnss.observations.signal_pairs import GROUPS, Booleans

_LEAST_PIVOT = 1.0e-12
"""Share of the diagonal below which a pivot is rounding. Derived: given the position, ambiguities that share a group
with others have pivots of the order of their diagonal; without, of 1e-16 of it."""


class CarriedArcs(NamedTuple):
    """The n ambiguities of the state: numbers of the arc at rover and base, `datum_cycles` that N is relative to, and
    when the arc was seen last. `information` (n + 3, n + 3) and `vector` (n + 3,) have the position last, as an offset
    from `origin_ecef_m` (3,)."""

    rover_arc: Integers
    base_arc: Integers
    datum_cycles: Floats
    seen_ns: Integers
    held: Booleans
    information: Floats
    vector: Floats
    origin_ecef_m: Floats


class Factor(NamedTuple):
    """Λ with the ambiguities eliminated: L (n, n) of Λ_NN, its part of the position `side` (3, n), and what is left:
    information (3, 3) and vector (3,) of the position; `reduced` (n,) is L⁻¹ times the ambiguities' vector."""

    lower: Floats
    side: Floats
    position_information: Floats
    position_vector: Floats
    reduced: Floats


def no_arcs() -> CarriedArcs:
    """The state before the first epoch."""
    none = np.zeros(0, np.int64)
    return CarriedArcs(
        rover_arc=none,
        base_arc=none,
        datum_cycles=np.zeros(0),
        seen_ns=none,
        held=np.zeros(0, np.bool_),
        information=np.zeros((3, 3)),
        vector=np.zeros(3),
        origin_ecef_m=np.zeros(3),
    )


@compiled
def add_rows(
    information: Floats,
    vector: Floats,
    rows: SingleDifferences,
    column: Integers,
    value_m: Floats,
    weight: Floats,
) -> None:
    """Add rows (k,) of weight above 0, each of the ambiguity `column` (k,), −1 for none; clocks are eliminated."""
    k, n = column.size, vector.size - 3
    total = np.zeros(GROUPS)
    for i in range(k):
        if weight[i] > 0.0:
            total[rows.group[i]] += weight[i]
    for i in range(k):
        if not weight[i] > 0.0:
            continue
        for j in range(k):
            if not weight[j] > 0.0 or rows.group[j] != rows.group[i]:
                continue
            w = -weight[i] * weight[j] / total[rows.group[i]]
            if i == j:
                w += weight[i]
            a, b = column[i], column[j]
            if a >= 0:
                vector[a] += w * value_m[j]
                if b >= 0:
                    information[a, b] += w
            for axis in range(3):
                along = w * rows.direction[i, axis]
                vector[n + axis] += along * value_m[j]
                if b >= 0:
                    information[n + axis, b] += along
                    information[b, n + axis] += along
                for other in range(3):
                    information[n + axis, n + other] += along * rows.direction[j, other]


@compiled
def factor(information: Floats, vector: Floats) -> Factor:
    """Eliminate the ambiguities; one that nothing determines is fixed to zero."""
    n = vector.size - 3
    lower, side, reduced = np.zeros((n, n)), np.zeros((3, n)), np.zeros(n)
    for a in range(n):
        for b in range(a):
            total = information[a, b]
            for c in range(b):
                total -= lower[a, c] * lower[b, c]
            lower[a, b] = total / lower[b, b]
        pivot = information[a, a]
        for c in range(a):
            pivot -= lower[a, c] * lower[a, c]
        if not pivot > _LEAST_PIVOT * information[a, a]:
            pivot = max(information[a, a], 1.0)
        lower[a, a] = math.sqrt(pivot)
        total = vector[a]
        for c in range(a):
            total -= lower[a, c] * reduced[c]
        reduced[a] = total / lower[a, a]
        for axis in range(3):
            total = information[n + axis, a]
            for c in range(a):
                total -= lower[a, c] * side[axis, c]
            side[axis, a] = total / lower[a, a]
    position, right = information[n:, n:].copy(), vector[n:].copy()
    for axis in range(3):
        for c in range(n):
            right[axis] -= side[axis, c] * reduced[c]
            for other in range(3):
                position[axis, other] -= side[axis, c] * side[other, c]
    return Factor(lower, side, position, position_vector=right, reduced=reduced)


@compiled
def solution(parts: Factor, position_m: Floats, covariance_m2: Floats) -> tuple[Floats, Floats]:
    """μ (n + 3,) and C (n + 3, n + 3) for a position (3,) with covariance (3, 3), as it follows from the factor's."""
    n = parts.reduced.size
    inverse = np.zeros((n, n))
    for b in range(n):
        inverse[b, b] = 1.0 / parts.lower[b, b]
        for a in range(b + 1, n):
            total = 0.0
            for c in range(b, a):
                total += parts.lower[a, c] * inverse[c, b]
            inverse[a, b] = -total / parts.lower[a, a]
    # N = L⁻ᵀ (r − sideᵀ x): `turned` (n, 3) is L⁻ᵀ sideᵀ.
    turned, mean = np.zeros((n, 3)), np.empty(n + 3)
    for a in range(n):
        mean[a] = 0.0
        for c in range(a, n):
            mean[a] += inverse[c, a] * parts.reduced[c]
            for axis in range(3):
                turned[a, axis] += inverse[c, a] * parts.side[axis, c]
        for axis in range(3):
            mean[a] -= turned[a, axis] * position_m[axis]
    covariance = np.empty((n + 3, n + 3))
    for axis in range(3):
        mean[n + axis] = position_m[axis]
        for other in range(3):
            covariance[n + axis, n + other] = covariance_m2[axis, other]
    for a in range(n):
        for axis in range(3):
            total = 0.0
            for other in range(3):
                total -= turned[a, other] * covariance_m2[other, axis]
            covariance[a, n + axis] = covariance[n + axis, a] = total
    for a in range(n):
        for b in range(a + 1):
            total = 0.0
            for c in range(a, n):
                total += inverse[c, a] * inverse[c, b]
            for axis in range(3):
                total -= covariance[a, n + axis] * turned[b, axis]
            covariance[a, b] = covariance[b, a] = total
    return mean, covariance


@compiled
def at_next_epoch(
    arcs: CarriedArcs,
    origin_ecef_m: Floats,
    moved_m: Floats,
    link_information: Floats,
    since_ns: int,
) -> CarriedArcs:
    """The state at the next epoch's linearisation point, without arcs that were last seen before `since_ns`.

    The position has moved by `moved_m` (3,) with the information (3, 3); zeros where nothing links the two.
    """
    n = arcs.vector.size - 3
    information, vector = arcs.information.copy(), arcs.vector.copy()
    shift = arcs.origin_ecef_m + moved_m - origin_ecef_m
    for a in range(n + 3):
        for axis in range(3):
            vector[a] += arcs.information[a, n + axis] * shift[axis]
    information, vector = _with_process_noise(information, vector, link_information)
    kept = np.flatnonzero(arcs.seen_ns >= since_ns)
    information, vector = without(information, vector, arcs.seen_ns < since_ns)
    return CarriedArcs(
        rover_arc=arcs.rover_arc[kept],
        base_arc=arcs.base_arc[kept],
        datum_cycles=arcs.datum_cycles[kept],
        seen_ns=arcs.seen_ns[kept],
        held=arcs.held[kept],
        information=information,
        vector=vector,
        origin_ecef_m=origin_ecef_m,
    )


@compiled
def _with_process_noise(
    information: Floats, vector: Floats, link_information: Floats
) -> tuple[Floats, Floats]:
    """Add noise of information W (3, 3) to the position: Λ' = Λ − Λ_:x (Λ_xx + W)⁻¹ Λ_x:, one axis after another.

    The new position is the old one and noise: the old one is eliminated from the sum of both.
    """
    size = vector.size
    n = size - 3
    wide, right = np.zeros((size + 3, size + 3)), np.zeros(size + 3)
    # Order: ambiguities, new position, old position.
    wide[:n, :n] = information[:n, :n]
    wide[:n, size:] = information[:n, n:]
    wide[size:, :n] = information[n:, :n]
    wide[size:, size:] = information[n:, n:] + link_information
    wide[n:size, n:size] = link_information
    wide[n:size, size:] = -link_information
    wide[size:, n:size] = -link_information
    right[:n] = vector[:n]
    right[size:] = vector[n:]
    gone = np.zeros(size + 3, np.bool_)
    gone[size:] = True
    return _without_unknowns(wide, right, gone)


@compiled
def without(information: Floats, vector: Floats, gone: Booleans) -> tuple[Floats, Floats]:
    """Eliminate the ambiguities that are `gone` (n,)."""
    n = gone.size
    unknowns = np.zeros(n + 3, np.bool_)
    unknowns[:n] = gone
    return _without_unknowns(information, vector, unknowns)


@compiled
def _without_unknowns(information: Floats, vector: Floats, gone: Booleans) -> tuple[Floats, Floats]:
    """Schur complement, one unknown after another; one without information vanishes."""
    work, right = information.copy(), vector.copy()
    size = right.size
    left = ~gone
    for a in range(size):
        if not gone[a]:
            continue
        pivot = work[a, a]
        if pivot > _LEAST_PIVOT * information[a, a]:
            for b in range(size):
                if b == a or (gone[b] and b < a) or work[b, a] == 0.0:
                    continue
                share = work[b, a] / pivot
                right[b] -= share * right[a]
                for c in range(size):
                    work[b, c] -= share * work[a, c]
    kept = np.flatnonzero(left)
    out, rest = np.empty((kept.size, kept.size)), np.empty(kept.size)
    for a in range(kept.size):
        rest[a] = right[kept[a]]
        for b in range(kept.size):
            out[a, b] = 0.5 * (work[kept[a], kept[b]] + work[kept[b], kept[a]])
    return out, rest


@compiled
def with_new_arcs(arcs: CarriedArcs, rover_arc: Integers, base_arc: Integers, datum: Floats) -> CarriedArcs:
    """The state with further ambiguities (k,) of which nothing is known, after the others."""
    n, k = arcs.vector.size - 3, datum.size
    information, vector = np.zeros((n + k + 3, n + k + 3)), np.zeros(n + k + 3)
    place = np.empty(n + 3, np.int64)
    for a in range(n + 3):
        place[a] = a if a < n else a + k
    for a in range(n + 3):
        vector[place[a]] = arcs.vector[a]
        for b in range(n + 3):
            information[place[a], place[b]] = arcs.information[a, b]
    return CarriedArcs(
        rover_arc=np.concatenate((arcs.rover_arc, rover_arc)),
        base_arc=np.concatenate((arcs.base_arc, base_arc)),
        datum_cycles=np.concatenate((arcs.datum_cycles, datum)),
        seen_ns=np.concatenate((arcs.seen_ns, np.zeros(k, np.int64))),
        held=np.concatenate((arcs.held, np.zeros(k, np.bool_))),
        information=information,
        vector=vector,
        origin_ecef_m=arcs.origin_ecef_m,
    )
