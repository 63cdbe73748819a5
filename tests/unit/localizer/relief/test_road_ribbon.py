"""The road along the driven way: which plane a place lies on."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.relief.road_ribbon import RibbonPlane, RoadRibbon


@pytest.mark.parametrize("seed", range(3))
def test_a_place_lies_on_the_plane_that_is_nearest(seed: int) -> None:
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    planes = [
        RibbonPlane(*place, elevation, 0.03, 0.0, 0.0)
        for elevation, place in enumerate(random.uniform(-9_990.0, -9_900.0, (700, 2)))
    ]
    cells = 2.0 * random.integers(-4_995, -4_950, (400, 2))  # centres of cells: a cell has one plane
    away_m = np.array([[np.hypot(p.east_m - x, p.north_m - y) for p in planes] for x, y in cells])
    known = RoadRibbon(planes).at(cells[:, 0], cells[:, 1])
    near = away_m.min(axis=1) < 6.0
    assert near.sum() > 0
    assert known.elevation_m[near].tolist() == away_m.argmin(axis=1)[near].tolist()
    assert np.isnan(known.elevation_m[~near]).all()
