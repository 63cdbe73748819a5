"""Matching in layers: converged, ambiguous or lost, and never a confident wrong pose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.localizer.matching.icp import moved
from camber.localizer.matching.layered_matching import LayeredMatch, MatchInput, MatchOptions, match_layers
from camber.localizer.matching.match_covariance import UNSEEN_M
from camber.localizer.matching.registration import LayerTarget
from support.plain_layers import (
    CORRIDOR,
    LOCAL_DENSITY,
    MAP_DENSITY,
    TRUTH,
    YARD,
    YARD_M,
    error,
    pose,
    seen_from,
    surfaces,
    targets,
)

Floats = NDArray[np.float64]
GUESS = moved(TRUTH, np.array([0.4, -0.3, math.radians(2.0)]), "planar")
OPTIONS = MatchOptions()
LAYERS = targets(YARD_M)


def seen(shift_low_m: float = 0.0, shift_middle_m: float = 0.0, shift_high_m: float = 0.0) -> Floats:
    """The yard from TRUTH, each layer shifted to the east."""
    points = surfaces(YARD, LOCAL_DENSITY, 2)
    layer = np.clip(np.floor(points[:, 2]).astype(np.int64), 0, 2)
    points[:, 0] += np.array([shift_low_m, shift_middle_m, shift_high_m])[layer]
    return seen_from(TRUTH, points)


def matched(
    points: Floats, layers: list[LayerTarget] = LAYERS, guess: Floats = GUESS, options: MatchOptions = OPTIONS
) -> LayeredMatch:
    scan = MatchInput(points_m=points, heights_m=points[:, 2], targets=layers, guess=guess)
    return match_layers(scan, options)


def is_confident(match: LayeredMatch, off_m: float) -> bool:
    """Does it claim to be better than it is?"""
    sigma_m = math.sqrt(float(np.linalg.eigvalsh(match.covariance[:2, :2])[-1]))
    return match.status == "converged" and off_m > 5.0 * sigma_m


def test_a_yard_is_matched_to_a_centimetre() -> None:
    match = matched(seen())
    off_m, off_rad = error(match.map_from_local, TRUTH)
    assert (match.status, match.reason) == ("converged", "agreed")
    assert off_m < 0.01
    assert off_rad < 0.001
    assert [row.outcome for row in match.layers] == ["used"] * 3
    assert (match.east_m, match.north_m) == pytest.approx((3.0, -2.0), abs=0.01)
    assert match.yaw_rad == pytest.approx(math.radians(30.0), abs=0.001)


@pytest.mark.parametrize(
    "bounds",
    [((0.0, 1.0), (1.0, 2.0), (2.0, 3.0)), ((0.3, 0.8), (0.8, 3.0)), ((0.3, 1.0), (1.0, 1.5), (1.5, 2.0), (2.0, 3.4))]
)  # fmt: skip
def test_layers_may_be_of_any_number_and_height(bounds: tuple[tuple[float, float], ...]) -> None:
    options = MatchOptions(layer_bounds_m=bounds)
    match = matched(seen(), targets(YARD_M, options), options=options)
    assert match.status == "converged"
    assert [row.bounds_m for row in match.layers] == list(bounds)
    assert error(match.map_from_local, TRUTH)[0] < 0.01


def test_a_layer_that_has_moved_is_voted_out_and_the_others_keep_their_pose() -> None:
    match = matched(seen(shift_low_m=0.3))
    assert match.status == "converged"
    assert match.layers[0].outcome != "used"
    assert error(match.map_from_local, TRUTH)[0] < 0.015


def test_two_layers_that_disagree_are_ambiguous_without_a_third() -> None:
    options = MatchOptions(layer_bounds_m=((0.3, 1.0), (2.0, 3.0)))
    match = matched(seen(shift_low_m=0.25), targets(YARD_M, options), options=options)
    assert match.status == "ambiguous"
    off_m, _ = error(match.map_from_local, TRUTH)
    assert off_m < 3.0 * math.sqrt(float(np.trace(match.covariance[:2, :2])))


def test_all_three_layers_apart_are_ambiguous() -> None:
    match = matched(seen(-0.25, 0.0, 0.25))
    assert match.status != "converged"


def test_best_mean_and_weighted_do_not_test_agreement() -> None:
    points = seen(shift_low_m=0.3)
    off_m = {}
    for choice in ("best", "mean", "weighted"):
        options = MatchOptions(choice=choice, method="point_to_point", max_iterations=60)  # type: ignore[arg-type]
        off_m[choice] = error(matched(points, options=options).map_from_local, TRUTH)[0]
    assert off_m["best"] < 0.03
    assert off_m["mean"] == pytest.approx(0.1, abs=0.04)
    assert off_m["best"] < off_m["weighted"] < off_m["mean"] + 0.01


def test_whole_is_one_layer_of_all() -> None:
    options = MatchOptions(choice="whole")
    match = matched(seen(), targets(YARD_M, options), options=options)
    assert [row.bounds_m for row in match.layers] == [(0.3, 3.0)]
    assert error(match.map_from_local, TRUTH)[0] < 0.01


def test_a_corridor_is_ambiguous_along_and_sure_across() -> None:
    layers = targets(surfaces(CORRIDOR, MAP_DENSITY, 1))
    points = surfaces([((-30.0, y), (30.0, y)) for y in (-4.0, 4.0)], LOCAL_DENSITY, 2)
    match = matched(points, layers, pose(1.5, 0.3, 1.0))
    assert (match.status, match.reason) == ("ambiguous", "direction_unseen")
    assert match.east_m == pytest.approx(1.5, abs=0.05)
    assert match.north_m == pytest.approx(0.0, abs=0.01)
    assert match.covariance[0, 0] > 1.0
    assert match.covariance[1, 1] < 0.02**2


def test_one_layer_with_posts_gives_the_corridor_its_length() -> None:
    posts = [((x, s * 3.8), (x, s * 3.2)) for x in range(-25, 30, 10) for s in (-1, 1)]
    random = np.random.default_rng(1)
    map_m = np.concatenate(
        [surfaces(CORRIDOR, MAP_DENSITY, random), surfaces(posts, MAP_DENSITY, random, 2.0, 3.0)]
    )
    random = np.random.default_rng(2)
    points = np.concatenate(
        [surfaces(CORRIDOR, LOCAL_DENSITY, random), surfaces(posts, LOCAL_DENSITY, random, 2.0, 3.0)]
    )
    points = points[np.abs(points[:, 0]) < 30.0]
    match = matched(points, targets(map_m), pose(0.3, 0.2, 0.5))
    assert match.status == "converged"
    assert error(match.map_from_local, pose(0.0, 0.0, 0.0))[0] < 0.03


def test_another_place_is_lost_and_says_that_nothing_is_known() -> None:
    elsewhere = [((x, -30.0), (x + 2.0, 30.0)) for x in range(-30, 31, 7)]
    points = surfaces(elsewhere, LOCAL_DENSITY, 3)
    match = matched(points)
    assert match.status == "lost"
    np.testing.assert_array_equal(match.map_from_local, GUESS)
    assert match.covariance[0, 0] == UNSEEN_M**2


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.full((20, 3), 1.5)])
def test_without_points_it_is_lost(points: Floats) -> None:
    match = matched(points)
    assert (match.status, match.reason) == ("lost", "too_few_points")


def test_without_a_map_it_is_lost() -> None:
    assert matched(seen(), targets(np.empty((0, 3)))).status == "lost"


def test_where_most_layers_do_not_fit_the_rest_is_not_trusted() -> None:
    points = seen()
    random = np.random.default_rng(4)
    clutter = random.uniform([-15.0, -15.0, 0.3], [15.0, 15.0, 1.9], (6000, 3))
    points = np.concatenate([points[points[:, 2] > 2.0], clutter])
    match = matched(points)
    assert (match.status, match.reason) == ("ambiguous", "few_layers")
    assert match.covariance[0, 0] >= 0.5**2


@pytest.mark.parametrize("seed", range(6))
def test_from_anywhere_within_four_metres_it_is_never_sure_of_a_wrong_place(seed: int) -> None:
    random = np.random.default_rng(seed)
    points = seen()
    for _ in range(5):
        step = np.array([*random.uniform(-4.0, 4.0, 2), random.uniform(-0.3, 0.3)])
        match = matched(points, guess=moved(TRUTH, step, "planar"))
        assert not is_confident(match, error(match.map_from_local, TRUTH)[0])


def test_the_order_of_the_frames_does_not_matter() -> None:
    """The map a hundred metres away and turned: the same answer there."""
    there = pose(100.0, -80.0, 70.0)
    layers = targets(YARD_M @ there[:3, :3].T + there[:3, 3])
    match = matched(seen(), layers, there @ GUESS)
    assert match.status == "converged"
    assert error(match.map_from_local, there @ TRUTH)[0] < 0.01


def test_another_number_of_targets_is_refused() -> None:
    with pytest.raises(ValueError, match="2 targets, expected 3"):
        matched(seen(), LAYERS[:2])


def test_a_stricter_limit_of_overlap_loses_what_would_have_matched() -> None:
    points = np.concatenate([seen(), np.random.default_rng(5).uniform([-9, -9, 0.3], [9, 9, 3.0], (4000, 3))])
    match = matched(points, options=replace(OPTIONS, min_overlap=0.99))
    assert (match.status, match.reason) == ("lost", "low_overlap")
