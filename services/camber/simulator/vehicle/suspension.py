"""How a mode of the body follows the road and what pushes it: q'' + 2 ζ ω (q − r)' + ω² (q − r) = ω² p.

r is the road's motion, p how far a force would push the mode if it lasted. In the observer's canonical form

    s₁' = −2 ζ ω s₁ + s₂ + 2 ζ ω r        s₁ = q
    s₂' = −ω² s₁ + ω² (r + p)

no derivative of the road is needed, so an edge in it does no harm. Between samples the inputs are taken as straight
lines, for which one step of the system is exact (first-order hold; Franklin, Powell, Workman, Digital Control of
Dynamic Systems, section on hold equivalents).
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.scene import Floats
from camber.simulator.vehicle.body import Mode


def sprung(mode: Mode, road: Floats, push: Floats, step_s: float) -> tuple[Floats, Floats]:
    """q and q' (n,) of a mode for road and push (n,) at even steps; at rest in the beginning.

    Lengths and angles alike: q has the unit of the road's.
    """
    w, z = mode.natural_frequency_rad_s, mode.damping_ratio
    damping = 2.0 * z * w
    system = np.array([[-damping, 1.0], [-(w**2), 0.0]])
    inputs = np.array([[damping, 0.0], [w**2, w**2]])
    # d/dt (s, u, du) = block · (s, u, du), with du the change of the inputs over one step.
    block = np.zeros((6, 6))
    block[:2, :2], block[:2, 2:4] = system, inputs
    block[2:4, 4:6] = np.eye(2) / step_s
    one = _exponential(block * step_s)
    first = np.array([road[0] + push[0], damping * push[0]])
    states = _stepped(one[:2], first, np.column_stack((road, push)))
    position = states[:, 0]
    return position, states[:, 1] - damping * (position - road)


def _exponential(matrix: Floats) -> Floats:
    """e to a small matrix, by its series with scaling and squaring."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(matrix).sum(axis=1).max(), 1e-300)))) + 1)
    scaled = matrix / 2.0**halvings
    result, term = np.eye(len(matrix)), np.eye(len(matrix))
    for k in range(1, 20):
        term = term @ scaled / k
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result


@compiled
def _stepped(one: Floats, first: Floats, u: Floats) -> Floats:
    n = len(u)
    states = np.empty((n, 2))
    states[0, 0], states[0, 1] = first[0], first[1]
    for k in range(1, n):
        for i in range(2):
            states[k, i] = one[i, 0] * states[k - 1, 0] + one[i, 1] * states[k - 1, 1]
            for j in range(2):
                change = u[k, j] - u[k - 1, j]
                states[k, i] += one[i, 2 + j] * u[k - 1, j] + one[i, 4 + j] * change
    return states
