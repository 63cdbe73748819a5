"""Wheel speed as a control unit makes it: from the times of a toothed ring's edges."""

from __future__ import annotations

import numpy as np

from camber.simulator.scene import Floats


def edge_times(time_s: Floats, wheel_speed_m_s: Floats, edge_m: Floats) -> Floats:
    """When (m,) the wheel has rolled the ascending distances `edge_m` (m,), those only that it reaches.

    The speed (n,) is that of the circumference, between its samples it changes evenly; backwards counts as forwards.
    """
    speed = np.abs(wheel_speed_m_s)
    rolled = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s)))
    # An edge never lies within a standstill: equal distances there have no width.
    times: Floats = np.interp(edge_m[edge_m <= rolled[-1]], rolled, time_s)
    return times


def speed_of_edges(edge_s: Floats, time_s: Floats, window_s: float, pitch_m: float) -> Floats:
    """Speed (n,) at times (n,): the way from the last edge before the window to the last in it, by its time.

    Without an edge in the window it is that of the last two, or less if the next one is overdue. Zero before two
    edges have been seen.
    """
    if len(edge_s) < 2:
        return np.zeros(len(time_s))
    last = np.searchsorted(edge_s, time_s, side="right") - 1
    before = np.minimum(np.searchsorted(edge_s, time_s - window_s, side="right") - 1, last - 1)
    known = before >= 0
    last, before = np.maximum(last, 1), np.clip(before, 0, None)
    speed = (last - before) * pitch_m / (edge_s[last] - edge_s[before])
    waited_s = np.maximum(time_s - edge_s[last], 1e-9)
    return np.where(known, np.minimum(speed, pitch_m / waited_s), 0.0)
