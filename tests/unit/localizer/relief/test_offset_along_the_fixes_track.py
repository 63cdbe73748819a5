"""The fixes' own track by their heights: which bases are named on made-up hills, and on two real drives."""

from __future__ import annotations

import math

import pytest

from support import boreas_relief
from support.boreas_relief import DAYS
from support.fix_track_drives import base_off, boreas, judged, led_away, offsets, over_hills
from support.made_up_relief import flat, hills

RIGHT = base_off(0.0, 0.0)
needs_boreas = pytest.mark.skipif(
    boreas_relief.folder() is None, reason="CAMBER_DATA/boreas-tracks is not there"
)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("yaw_deg", [0, 225])
def test_a_base_that_is_off_is_named_on_hills(seed: int, yaw_deg: int) -> None:
    yaw_rad = math.radians(yaw_deg)
    named, _ = judged(*over_hills(hills(seed, 0.03), seed), base_off(1.7, yaw_rad))
    assert named is not None
    path_m, offset = named
    print(f"seed {seed}, {yaw_deg}°: after {path_m:.0f} m {offset.east_north_m}")
    assert offset.kind == "base"
    assert path_m <= 1500.0
    truth_m = 1.7 * math.cos(yaw_rad), 1.7 * math.sin(yaw_rad)
    assert math.dist(offset.east_north_m, truth_m) < 0.8


@pytest.mark.parametrize("seed", range(4))
def test_right_fixes_are_not_named_on_hills(seed: int) -> None:
    print(f"seed {seed}")
    drive, road = over_hills(hills(seed), seed, length_m=4000.0)
    assert len(list(offsets(drive, road, RIGHT))) > 10
    named, _ = judged(drive, road, RIGHT)
    assert named is None


def test_fixes_that_are_led_away_are_no_base() -> None:
    kinds = []
    for seed in range(2):
        drive, road = over_hills(hills(seed, 0.03), seed, length_m=4000.0)
        named, _ = judged(drive, road, led_away(0.05, 0.0, 150.0))
        kinds.append(named and named[1].kind)
    print(f"seeds 0 and 1: {kinds}")
    assert kinds == ["drift"] * 2


def test_a_flat_road_shows_no_base() -> None:
    assert not list(offsets(*over_hills(flat((0.02, 0.01)), 1), base_off(12.0, 1.0)))


@needs_boreas
def test_right_fixes_of_two_real_drives_are_not_named() -> None:
    for days in (DAYS, DAYS[::-1]):
        named, most = judged(*boreas(*days), RIGHT)
        print(f"{days[1]}: largest χ² {most:.1f}")
        assert named is None


@needs_boreas
def test_most_bases_that_are_off_are_named_on_a_real_road() -> None:
    """Docs have all of 48; here 8 of them."""
    named = [
        judged(*boreas(*DAYS, from_m=500.0, to_m=2100.0), base_off(1.7, k * math.pi / 4.0))[0]
        for k in range(8)
    ]
    print([None if one is None else round(one[0]) for one in named])
    assert sum(one is not None and one[0] <= 1500.0 for one in named) >= 6
    assert all(one is None or one[1].kind == "base" for one in named)
