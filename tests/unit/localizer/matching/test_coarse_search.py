"""The coarse search: right from five metres off, and ambiguous where several positions fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from camber.localizer.arrays import Floats
from camber.localizer.matching.coarse_search import search, seems_mirrored
from camber.localizer.matching.icp import moved
from camber.localizer.matching.layered_matching import MatchInput, MatchOptions
from camber.localizer.matching.registration import LayerTarget
from support.plain_layers import (
    LOCAL_DENSITY,
    MAP_DENSITY,
    TRUTH,
    YARD_M,
    YARD_SEEN_M,
    error,
    pose,
    surfaces,
    targets,
)

LAYERS = targets(YARD_M)
SEEN = YARD_SEEN_M
EQUAL_BAYS = [
    *[((x, -4.0), (x, -2.0)) for x in np.arange(-60.0, 60.5, 3.0)],
    *[((x, 4.0), (x, 2.0)) for x in np.arange(-60.0, 60.5, 3.0)],
    ((-60.0, -4.0), (60.0, -4.0)), ((-60.0, 4.0), (60.0, 4.0)),
]  # fmt: skip


OPTIONS = MatchOptions()


def scan(points_m: Floats, layers: Sequence[LayerTarget], guess: Floats) -> MatchInput:
    return MatchInput(points_m=points_m, heights_m=points_m[:, 2], targets=layers, guess=guess)


@pytest.mark.parametrize("step", [(4.5, 0.0, 0.0), (-3.0, 3.5, 14.0), (0.2, -4.8, -15.0), (0.0, 0.0, 0.0)])
def test_the_position_is_right_from_five_metres_and_fifteen_degrees_off(
    step: tuple[float, float, float],
) -> None:
    guess = moved(TRUTH, np.array([step[0], step[1], math.radians(step[2])]), "planar")
    result = search(scan(SEEN, LAYERS, guess), OPTIONS)
    assert result.match.status == "converged"
    assert result.unique
    assert result.score > 0.9
    assert error(result.match.map_from_local, TRUTH)[0] < 0.01


def test_a_row_of_equal_bays_is_ambiguous() -> None:
    layers = targets(surfaces(EQUAL_BAYS, MAP_DENSITY, 1))
    points = surfaces(EQUAL_BAYS, LOCAL_DENSITY, 2)
    points = points[np.abs(points[:, 0]) < 25.0]
    result = search(scan(points, layers, pose(1.0, 0.2, 2.0)), OPTIONS)
    assert not result.unique
    assert (result.match.status, result.match.reason) == ("ambiguous", "not_unique")
    assert result.rivals


def test_another_place_stays_lost() -> None:
    elsewhere = surfaces([((x, -30.0), (x + 2.0, 30.0)) for x in range(-30, 31, 7)], LOCAL_DENSITY, 3)
    result = search(scan(elsewhere, LAYERS, TRUTH), OPTIONS)
    assert result.match.status != "converged"


def test_nothing_seen_is_lost() -> None:
    result = search(scan(np.empty((0, 3)), LAYERS, TRUTH), OPTIONS)
    assert result.match.status == "lost"
    assert not result.unique


def test_a_mirrored_sensor_is_noticed_and_a_right_one_is_not_accused() -> None:
    mirrored = SEEN * np.array([1.0, -1.0, 1.0])
    assert seems_mirrored(scan(mirrored, LAYERS, TRUTH), OPTIONS)
    assert not seems_mirrored(scan(SEEN, LAYERS, TRUTH), OPTIONS)


def test_equal_input_gives_equal_bits() -> None:
    first, second = (search(scan(SEEN, LAYERS, pose(0.0, 0.0, 25.0)), OPTIONS) for _ in range(2))
    assert first.match.map_from_local.tobytes() == second.match.map_from_local.tobytes()
