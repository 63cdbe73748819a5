"""Paths whose road is known in closed form, for tests of the simulated vehicle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from camber.simulator.scene import Floats, Integers, Path

Height = Callable[[Floats, Floats], Floats]


def flat(east_m: Floats, north_m: Floats) -> Floats:
    return np.full(np.shape(east_m), 40.0)


def hilly(east_m: Floats, north_m: Floats) -> Floats:
    return 40.0 + 1.5 * np.sin(east_m / 18.0) + 0.8 * np.cos(north_m / 11.0) + 0.02 * east_m


def sloping(east_slope: float, north_slope: float) -> Height:
    return lambda east_m, north_m: 40.0 + east_slope * east_m + north_slope * north_m


def path_over(
    height: Height,
    curvature: Floats,
    *,
    step_m: float = 0.25,
    speed_m_s: float = 10.0,
    stops: dict[int, float] | None = None,
    surface: bool = True,
) -> Path:
    """Samples every `step_m` in the plane, with a curvature (n,) at each, over a height given everywhere.

    `surface` False: the path knows no surface beside itself.
    """
    n = len(curvature)
    # Fine enough that the polygon is the curve to micrometres.
    fine = 64
    turn = np.interp(np.arange((n - 1) * fine + 1) / fine, np.arange(n), curvature)
    yaw = np.append(0.0, np.cumsum(0.5 * (turn[1:] + turn[:-1]))) * step_m / fine
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    east = np.append(0.0, np.cumsum(np.cos(middle)))[::fine] * step_m / fine
    north = np.append(0.0, np.cumsum(np.sin(middle)))[::fine] * step_m / fine
    yaw = yaw[::fine]
    tiny = 1e-4
    slope_east = (height(east + tiny, north) - height(east - tiny, north)) / (2.0 * tiny)
    slope_north = (height(east, north + tiny) - height(east, north - tiny)) / (2.0 * tiny)
    limit, stop = np.full(n, speed_m_s), np.zeros(n)
    for k, seconds in (stops or {}).items():
        limit[k], stop[k] = 0.0, seconds

    def surface_m(e: Floats, m: Floats, level: Integers) -> Floats:
        return height(e, m) if surface else np.full(np.shape(e), np.nan)

    return Path(
        step_m=step_m,
        east_m=east,
        north_m=north,
        up_m=height(east, north),
        yaw_rad=yaw,
        grade=np.cos(yaw) * slope_east + np.sin(yaw) * slope_north,
        crossfall=np.cos(yaw) * slope_north - np.sin(yaw) * slope_east,
        level=np.zeros(n, np.int64),
        link_id=np.arange(n, dtype=np.int64) // 100,
        link_offset_m=np.zeros(n),
        speed_limit_m_s=limit,
        stop_s=stop,
        tunnel=np.zeros(n, np.bool_),
        surface_m=surface_m,
    )


def winding(n: int = 1600) -> Floats:
    """Curvature [1/m] of a street that turns left and right, 8 m at the narrowest."""
    k = np.arange(n)
    return 0.125 * np.sin(2.0 * np.pi * k / 400.0) ** 3
