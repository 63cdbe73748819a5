"""The road under the antenna where roads part: one road while the surfaces agree, of no level until they part."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.links.link_matching import LinkMatch
from camber.localizer.road.road_below_antenna import RoadBelowAntenna
from camber.road_map.release import read_release
from camber.schemas.pose import Road
from camber.tools.localize.local_map_queries import LocalMapQueries
from support.small_map import at, link, surface, write

NS = 1_500_000_000 * 1_000_000_000
LINKS = [
    link(1, (1, 2), [(-200.0, 0.0), (0.0, 0.0)]),
    link(2, (2, 3), [(0.0, 0.0), (100.0, 0.0)]),
    link(3, (2, 4), [(0.0, 0.0), (20.0, 0.0), (40.0, 1.0), (60.0, 5.0)], level=1),
]
ALL = (3, 1, 2)
RAMP = 3
ON = PoseEstimate(
    time_ns=NS,
    mode="scan_match",
    provenance="scan_match",
    east_m=0.0,
    north_m=0.0,
    yaw_rad=0.0,
    yaw_known=True,
    covariance=np.diag([0.05**2, 0.05**2, 0.01**2]),
    speed_m_s=10.0,
    yaw_rate_rad_s=0.0,
    rotation_read=True,
    anchor_time_ns=None,
    match_time_ns=NS,
    link=LinkMatch(status="ambiguous", link_id=1, candidates=ALL),
)


class Fork:
    """A street to the east, from which a ramp parts at 0 m, to the left, its surface that much above the street's."""

    def __init__(self, folder: Path, ramp_above_m: float) -> None:
        rows = [surface(10 + k, -190.0 + 20.0 * k, link_id=1 if k < 10 else 2) for k in range(15)]
        up_m = 50.0 + ramp_above_m
        rows += [
            surface(50 + k, 10.0 + 20.0 * k, north_m, link_id=3, level=1, heights_m=up_m)
            for k, north_m in enumerate((0.0, 1.0, 4.0))
        ]
        write(folder, rows, LINKS)
        self.counts: Counter[str] = Counter()
        self.road_below = RoadBelowAntenna(15.0, LocalMapQueries(read_release(folder)), self)
        self.epochs = 0

    def issue(self, code: str, text: str) -> None:
        raise AssertionError(f"{code}: {text}")

    def count(self, name: str) -> None:
        self.counts[name] += 1

    def road(
        self, east_m: float, north_m: float = 0.0, links: tuple[int, ...] = ALL, sigma_m: float = 0.05
    ) -> Road:
        self.epochs += 1
        covariance = np.diag([sigma_m**2, sigma_m**2, 0.01**2])
        time_ns = NS + self.epochs * 100_000_000
        levels = {1 if link_id == RAMP else 0 for link_id in links}
        link = replace(ON.link, level=levels.pop() if len(levels) == 1 else None, candidates=links)
        here = replace(ON, time_ns=time_ns, link=link, covariance=covariance)
        return self.road_below.update(here, *at(east_m, north_m))


@pytest.fixture
def fork(tmp_path: Path) -> Fork:
    """The ramp lies as much above the street as two surveys differ: more than the map calls agreement."""
    return Fork(tmp_path / "map", 0.08)


def test_where_a_ramp_lies_on_the_street_the_level_is_not_known_and_the_elevation_stays_the_streets(
    fork: Fork,
) -> None:
    roads = {x: fork.road(float(x), links=(1,) if x < -20 else ALL) for x in range(-40, 90)}
    assert {roads[x].level for x in range(-40, 0)} == {0}
    assert {roads[x].level for x in range(40)} == {None}
    assert {roads[x].level for x in range(65, 90)} == {0}
    assert [road.elevation_m for road in roads.values()] == pytest.approx([50.0] * len(roads), abs=1e-3)


