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
from support.judging import FRAME, at, fix, road

LEVER_M = (1.2, -0.3)
EVERY_S, SPEED_M_S, RATE_RAD_S, SLOPE = 0.2, 12.0, 0.4, 0.1
STEERED_S = 1.0  # until the curve's radius is reached
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
        track = _track(at_s)
        vehicle = rotated(TURNED_RAD, track.east_m, track.north_m)
        lever = rotated(TURNED_RAD + track.yaw_rad, *LEVER_M)
        noise = rng.normal(0.0, SIGMA_M, 3)
        off = offset_m(at_s)
        road_m = SLOPE * vehicle[0]
        one = _fix(
            vehicle[0] + lever[0] + off[0] + noise[0],
            vehicle[1] + lever[1] + off[1] + noise[1],
            road_m + 1.8 + off[2] + noise[2],
            base(at_s),
            time_ns=at(at_s / EVERY_S),
        )
        step = detection.step(one, track, road(elevation_m=road_m))
        if step is not None:
            steps.append((round(at_s, 3), step))
    return steps


def _yaw_rad(at_s: float) -> float:
    steered_s = min(at_s, STEERED_S)
    return RATE_RAD_S * (0.5 * steered_s**2 / STEERED_S + at_s - steered_s)


def _track(at_s: float) -> TrackPoint:
    since_s = np.linspace(0.0, at_s, 200)
    yaw_rad = [_yaw_rad(each) for each in since_s]
    return TrackPoint(
        east_m=float(np.trapezoid(SPEED_M_S * np.cos(yaw_rad), since_s)),
        north_m=float(np.trapezoid(SPEED_M_S * np.sin(yaw_rad), since_s)),
        yaw_rad=yaw_rad[-1],
        path_m=SPEED_M_S * at_s,
    )


def _fix(east_m: float, north_m: float, up_m: float, base: str, *, time_ns: int) -> Fix:
    latitude_rad, longitude_rad, _ = FRAME.geodetic_from_east_north(east_m, north_m, up_m)
    variance_m2 = SIGMA_M**2
    return fix(
        time_ns=time_ns,
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


def _to_the_left(at_s: float, distance_m: float) -> tuple[float, float, float]:
    """To the left of the vehicle of `timed_steps`, that far."""
    return *rotated(TURNED_RAD + _yaw_rad(at_s), 0.0, distance_m), 0.0


def test_fixes_led_away_across_the_road_turn_with_it_and_make_no_step() -> None:
    between_m = 0.05 * 120.0 * RATE_RAD_S * EVERY_S
    assert between_m > 0.3
    assert steps_of(lambda at_s: _to_the_left(at_s, 0.05 * (110.0 + at_s))) == []


def test_other_integers_are_a_step_while_fixes_led_away_turn() -> None:
    def off_m(at_s: float) -> tuple[float, float, float]:
        east_m, north_m, _ = _to_the_left(at_s, 0.05 * (110.0 + at_s))
        return east_m + (0.5 if at_s >= 5.0 else 0.0), north_m, 0.0

    assert steps_of(off_m) == [5.0]


def test_a_position_that_goes_back_within_seconds_steps_as_long_as_it_moves_by_that_much() -> None:
    off_m = lambda at_s: 6.0 if at_s < 5.0 else 6.0 * math.exp(-(at_s - 5.0 + EVERY_S))  # noqa: E731
    moved_m = [off_m(5.0 + EVERY_S * k) - off_m(5.0 + EVERY_S * (k - 1)) for k in range(12)]
    goes_on = [round(5.0 + EVERY_S * k, 3) for k, each in enumerate(moved_m) if abs(each) > 0.45]
    assert goes_on[:3] == [5.0, 5.2, 5.4]
    assert set(goes_on) <= set(steps_of(lambda at_s: (off_m(at_s), 0.0, 0.0)))


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


def test_a_run_of_fixes_begins_with_the_first_of_them_after_a_step_and_after_a_gap() -> None:
    detection, here = FixStepDetection(LEVER_M), TrackPoint(east_m=0.0, north_m=0.0, yaw_rad=0.0, path_m=0.0)

    def begin_s(at_s: float, *, east_m: float = 0.0, track: TrackPoint | None = here) -> float | None:
        one = _fix(east_m, 0.0, 1.8, "1", time_ns=at(at_s / EVERY_S))
        detection.step(one, track, road(elevation_m=0.0))
        return None if detection.run_begin_ns is None else 1e-9 * (detection.run_begin_ns - at(0))

    assert detection.run_begin_ns is None
    assert [begin_s(at_s) for at_s in (0.0, 0.2, 1.2)] == [0.0] * 3
    assert begin_s(2.4) == pytest.approx(2.4)
    assert [begin_s(at_s, east_m=0.5) for at_s in (2.6, 2.8)] == pytest.approx([2.6, 2.6])
    assert begin_s(2.6, east_m=0.5) == pytest.approx(2.6)
    assert begin_s(3.0, track=None) is None
    assert begin_s(3.2) == pytest.approx(3.2)
