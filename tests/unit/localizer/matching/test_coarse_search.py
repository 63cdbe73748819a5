"""The coarse search: found from five metres off, and owned up to where several places fit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.localizer.matching.coarse_search import search, seems_mirrored
from camber.localizer.matching.point_to_plane import moved
from support.plain_layers import LOCAL_DENSITY, MAP_DENSITY, YARD, error, pose, seen_from, surfaces, targets

Floats = NDArray[np.float64]
TRUTH = pose(3.0, -2.0, 30.0)
LAYERS = targets(surfaces(YARD, MAP_DENSITY, np.random.default_rng(1)))
SEEN = seen_from(TRUTH, surfaces(YARD, LOCAL_DENSITY, np.random.default_rng(2)))
EQUAL_BAYS = [
    *[((x, -4.0), (x, -2.0)) for x in np.arange(-60.0, 60.5, 3.0)],
    *[((x, 4.0), (x, 2.0)) for x in np.arange(-60.0, 60.5, 3.0)],
    ((-60.0, -4.0), (60.0, -4.0)), ((-60.0, 4.0), (60.0, 4.0)),
]  # fmt: skip


@pytest.mark.parametrize("step", [(4.5, 0.0, 0.0), (-3.0, 3.5, 14.0), (0.2, -4.8, -15.0), (0.0, 0.0, 0.0)])
def test_the_place_is_found_from_five_metres_and_fifteen_degrees_off(
    step: tuple[float, float, float],
) -> None:
    guess = moved(TRUTH, np.array([step[0], step[1], math.radians(step[2])]), "planar")
    found = search(SEEN, SEEN[:, 2], LAYERS, guess)
    assert found.match.status == "converged"
    assert found.unique
    assert found.score > 0.9
    assert error(found.match.map_from_local, TRUTH)[0] < 0.01


def test_a_row_of_equal_bays_is_ambiguous() -> None:
    layers = targets(surfaces(EQUAL_BAYS, MAP_DENSITY, np.random.default_rng(1)))
    points = surfaces(EQUAL_BAYS, LOCAL_DENSITY, np.random.default_rng(2))
    points = points[np.abs(points[:, 0]) < 25.0]
    found = search(points, points[:, 2], layers, pose(1.0, 0.2, 2.0))
    assert not found.unique
    assert (found.match.status, found.match.reason) == ("ambiguous", "not_unique")
    assert found.next_score > 0.9 * found.score


def test_another_place_stays_lost() -> None:
    elsewhere = surfaces(
        [((x, -30.0), (x + 2.0, 30.0)) for x in range(-30, 31, 7)], LOCAL_DENSITY, np.random.default_rng(3)
    )
    found = search(elsewhere, elsewhere[:, 2], LAYERS, TRUTH)
    assert found.match.status != "converged"


def test_nothing_seen_is_lost() -> None:
    found = search(np.empty((0, 3)), np.empty(0), LAYERS, TRUTH)
    assert found.match.status == "lost"
    assert not found.unique


def test_a_mirrored_sensor_is_noticed_and_a_right_one_is_not_accused() -> None:
    mirrored = SEEN * np.array([1.0, -1.0, 1.0])
    assert seems_mirrored(mirrored, mirrored[:, 2], LAYERS, TRUTH)
    assert not seems_mirrored(SEEN, SEEN[:, 2], LAYERS, TRUTH)


def test_equal_input_gives_equal_bits() -> None:
    first, second = (search(SEEN, SEEN[:, 2], LAYERS, pose(0.0, 0.0, 25.0)) for _ in range(2))
    assert first.match.map_from_local.tobytes() == second.match.map_from_local.tobytes()
