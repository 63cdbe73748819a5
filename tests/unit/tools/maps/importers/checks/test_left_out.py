"""One invalid lane costs itself; the build says so, and a map that loses much is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from camber.formats.map_exchange.opendrive import LaneSection, OpenDrive, OpenDriveRoad
from camber.road_map.release import read_release
from camber.tools.maps.importers.lanes import named_id
from support.built_maps import build_map, link_ends
from support.lanelet_maps import lanelet2_bytes
from support.lanelet_maps import town as lanelet_town
from support.opendrive_maps import EAST_M, NORTH_M, cubics, geometry, lane, opendrive_bytes, road, town
from support.refusals import Refused

pytest.importorskip("pyproj")

ROADS = 25


def parallel(identity: int, *lanes: object) -> OpenDriveRoad:
    """A road of 40 m with a slope, 20 m from the next one."""
    return road(
        str(identity),
        [geometry((EAST_M, NORTH_M + 20.0 * identity, 0.0), 40.0)],
        [LaneSection(0.0, list(lanes) or [lane(-1)])],  # type: ignore[arg-type]
        elevation=cubics((0.0, 500.0 + identity, 0.05, 0.0, 0.0)),
    )


def roads(**replaced: OpenDriveRoad) -> OpenDrive:
    """Of parallel roads, some replaced: r7=…"""
    made = [replaced.get(f"r{k}", parallel(k)) for k in range(ROADS)]
    return dataclasses.replace(town(), roads=made, connections=[])


def build(folder: Path, drive: OpenDrive, *options: str) -> int:
    (folder / "a.xodr").write_bytes(opendrive_bytes(drive))
    options = ("--vertical-datum", "ellipsoidal", *options)
    return build_map("opendrive", folder / "map", folder / "a.xodr", "--sigma-m", "0.02", *options)


BAD = parallel(7, lane(-1, -2.0))
REASON = "road 7, laneSection at s 0, lane -1, width is '-2', expected 0 to 500"


def test_an_invalid_lane_is_left_out_and_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert build(tmp_path, roads(r7=BAD)) == 0
    out = capsys.readouterr().out.splitlines()
    assert f"{tmp_path / 'a.xodr'}: left out: 1 of 25 lanes, 4.0 % of the area" in out
    assert [line for line in out if "road 7" in line] == [
        f"  road 7, section 0, lane -1: {tmp_path / 'a.xodr'}: {REASON}"
    ]
    links = read_release(tmp_path / "map").road_links().link_id.tolist()
    assert sorted(links) == sorted(
        named_id("link", f"road {k}, section 0, lane -1") for k in range(ROADS) if k != 7
    )


def test_strict_refuses_the_map_for_one_invalid_lane(tmp_path: Path, refused: Refused) -> None:
    line = refused(lambda _: build(tmp_path, roads(r7=BAD), "--strict"))
    assert line == f"camber map build opendrive: {tmp_path / 'a.xodr'}: {REASON}"


@pytest.mark.parametrize(
    "bad",
    [
        {"r7": BAD, "r8": parallel(8, lane(-1, 900.0))},
        {
            "r7": dataclasses.replace(
                BAD, length_m=120.0, geometries=[geometry((EAST_M, NORTH_M, 2.0), 120.0)]
            )
        },
    ],
    ids=["8 % of the lanes", "4 % of the lanes, 11 % of the area"],
)
def test_a_map_that_loses_more_than_a_twentieth_is_refused_unless_an_option_allows_it(
    bad: dict[str, OpenDriveRoad], tmp_path: Path, refused: Refused
) -> None:
    line = refused(lambda _: build(tmp_path, roads(**bad)))
    assert "at most 5 % left out (--max-loss-percent), but " in line
    assert REASON in line
    assert not (tmp_path / "map").exists()
    assert build(tmp_path, roads(**bad), "--max-loss-percent", "15") == 0


def test_a_lane_that_no_surface_can_follow_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cliff = dataclasses.replace(
        parallel(7), elevation=cubics((0.0, 500.0, 0.0, 0.0, 0.0), (20.0, 600.0, 0.0, 0.0, 0.0))
    )
    assert build(tmp_path, roads(r7=cliff)) == 0
    assert "road 7, section 0, lane -1: " in capsys.readouterr().out


def test_a_level_lane_on_a_banked_road_is_left_out_as_its_height_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    level = dataclasses.replace(lane(-1), level=True)
    banked = dataclasses.replace(parallel(7, level), superelevation=cubics((0.0, 0.05, 0.0, 0.0, 0.0)))
    assert build(tmp_path, roads(r7=banked, r8=parallel(8, level))) == 0
    out = capsys.readouterr().out
    assert "lane -1, level is 'true', expected false on a road with superelevation" in out
    assert "left out: 1 of 25 lanes" in out


def test_all_lanes_lost_is_refused_whatever_the_option_says(tmp_path: Path, refused: Refused) -> None:
    drive = dataclasses.replace(town(), roads=[BAD], connections=[])
    assert REASON in refused(lambda _: build(tmp_path, drive, "--max-loss-percent", "100"))


@pytest.mark.parametrize("sliver_m", [5e-5, 0.0, -1e-9], ids=["0.05 mm", "none", "past the end"])
def test_sliver_sections_are_skipped_and_lanes_go_on_across_them(sliver_m: float, tmp_path: Path) -> None:
    """As RoadRunner writes where it has split a road: a section of no length in the middle, and one at the end."""
    through = [lane(-1, before=-1, after=-1)]
    starts = (0.0, 20.0 - max(sliver_m, 0.0), 20.0, 40.0 - sliver_m)
    split = dataclasses.replace(parallel(7), sections=[LaneSection(s, list(through)) for s in starts])
    assert build(tmp_path, roads(r7=split), "--strict") == 0
    ends = link_ends(read_release(tmp_path / "map"))
    first, second = (named_id("link", f"road 7, section {k}, lane -1") for k in (0, 2))
    assert len(ends) == ROADS + 1
    assert ends[first][1] == ends[second][0]


def test_an_invalid_lanelet_is_left_out_and_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = lanelet2_bytes(lanelet_town())
    at = data.index(b'node id="4000"')  # a point of the ramp alone
    data = data[:at] + data[at:].replace(b'k="ele" v="', b'k="ele" v="?', 1)
    (tmp_path / "a.osm").write_bytes(data)
    given = (tmp_path / "a.osm", "--sigma-m", "0.02", "--vertical-datum", "ellipsoidal")
    assert build_map("lanelet2", tmp_path / "map", *given) == 2
    assert "1 of 5 lanes, 20.0 % of the area; the first: " in capsys.readouterr().err
    assert build_map("lanelet2", tmp_path / "map", *given, "--max-loss-percent", "20") == 0
    assert "  lanelet 301: " in capsys.readouterr().out
    heights = np.concatenate(
        [grid.ravel() for grid in read_release(tmp_path / "map").road_surfaces().heights_m]
    )
    assert np.isfinite(heights).all()
    assert build_map("lanelet2", tmp_path / "strict", *given, "--strict") == 2
    assert "node 4000, ele is '?" in capsys.readouterr().err
