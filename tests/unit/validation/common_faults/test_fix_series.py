"""Fixes of a drive with a common fault: off by the vector that the fault says, from its onset on."""

from __future__ import annotations

import numpy as np
import pytest

from camber.simulator.scene import Trajectory
from camber.simulator.vehicle.body import CAR
from camber.simulator.vehicle.motion import drive
from camber.simulator.world.countryside import country_district
from camber.simulator.world.district import District
from camber.validation.common_faults.fault_cases import BY_NAME, CommonFault
from camber.validation.common_faults.fix_series import FixErrors, FixSeries, fix_series
from camber.validation.common_faults.wrong_episodes import LENGTH_S, SHARE, wrong_episodes

SEED, LASTS_S, ONSET_S = 7, 90.0, 30.0
EXACT = FixErrors(slow_m=(0.0, 0.0, 0.0), white_m=(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def driven() -> tuple[District, Trajectory]:
    district = country_district(SEED, "hilly", length_m=2_000.0)
    return district, drive(district.path(), CAR, start_ns=10**18, duration_s=LASTS_S + 30.0)


def _series(driven: tuple[District, Trajectory], errors: FixErrors = EXACT, **fault: float) -> FixSeries:
    district, trajectory = driven
    made = CommonFault(name="test", text="test", onset_s=ONSET_S, **fault)  # type: ignore[arg-type]
    return fix_series(trajectory, district.frame, made, seed=SEED, lasts_s=LASTS_S, errors=errors)


def _time_s(series: FixSeries) -> np.ndarray:
    return (series.time_ns - series.time_ns[0]) / 1e9


def test_right_fixes_are_off_by_millimetres(driven: tuple[District, Trajectory]) -> None:
    series = _series(driven, errors=FixErrors())
    assert not series.wrong.any()
    assert 0.001 < np.quantile(np.hypot(*series.error_m[:, :2].T), 0.95) < 0.02


@pytest.mark.parametrize("fault", [{"along_m_s": 0.3}, {"across_m_s": 0.3}])
def test_fixes_that_are_led_away_go_away_at_their_rate(
    driven: tuple[District, Trajectory], fault: dict[str, float]
) -> None:
    series = _series(driven, **fault)
    since_s = np.maximum(_time_s(series) - ONSET_S, 0.0)
    off_m = np.hypot(*series.error_m[:, :2].T)
    assert (off_m <= 0.3 * since_s + 0.05).all()
    # Along, the chord of a turn of a right angle is 0.9 of the way or more.
    assert (off_m >= 0.85 * 0.3 * since_s - 0.05).all()
    assert (series.error_m[:, 2] == 0.0).all()


def test_heights_of_the_road_are_those_where_the_fix_is(driven: tuple[District, Trajectory]) -> None:
    series = _series(driven, along_m_s=0.3, height_of_road=True)
    district, trajectory = driven
    rows = np.arange(0, len(series.time_ns)) * 20
    east, north = (trajectory.antenna_m[rows] + series.error_m)[:, :2].T
    road = district.roads("drive").surface_m(east, north, np.zeros(len(east), np.int64))
    height = trajectory.antenna_m[rows, 2] + series.error_m[:, 2] - road
    assert np.ptp(height) < 0.06
    assert np.abs(series.error_m[:, 2]).max() > 0.1


def test_a_base_is_off_by_one_vector(driven: tuple[District, Trajectory]) -> None:
    series = _series(driven, east_m=0.8, north_m=-1.7)
    after = _time_s(series) >= ONSET_S
    np.testing.assert_allclose(series.error_m[after], np.tile((0.8, -1.7, 0.0), (after.sum(), 1)), atol=1e-12)
    assert (series.error_m[~after] == 0.0).all()


def test_the_velocity_is_that_of_the_counterfeit_signals(driven: tuple[District, Trajectory]) -> None:
    right, led = _series(driven), _series(driven, across_m_s=0.5)
    extra = np.array([s.velocity_enu_m_s for s in led.solutions]) - np.array(
        [s.velocity_enu_m_s for s in right.solutions]
    )
    after = _time_s(led) >= ONSET_S
    np.testing.assert_allclose(np.linalg.norm(extra[after], axis=1), 0.5, atol=1e-9)
    assert (extra[~after] == 0.0).all()


def test_episodes_have_their_share_and_their_lengths() -> None:
    episodes = wrong_episodes(SEED, first_s=0.0, lasts_s=40_000.0)
    length_s = episodes.end_s - episodes.begin_s
    assert LENGTH_S[0] <= length_s.min()
    assert length_s.max() <= LENGTH_S[1]
    time_s = np.arange(0.0, 40_000.0, 1.0)
    share = float((np.linalg.norm(episodes.offset_m(time_s), axis=1) > 0.0).mean())
    print(f"seed {SEED}: {share:.3f} of the time is wrong, {len(length_s)} episodes")
    # The σ of the share over some thousand episodes is about 1 %.
    assert abs(share - SHARE) < 0.04
    assert (np.linalg.norm(episodes.shift_m, axis=1) > 0.5).all()


def test_each_case_of_the_table_has_one_effect() -> None:
    for case in BY_NAME.values():
        effects = [case.along_m_s, case.across_m_s, case.along_m, np.hypot(case.east_m, case.north_m)]
        assert sum(effect != 0.0 for effect in effects) == ("none" not in case.name)