def test_on_the_ramp_it_is_the_ramp_as_soon_as_the_street_ends_next_to_it(fork: Fork) -> None:
    roads = [fork.road(float(x), float(np.interp(x, (20, 40, 60), (0, 2, 5)))) for x in range(-40, 60)]
    assert all(road.status == "known" for road in roads)
    levels = [road.level for road in roads]
    assert set(levels[:40]) == {0}
    assert set(levels[40:]) == {None, 1}
    first = levels.index(1)
    assert set(levels[first:]) == {1}
    elevations = [road.elevation_m for road in roads]
    assert elevations == pytest.approx([50.0] * first + [50.08] * (len(roads) - first), abs=1e-3)


def test_a_vague_pose_has_no_level_while_street_and_ramp_are_in_question(fork: Fork) -> None:
    assert fork.road(-30.0, links=(1,), sigma_m=2.0).level == 0
    parting = [fork.road(float(x), 0.5, sigma_m=2.0) for x in range(-10, 40, 2)]
    assert {(road.status, road.level) for road in parting} == {("known", None)}
    assert [road.elevation_m for road in parting] == pytest.approx([50.0] * len(parting), abs=0.081)
    for one, north_m, level in ((2, 0.0, 0), (RAMP, 5.0, 1)):
        assert fork.road(50.0, north_m, links=(one,), sigma_m=2.0).level == level


def test_a_pose_that_was_vague_where_they_parted_does_not_take_up_the_level_from_before(fork: Fork) -> None:
    assert fork.road(-30.0, links=(1,), sigma_m=2.0).level == 0
    assert fork.road(10.0, sigma_m=2.0).level is None
    assert fork.road(12.0).level is None
    assert fork.road(50.0, 5.0).level == 1


def test_its_sigma_holds_what_the_surfaces_differ_by(fork: Fork) -> None:
    assert fork.road(-10.0, links=(1,)).sigma_m == pytest.approx(0.03, abs=1e-6)
    assert fork.road(10.0).sigma_m == pytest.approx(0.08, abs=1e-3)


def test_an_epoch_without_a_road_is_no_loss_of_memory(fork: Fork) -> None:
    assert fork.road(-2.0, links=(1,)).level == 0
    assert fork.road(-1.0, sigma_m=16.0).reason == "pose_too_uncertain"
    assert fork.road(10.0).elevation_m == pytest.approx(50.0, abs=1e-3)


def test_nobody_knows_the_level_who_begins_where_they_agree_but_the_height(fork: Fork) -> None:
    road = fork.road(10.0)
    assert (road.status, road.level) == ("known", None)
    assert road.elevation_m == pytest.approx(50.0, abs=0.081)


def test_of_more_links_than_are_asked_one_by_one_the_road_has_no_level(fork: Fork) -> None:
    assert fork.road(-2.0, links=(1,)).level == 0
    road = fork.road(25.0, links=(*ALL, 4, 5, 6))
    assert road.level is None
    assert road.elevation_m is None or road.elevation_m == pytest.approx(50.0, abs=0.081)


@pytest.mark.parametrize("jump", [True, False])
def test_after_a_jump_or_far_from_it_the_road_driven_before_says_nothing(fork: Fork, jump: bool) -> None:
    assert fork.road(-2.0 if jump else -150.0, links=(1,)).level == 0
    if jump:
        fork.road_below.forget()
    assert fork.road(10.0).level is None


def test_roads_above_one_another_are_not_one(tmp_path: Path) -> None:
    fork = Fork(tmp_path / "map", 1.0)
    assert fork.road(-2.0, links=(1,)).level == 0
    road = fork.road(10.0)
    assert (road.status, road.reason, road.elevation_m) == ("unknown", "levels_ambiguous", None)
    assert fork.road(10.0, links=(2,)).level == 0


def test_another_level_next_to_a_vague_pose_does_not_hide_the_road_that_the_links_lead_along(
    fork: Fork,
) -> None:
    road = fork.road(30.0, links=(2,), sigma_m=1.0)
    assert (road.status, road.level) == ("known", 0)
    assert road.elevation_m == pytest.approx(50.0, abs=1e-3)
