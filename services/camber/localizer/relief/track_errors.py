"""Displacements of a dead-reckoned track by the errors of heading, wheel scale and yaw rate, about its last place."""

from __future__ import annotations

import numpy as np

from camber.localizer.arrays import Floats


def track_error_modes(east_m: Floats, north_m: Floats, time_s: Floats) -> Floats:
    """Return the displacement (n, 2, 3) of n places per rad of heading at the last one, per unit of the wheels' scale,
    and per rad/s of a constant yaw-rate bias.

    With p the places and q the last one: R (p − q) for the heading, R a quarter turn; p − q for the scale; a bias β
    turns the heading at time t by β (t − t_n), so that the displacement is −∫ R v (t − t_n) dt from t to t_n.
    """
    places = np.column_stack([east_m, north_m])
    from_last = places - places[-1]
    turned = np.column_stack([-from_last[:, 1], from_last[:, 0]])
    steps = np.diff(places, axis=0)
    middle_s = 0.5 * (time_s[1:] + time_s[:-1]) - time_s[-1]
    swept = np.column_stack([-steps[:, 1], steps[:, 0]]) * middle_s[:, None]
    to_last = np.zeros_like(places)
    to_last[:-1] = -np.cumsum(swept[::-1], axis=0)[::-1]
    return np.stack([turned, from_last, to_last], axis=-1)
