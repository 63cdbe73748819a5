"""Fixes that move otherwise than the vehicle: which steps show, and that driving alone shows none."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.track import TrackPoint
from camber.localizer.relief.fix_step_detection import FixStep, FixStepDetection
from camber.schemas.gnss import Fix
from support.judging import FRAME, fix, road

LEVER_M = (1.2, -0.3)
EVERY_S, SPEED_M_S, RATE_RAD_S, SLOPE = 0.2, 12.0, 0.4, 0.1
TURNED_RAD = 1.0  # of the track's frame
SIGMA_M = 0.02
Offset = Callable[[float], tuple[float, float, float]]


def steps_of(offset_m: Offset, *, base: Callable[[float], str] = lambda _: "1") -> list[float]:
    """Times (s) of the steps in 20 s of a curve uphill; the fixes are off by `offset_m` of the time."""
    return [at_s for at_s, _ in timed_steps(offset_m, base=base)]


def timed_steps(
    offset_m: Offset, *, base: Callable[[float], str] = lambda _: "1"
) -> list[tuple[float, FixStep]]:
    detection, steps = FixStepDetection(LEVER_M), []
    rng = np.random.default_rng(3)
    for k in range(100):
        at_s = EVERY_S * k
        yaw_rad = RATE_RAD_S * at_s
        radius_m = SPEED_M_S / RATE_RAD_S
        track = TrackPoint(
            east_m=radius_m * math.sin(yaw_rad),
            north_m=radius_m * (1.0 - math.cos(yaw_rad)),
            yaw_rad=yaw_rad,
            path_m=SPEED_M_S * at_s,
        )
        vehicle = rotated(TURNED_RAD, track.east_m, track.north_m)
        lever = rotated(TURNED_RAD + yaw_rad, *LEVER_M)
        noise = rng.normal(0.0, SIGMA_M, 3)
        off = offset_m(at_s)
        road_m = SLOPE * vehicle[0]
        one = _fix(
            vehicle[0] + lever[0] + off[0] + noise[0],
            vehicle[1] + lever[1] + off[1] + noise[1],
            road_m + 1.8 + off[2] + noise[2],
            base(at_s),
        )
        step = detection.step(one, track, road(elevation_m=road_m))
        if step is not None:
            steps.append((round(at_s, 3), step))
    return steps


def _fix(east_m: float, north_m: float, up_m: float, base: str) -> Fix:
    latitude_rad, longitude_rad, _ = FRAME.geodetic_from_east_north(east_m, north_m, up_m)
    variance_m2 = SIGMA_M**2
    return fix(
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=up_m,
        covariance_enu_m2=(variance_m2, 0.0, 0.0, variance_m2, 0.0, variance_m2),
        base_station=base,
    )


def test_a_curve_uphill_is_no_step() -> None:
    assert steps_of(lambda _: (0.0, 0.0, 0.0)) == []


def test_fixes_that_are_led_away_slowly_are_no_step() -> None:
    assert steps_of(lambda at_s: (0.3 * at_s, 0.0, 0.0)) == []


@pytest.mark.parametrize("off_m", [(1.6, -0.7, 2.0), (-12.0, 9.0, 0.0), (0.0, 0.1, 1.5)], ids=str)
def test_a_step_has_the_vector_that_the_fixes_have_moved_by(off_m: tuple[float, float, float]) -> None:
    steps = timed_steps(lambda at_s: off_m if 5.0 <= at_s < 9.0 else (0.0, 0.0, 0.0))
    assert [at_s for at_s, _ in steps] == [5.0, 9.0]
    for sign, (_, step) in zip((1.0, -1.0), steps, strict=True):
        assert step.east_north_m is not None
        error_m = np.subtract(step.east_north_m, (sign * off_m[0], sign * off_m[1]))
        assert math.hypot(*error_m) < 3.0 * math.sqrt(step.variance_m2) < 0.3


def test_of_another_base_the_vector_is_not_known() -> None:
    ((_, step),) = timed_steps(lambda _: (0.0, 0.0, 0.0), base=lambda at_s: "1" if at_s < 9.0 else "2")
    assert step.east_north_m is None


@pytest.mark.parametrize("direction", range(8))
def test_half_a_metre_in_any_direction_is_a_step_as_it_begins_and_as_it_ends(direction: int) -> None:
    east_m, north_m = 0.5 * math.cos(0.25 * math.pi * direction), 0.5 * math.sin(0.25 * math.pi * direction)
    off = lambda at_s: (east_m, north_m, 0.0) if 5.0 <= at_s < 9.0 else (0.0, 0.0, 0.0)  # noqa: E731
    assert steps_of(off) == [5.0, 9.0]


def test_a_step_in_height_alone_shows_where_no_road_is_as_steep() -> None:
    assert steps_of(lambda at_s: (0.0, 0.0, 1.0 if at_s >= 5.0 else 0.0)) == [5.0]


def test_another_base_is_a_step_though_nothing_moves() -> None:
    assert steps_of(lambda _: (0.0, 0.0, 0.0), base=lambda at_s: "2" if at_s >= 7.0 else "1") == [7.0]
