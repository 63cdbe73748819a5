"""Episodes: errors have the stated spread, and misses follow the closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.rules import Rules
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import ALL, BASELINES, JUDGE, BaselineDecisions
from camber.validation.lab.error_episodes import FaultOffsets, episodes
from camber.validation.lab.error_model import HEADLINE, Assumptions, Scene
from camber.validation.lab.false_alarms import right_covariance
from camber.validation.lab.missed_detection import THRESHOLDS_M, longest_confirmed_runs, missed_block
from camber.validation.lab.reference_faults import FAULTS
from camber.validation.lab.work_blocks import WorkBlock

SEED = 11
SCENE = Scene(pose_sigma_m=0.08, map_sigma_m=0.06)


def _shapes(n: int, shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FixShapes:
    cube = np.broadcast_to(np.eye(3), (n, 3, 3))
    return FixShapes(
        sky=np.arange(n),
        shift_m=np.tile(shift_m, (n, 1)),
        rate_m_s=np.zeros((n, 3)),
        claimed_m2=cube * 0.005**2,
        reflected_m2=cube * 0.01**2,
        residuals_agree=np.ones(n, np.bool_),
        ambiguities=np.full(n, 9),
        street=np.ones(n, np.bool_),
        along=np.tile((1.0, 0.0), (n, 1)),
        satellites=np.full(n, 9),
    )


def _phi(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


def test_differences_have_the_variances_of_their_parts() -> None:
    assumed = Assumptions(reference_m=0.08, slope_sigma=0.0)
    rng = np.random.default_rng(SEED)
    run = episodes(_shapes(60_000), SCENE, rng, length=1, assumed=assumed)
    fix = 0.01**2 + 0.08**2 / 2.0 + assumed.frame_sigma_m**2
    plane = fix + SCENE.pose_sigma_m**2
    up = fix + SCENE.map_sigma_m**2 + assumed.antenna_sigma_m**2
    assert np.var(run.difference_m, axis=0) == pytest.approx([plane, plane, up], rel=0.03)
    assert np.var(run.error_m, axis=0) == pytest.approx([fix] * 3, rel=0.03)


def test_right_fixes_of_the_lab_of_alarms_and_of_episodes_have_the_same_spread() -> None:
    rng = np.random.default_rng(SEED)
    shapes, slope = _shapes(200_000), np.zeros((200_000, 2))
    run = episodes(shapes, SCENE, rng, length=1, assumed=Assumptions(slope_sigma=0.0))
    assert np.cov(run.difference_m.T) == pytest.approx(
        right_covariance(shapes, slope, SCENE)[0], rel=0.02, abs=1e-4
    )


def test_the_poses_error_is_alike_for_its_correlation_time() -> None:
    assumed = Assumptions(pose_time_s=10.0)
    rng = np.random.default_rng(SEED)
    run = episodes(_shapes(20_000), SCENE, rng, length=101, assumed=assumed)
    pose = run.pose_error_m[:, 0].reshape(20_000, 101)
    alike = np.mean(pose[:, 0] * pose[:, 100]) / SCENE.pose_sigma_m**2
    assert alike == pytest.approx(math.exp(-1.0), abs=0.03)
    assert np.var(pose[:, 100]) == pytest.approx(SCENE.pose_sigma_m**2, rel=0.05)


def test_a_wrong_fix_moves_with_its_rate_and_faults_move_what_they_concern() -> None:
    assumed = Assumptions(reference_m=0.0, frame_sigma_m=0.0, slope_sigma=0.0, antenna_sigma_m=0.0)
    still = Scene(pose_sigma_m=0.0, map_sigma_m=0.0)
    shapes = _shapes(1, (1.0, 2.0, 3.0))
    shapes.rate_m_s[:] = (0.1, 0.0, -0.1)
    shapes = shapes._replace(reflected_m2=np.zeros((1, 3, 3)))
    faults = FaultOffsets(
        pose_m=np.array([[0.5, 0.0]]), height_m=np.array([0.3]), fix_m=np.array([[0.0, 0.0, 1.0]])
    )
    rng = np.random.default_rng(SEED)
    run = episodes(shapes, still, rng, faults=faults, length=11, assumed=assumed)
    assert run.error_m[10] == pytest.approx([1.1, 2.0, 3.9], abs=1e-4)
    assert run.difference_m[10] == pytest.approx([0.6, 2.0, 3.6], abs=1e-4)


def test_height_alone_misses_as_often_as_the_normal_distribution_says() -> None:
    rules = Rules(determination=ConsistencyParameters(tolerance="fixed", tolerance_m=0.2))
    assumed = Assumptions(reference_m=0.0, slope_sigma=0.0)
    n = 200_000
    shapes = _shapes(n, (0.0, 5.0, 0.35))
    rng = np.random.default_rng(SEED)
    run = episodes(shapes, SCENE, rng, length=1, assumed=assumed)
    judge = BaselineDecisions(rules, SCENE)
    s = judge.covariance(shapes.claimed_m2, run.slope)
    confirmed = judge.confirmed(run.difference_m, s, run.episode, shapes.residuals_agree)
    sigma = math.sqrt(0.01**2 + assumed.frame_sigma_m**2 + SCENE.map_sigma_m**2 + assumed.antenna_sigma_m**2)
    expected = _phi((0.2 - 0.35) / sigma) - _phi((-0.2 - 0.35) / sigma)
    assert confirmed["height only"].mean() == pytest.approx(expected, abs=4.0 * math.sqrt(expected / n))
    assert not confirmed[JUDGE].any()
    assert confirmed["ratio only"].all()
    assert not confirmed["always no"].any()
    assert list(confirmed) == list(BASELINES)


def test_what_the_shortcut_leaves_out_could_agree_with_nothing() -> None:
    rng = np.random.default_rng(SEED)
    n, judge = 20_000, BaselineDecisions(Rules(), SCENE)
    d = rng.normal(size=(n, 3)) * (0.3, 0.3, 0.2)
    s = judge.covariance(np.tile(np.eye(3) * 1e-4, (n, 1, 1)), np.zeros((n, 2)))
    confirmed = judge.confirmed(d, s, np.arange(n), np.ones(n, np.bool_))
    assert (confirmed[JUDGE] == judge.agreed(d, s)).all()
    assert 0 < confirmed[JUDGE].sum() < confirmed["LiDAR only"].sum()


def test_the_longest_stretch_is_of_one_episode_and_an_alert_is_a_harmful_epoch_that_is_not_confirmed() -> (
    None
):
    harmful = np.array([1, 1, 1, 1, 0, 1, 1, 1], np.bool_)
    confirmed = np.array([1, 1, 0, 1, 1, 1, 1, 1], np.bool_)
    longest, alerted = longest_confirmed_runs(harmful, confirmed, np.array([0, 5]), np.array([5, 3]))
    assert longest.tolist() == [2, 3]
    assert alerted.tolist() == [True, False]


def test_controls_that_ask_for_more_miss_less_and_counts_add_up() -> None:
    scenes = HEADLINE[0], Scene(pose_sigma_m=0.2, map_sigma_m=0.05)
    counts = missed_block(WorkBlock(seed=3, number=0, skies=12), "cycles", scenes)
    for m in counts:
        missed = dict(zip(BASELINES, m.missed, strict=True))
        assert (missed["ratio only"] == m.harmful).all()
        assert (missed["always no"] == 0).all()
        assert (missed[ALL] <= missed[JUDGE]).all()
        assert (missed[ALL] <= missed["residuals only"]).all()
        assert (m.late <= m.missed).all()
        assert (m.confirmed_in_bin <= m.in_bin).all()
        assert m.harmful[0] >= m.harmful[1] > 0
        assert m.stretch.sum(axis=1).tolist() <= m.harmful.tolist()
    both = [dict(zip(BASELINES, m.missed[:, 0], strict=True))[JUDGE] for m in counts]
    assert both[0] < both[1]
    assert THRESHOLDS_M == (0.5, 1.0)


def test_a_level_of_five_metres_and_a_base_that_is_metres_off_contradict_every_time() -> None:
    n, judge = 500, BaselineDecisions(Rules(), HEADLINE[0])
    for name in ("level, 5 m", "base, vector of 17.7 m", "LiDAR slides along, 0.5 to 3 m"):
        rng = np.random.default_rng(SEED)
        shapes = _shapes(n)
        run = episodes(shapes, HEADLINE[0], rng, faults=FAULTS[name](shapes, rng), length=1)
        s = judge.covariance(shapes.claimed_m2, run.slope)
        assert not judge.agreed(run.difference_m, s).any()
        assert judge.contradicted(run.difference_m, s).mean() > 0.8
