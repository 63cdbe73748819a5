"""LAMBDA, second half: search of the integer vectors nearest to decorrelated float ambiguities.

Sources: Chang, Yang and Zhou, MLAMBDA, J. Geodesy 79 (2005); Schnorr and Euchner (1994): integers of a level are
tried in the order of their distance, and the search ellipsoid shrinks to the worst candidate kept.
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats


@compiled
def nearest_integers(
    upper: Floats, variances: Floats, floats: Floats, wanted: int, most_nodes: int
) -> tuple[int, Floats, Floats, int]:
    """The `wanted` integer vectors nearest to `floats` (n,) in the metric of (U D Uᵀ)⁻¹ (`lambda_decorrelation`).

    Returns how many were obtained, the vectors (wanted, n) and their squared norms (wanted,), nearest first, and the
    number of visited nodes. Fewer than `wanted` (namely 0) means that the search was cut off at `most_nodes` or that a
    number is not finite: nothing is known then. The floats should be within 2⁵⁰ of zero.
    """
    count = floats.size
    obtained = 0
    vectors = np.zeros((wanted, count))
    norms = np.full(wanted, np.inf)
    for place in range(count):
        if not (np.isfinite(floats[place]) and variances[place] > 0.0 and np.isfinite(variances[place])):
            return 0, vectors, norms, 0
    if count == 0 or wanted < 1:
        return 0, vectors, norms, 0
    # By rows: what the choice at a level adds to the levels below it.
    lower = np.ascontiguousarray(upper.T)
    shift = np.zeros((count, count))
    centre = np.empty(count)
    integer = np.empty(count)
    step = np.empty(count)
    above = np.zeros(count)
    weight = 1.0 / variances
    level = count - 1
    centre[level] = floats[level]
    integer[level] = np.rint(centre[level])
    step[level] = 1.0 if centre[level] >= integer[level] else -1.0
    limit = np.inf
    nodes = 0
    while nodes < most_nodes:
        nodes += 1
        offset = centre[level] - integer[level]
        norm = above[level] + offset * offset * weight[level]
        if norm < limit:
            if level > 0:
                below = level - 1
                if level == count - 1:
                    for place in range(level):
                        shift[below, place] = -offset * lower[level, place]
                else:
                    for place in range(level):
                        shift[below, place] = shift[level, place] - offset * lower[level, place]
                above[below] = norm
                level = below
                centre[level] = floats[level] + shift[level, level]
                integer[level] = np.rint(centre[level])
                step[level] = 1.0 if centre[level] >= integer[level] else -1.0
                continue
            place = min(obtained, wanted - 1)
            while place > 0 and norms[place - 1] > norm:
                norms[place] = norms[place - 1]
                for i in range(count):
                    vectors[place, i] = vectors[place - 1, i]
                place -= 1
            norms[place] = norm
            for i in range(count):
                vectors[place, i] = integer[i]
            obtained = min(obtained + 1, wanted)
            limit = norms[wanted - 1]
        elif level == count - 1:
            return obtained, vectors, norms, nodes
        else:
            level += 1
        # The next nearest integer of this level.
        integer[level] += step[level]
        step[level] = -step[level] - 1.0 if step[level] > 0.0 else -step[level] + 1.0
    return 0, vectors, norms, nodes
