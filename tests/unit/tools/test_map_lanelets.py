"""`camber map build lanelet2`: levels, topology, ids and heights of a made-up town, and of a recorded circuit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.formats.map_exchange.lanelet2 import LaneletMap, read_lanelet2
from camber.road_map.release import Release, read_release
from support.built_maps import build_map, elevation_map, known_roads, link_ends, link_levels
from support.lanelet_maps import (
    BRIDGE,
    FRAME,
    ONCOMING,
    RAMP,
    STREET_EAST,
    STREET_WEST,
    bridge_height_m,
    lanelet2_bytes,
    ramp_height_m,
    street_height_m,
    town,
)
from support.refusals import Refused

Floats = NDArray[np.float64]

ELLIPSOIDAL = ("--vertical-datum", "ellipsoidal")


def imported(folder: Path, lanelets: LaneletMap, *options: object) -> int:
    folder.mkdir(exist_ok=True)
    (folder / "town.osm").write_bytes(lanelet2_bytes(lanelets))
    return build_map("lanelet2", folder / "map", folder / "town.osm", "--sigma-m", "0.02", *options)


def build(folder: Path, lanelets: LaneletMap, *options: object) -> Release:
    assert imported(folder, lanelets, *(options or ELLIPSOIDAL)) == 0
    return read_release(folder / "map")


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    return build(tmp_path_factory.mktemp("town"), town())


def roads_at(release: Release, east_m: Floats, north_m: Floats, *links: int) -> Floats:
    """Elevations of the release at places of the town; all must be known."""
    plane = np.column_stack((east_m, north_m))
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(plane, np.zeros(len(plane)))
    return known_roads(release, latitude, longitude, *links).elevation_m


def test_elevations_are_those_that_the_map_was_made_of_within_a_millimetre(release: Release) -> None:
    rng = np.random.default_rng(7)
    along, across = rng.uniform(-59.0, 59.0, 400), rng.uniform(-1.0, 1.0, 400)
    bridge = roads_at(release, 2.0 * across, along, BRIDGE)
    assert np.abs(bridge - bridge_height_m(along, 2.0 * across)).max() < 1e-3
    street = roads_at(release, along - 60.0, -1.75 + 1.75 * across, STREET_WEST)
    assert np.abs(street - street_height_m(along - 60.0, -1.75 + 1.75 * across)).max() < 1e-3
    turn = rng.uniform(0.0, 0.5 * math.pi, 400)
    radius = 30.0 + 1.9 * across
    ramp = roads_at(release, 30.0 - radius * np.cos(turn), 60.0 + radius * np.sin(turn), RAMP)
    # Between points 1.3 m apart on a circle the borders are straight.
    assert np.abs(ramp - ramp_height_m(turn)).max() < 1e-3


def test_there_are_no_gaps_along_a_lane(release: Release) -> None:
    turn = np.linspace(0.0, 0.5 * math.pi, 500)
    for radius in (28.05, 30.0, 31.95):
        roads_at(release, 30.0 - radius * np.cos(turn), 60.0 + radius * np.sin(turn), RAMP)


def test_what_lies_over_something_is_on_a_higher_level(release: Release) -> None:
    levels = link_levels(release)
    assert levels == {STREET_WEST: 0, STREET_EAST: 0, ONCOMING: 0, BRIDGE: 1, RAMP: 0}
    surfaces = release.road_surfaces()
    assert {levels[link] for link in surfaces.link_id.tolist()} == {0, 1}
    assert [levels[link] for link in surfaces.link_id.tolist()] == surfaces.level.tolist()


def test_under_the_bridge_the_link_says_which_road_it_is(release: Release) -> None:
    heights = elevation_map(release)
    latitude, longitude, _ = FRAME.geodetic_from_east_north(-0.5, -1.0, 0.0)
    assert heights.road(latitude, longitude).reason == "levels_ambiguous"
    street, bridge = (heights.road(latitude, longitude, [link]) for link in (STREET_WEST, BRIDGE))
    assert bridge.elevation_m - street.elevation_m == pytest.approx(8.0, abs=0.1)


def test_links_share_a_node_where_lanelets_share_their_end_points(release: Release) -> None:
    ends = link_ends(release)
    assert ends[STREET_WEST][1] == ends[STREET_EAST][0]
    assert ends[BRIDGE][1] == ends[RAMP][0]
    assert len({node for pair in ends.values() for node in pair}) == 8


def test_a_map_read_again_is_the_same_map_and_other_heights_keep_their_surfaces(tmp_path: Path) -> None:
    first, again = (build(tmp_path / name, town()) for name in ("a", "b"))
    assert first.hashes() == again.hashes()
    made = town()
    raised_m = 0.25 * (made.latitude_rad > FRAME.latitude_rad)
    higher = build(tmp_path / "c", replace(made, height_m=made.height_m + raised_m))
    ids = [release.road_surfaces().surface_id.tolist() for release in (first, higher)]
    assert ids[0] == ids[1]
    assert first.hashes() != higher.hashes()


def test_a_lane_with_another_course_has_new_surfaces_that_come_from_the_old_ones(tmp_path: Path) -> None:
    made = town()
    first = build(tmp_path, made)
    moved = made.latitude_rad.copy()
    moved[made.row_of[1030]] += 0.3 / 6.4e6  # the right border of one lane
    previous = ("--previous", tmp_path / "map")
    second = build(tmp_path, replace(made, latitude_rad=moved), *ELLIPSOIDAL, *previous)
    before, after = first.road_surfaces(), second.road_surfaces()
    kept = np.isin(after.surface_id, before.surface_id)
    assert set(after.link_id[~kept].tolist()) == {STREET_WEST}
    children, parents = second.manifest.lineage_surface_id, second.manifest.lineage_parent_id
    gone = set(before.surface_id.tolist()) - set(after.surface_id.tolist())
    assert len(children) == len(parents)
    assert set(children.tolist()) == set(after.surface_id[~kept].tolist())
    assert set(parents.tolist()) <= gone
    assert second.root.map_version == first.root.map_version + 1


@pytest.mark.parametrize(
    ("options", "output"),
    [
        ((), "vertical datum is 'not stated', expected --vertical-datum with its name"),
        (("--vertical-datum", "EPSG:5773"), "expected the grid us_nga_egm96_15.tif in "),
        (("--geoid-undulation-m", "45"), "expected all of --geoid-undulation-m"),
        (
            ("--geoid-undulation-m", "45", "--geoid-sigma-m", "0.1", "--geoid-source", " "),
            "the undulation has no source",
        ),
    ],
)
def test_heights_of_an_unknown_kind_are_refused_in_one_line(
    options: tuple[str, ...], output: str, tmp_path: Path, refused: Refused
) -> None:
    line = refused(lambda _: imported(tmp_path, town(), *options))
    assert line.startswith(f"camber map build lanelet2: {tmp_path / 'town.osm'}: ")
    assert output in line
    assert not (tmp_path / "map").exists()


def test_an_undulation_that_the_user_answers_for_stands_in_the_release(tmp_path: Path) -> None:
    constant = ("--geoid-undulation-m", "45.5", "--geoid-sigma-m", "0.1", "--geoid-source", "mark 17")
    release = build(tmp_path, town(), *constant)
    assert "mark 17" in release.manifest.surrogate
    assert release.road_surfaces().sigma_m == pytest.approx(math.hypot(0.02, 0.1), rel=1e-3)
    result = roads_at(release, np.array([1.0]), np.array([20.0]), BRIDGE)
    assert result - bridge_height_m(np.array([20.0]), np.zeros(1)) == pytest.approx(45.5, abs=1e-3)


def test_a_recorded_circuit_is_followed_within_a_centimetre(data: Path, tmp_path: Path) -> None:
    path = data / "lanelet2" / "monza.osm"
    if not path.exists():
        pytest.skip("CAMBER_DATA does not name a folder with lanelet2")
    assert build_map("lanelet2", tmp_path / "map", path, "--sigma-m", "0.02", *ELLIPSOIDAL) == 0
    release, circuit = read_release(tmp_path / "map"), read_lanelet2(path)
    heights = elevation_map(release)
    off = {}
    for lanelet in circuit.lanelets:
        ids = lanelet.left + lanelet.right
        rows = [circuit.row_of[ref] for ref in ids]
        result = heights.roads(circuit.latitude_rad[rows], circuit.longitude_rad[rows], [lanelet.lanelet_id])
        assert len(result.known) == len(rows)
        difference_m = np.abs(result.elevation_m - circuit.height_m[rows])
        off |= {ids[k]: difference_m[k] for k in np.flatnonzero(difference_m > 0.01).tolist()}
        assert (result.sigma_m >= 0.5 * difference_m).all()
    # Two points of one border are 1 cm apart and differ by 40 cm in height: no road has both.
    assert len(off) == 2
    rows = [circuit.row_of[ref] for ref in off]
    assert np.ptp(circuit.height_m[rows]) == pytest.approx(0.4027, abs=1e-3)
