"""Lines of links, and the coupling of CN101360971 written out for one epoch."""

from __future__ import annotations

import math
from typing import NamedTuple

from camber.localizer.arrays import Floats
from camber.localizer.filter.kalman import kalman_update
from camber.localizer.links.link_observation import LinkLine, jacobian_s, jacobian_x, observation


class Coupling(NamedTuple):
    x_hat: Floats
    q_hat: Floats
    innovation: Floats
    innovation_covariance: Floats


def line_through(start: tuple[float, float], end: tuple[float, float]) -> LinkLine:
    """Return the line from one point (east, north) to another."""
    alpha = math.atan2(end[1] - start[1], end[0] - start[0])
    return LinkLine(alpha, start[0] * math.sin(alpha) - start[1] * math.cos(alpha))


def couple(x: Floats, q_x: Floats, s: Floats, q_s: Floats) -> Coupling:
    """Return the optimum of pose (3,) and link (4,), CN101360971 eq. (9) to (13), in Kalman form."""
    h, j_s = observation(x, s), jacobian_s(x, s)
    x_hat, q_hat, covariance = kalman_update(x, q_x, h=jacobian_x(s), innovation=-h, noise=j_s @ q_s @ j_s.T)
    return Coupling(x_hat, q_hat, h, covariance)
