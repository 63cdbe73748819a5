"""Country roads: as steep as their ground, as long as asked for, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from camber.simulator.world.countryside import Ground, country_district

SEED = 20


@pytest.mark.parametrize(("ground", "least", "most"), [("hilly", 0.02, 0.045), ("flat", 0.0, 0.003)])
def test_the_grade_of_the_roads_is_that_of_their_ground(ground: Ground, least: float, most: float) -> None:
    rms = [
        float(np.sqrt(np.mean(country_district(seed, ground, length_m=6_000.0).path().grade ** 2)))
        for seed in range(SEED, SEED + 4)
    ]
    print(f"seeds from {SEED}: grade rms {rms}")
    assert all(least <= value <= most for value in rms)


def test_crests_and_sags_are_those_of_roads_one_can_drive() -> None:
    path = country_district(SEED, "hilly", length_m=6_000.0).path()
    curvature = np.abs(np.gradient(path.grade, path.step_m))
    assert np.quantile(1.0 / curvature, 0.05) > 500.0


@pytest.mark.parametrize("length_m", [500.0, 5_000.0, 30_000.0])
def test_the_route_is_as_long_as_asked_for(length_m: float) -> None:
    path = country_district(SEED, "flat", length_m=length_m).path()
    # A turn cuts the corner of two links, and the route begins and ends ten metres within them.
    assert path.step_m * len(path.east_m) >= 0.95 * length_m - 40.0


def test_a_seed_gives_one_country_and_another_seed_another() -> None:
    one, same, other = (country_district(seed, "hilly", length_m=2_000.0) for seed in (SEED, SEED, SEED + 1))
    np.testing.assert_array_equal(one.path().up_m, same.path().up_m)
    assert one.layout.roads.terrain.height_m(np.zeros(1), np.zeros(1)) != other.layout.roads.terrain.height_m(
        np.zeros(1), np.zeros(1)
    )
