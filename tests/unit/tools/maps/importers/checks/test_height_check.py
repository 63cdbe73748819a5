"""Each build compares its heights with the source by a second reading, and fails where they differ."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange import opendrive_geometry
from camber.formats.map_exchange.lanelet_places import border_places
from camber.formats.map_exchange.opendrive import LaneSection
from camber.formats.map_exchange.opendrive_places import lane_places
from camber.road_map.release import open_release
from camber.road_map.road_columns import RoadSurfaces
from camber.tools.maps.importers import lanelets
from camber.tools.maps.importers.checks.height_check import SourceHeights, checked_heights
from support.built_maps import build_map
from support.lanelet_maps import lanelet2_bytes
from support.lanelet_maps import town as lanelet_town
from support.opendrive_maps import cubics, geometry, lane, opendrive_bytes, road
from support.opendrive_maps import town as road_town
from support.refusals import Refused

pytest.importorskip("pyproj")

GIVEN = ("--sigma-m", "0.02", "--vertical-datum", "ellipsoidal", "--check-seed", "17")


def roads(folder: Path, *options: str) -> int:
    (folder / "a.xodr").write_bytes(opendrive_bytes(road_town()))
    return build_map("opendrive", folder / "map", folder / "a.xodr", *GIVEN, *options)


def lanes(folder: Path, *options: str) -> int:
    (folder / "a.osm").write_bytes(lanelet2_bytes(lanelet_town()))
    return build_map("lanelet2", folder / "map", folder / "a.osm", *GIVEN, *options)


@pytest.mark.parametrize("build", [roads, lanes])
def test_a_build_says_how_far_its_heights_are_from_the_source(
    build: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build(tmp_path) == 0  # type: ignore[operator]
    line = next(line for line in capsys.readouterr().out.splitlines() if "against the source" in line)
    figures = re.search(
        r"at (\d+) places \(seed 17\): median (\S+) mm, 99 % (\S+) mm, most (\S+) mm, (\S+) σ", line
    )
    assert figures is not None, line
    count, median, p99, most, sigmas = map(float, figures.groups())
    assert count > 1900
    assert median <= p99 <= most < 1.5
    assert sigmas < 0.1


def test_a_map_of_local_coordinates_is_compared_with_its_source_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "map_projector_info.yaml").write_text("projector_type: MGRS\nmgrs_grid: 32UPU\n")
    (tmp_path / "a.osm").write_bytes(in_local_coordinates(lanelet2_bytes(lanelet_town())))
    assert build_map("lanelet2", tmp_path / "local", tmp_path / "a.osm", *GIVEN) == 0
    assert re.search(r"against the source at (19\d\d|2000) places", capsys.readouterr().out)
    assert lanes(tmp_path) == 0
    lines = (open_release(tmp_path / name).road_links().vertices for name in ("local", "map"))
    local, by_degrees = (np.array([line[[0, -1]] for line in of_map]) for of_map in lines)
    np.testing.assert_allclose(local, by_degrees, rtol=0.0, atol=1e-3 / 6.4e6)


def in_local_coordinates(data: bytes) -> bytes:
    """The nodes of a map with `local_x` and `local_y` in their 100 km square instead of latitude and longitude."""
    pyproj = pytest.importorskip("pyproj")
    utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32632")

    def local(match: re.Match[bytes]) -> bytes:
        x_m, y_m = (metres % 1e5 for metres in utm.transform(float(match[1]), float(match[2])))
        tags = f'<tag k="local_x" v="{x_m:.5f}" /><tag k="local_y" v="{y_m:.5f}" />'
        return f'lat="" lon="">{tags}'.encode()

    return re.sub(rb'lat="(\S+)" lon="(\S+)">', local, data)


def test_a_wrong_reading_of_a_curve_fails_the_build_and_names_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    """The parameter of a paramPoly3 taken for the share of its length, as it was."""

    def by_share(part: object) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.0, part.length_m]), np.array([0.0, 1.0])  # type: ignore[attr-defined]

    uneven = (0.0, 15.0, 120.0, -75.0, 0.0, 0.0, 30.0, -10.0)
    p = np.linspace(0.0, 1.0, 100_001)
    u, v = (np.polynomial.polynomial.polyval(p, uneven[k : k + 4]) for k in (0, 4))
    length_m = float(np.hypot(np.diff(u), np.diff(v)).sum())
    ramp = dataclasses.replace(
        road_town().roads[2],
        length_m=length_m,
        geometries=[
            dataclasses.replace(road_town().roads[2].geometries[0], length_m=length_m, numbers=uneven)
        ],
    )
    drive = dataclasses.replace(road_town(), roads=[*road_town().roads[:2], ramp, road_town().roads[3]])
    (tmp_path / "a.xodr").write_bytes(opendrive_bytes(drive))

    def build() -> int:
        return build_map("opendrive", tmp_path / "map", tmp_path / "a.xodr", *GIVEN)

    with monkeypatch.context() as patched:
        patched.setattr(opendrive_geometry, "_arc_lengths", by_share)
        line = refused(lambda _: build())
    assert re.search(r"height at road 3, section 0, lane -?1, s \S+ is '0\.\d+ m, \S+ sigma off'", line), line
    assert "(seed 17)" in line
    assert not (tmp_path / "map").exists()
    assert build() == 0


def test_a_shift_of_heights_along_a_lanelet_fails_the_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    true_sections = lanelets._sections

    def shifted(right: np.ndarray, left: np.ndarray) -> np.ndarray:
        return true_sections(right, left) + np.array((0.0, 0.0, 0.07))

    monkeypatch.setattr(lanelets, "_sections", shifted)
    assert "expected the source's within 3 σ (seed 17)" in refused(lambda _: lanes(tmp_path))


def test_what_is_beyond_three_sigma_fails_and_what_is_not_does_not() -> None:
    surfaces = one_surface()
    source = places_on_it(np.array([10.0, 10.05, 10.0]))
    assert "most 50.0 mm, 2.5 σ" in checked_heights(surfaces, source, seed=1, file="a")
    source = places_on_it(np.array([10.0, 10.07, 10.0]))
    with pytest.raises(
        FormatError, match=r"a: height at place 1 is '0\.070 m, 3\.5 sigma off', expected the source's"
    ):
        checked_heights(surfaces, source, seed=1, file="a")
    with pytest.raises(FormatError, match="height at place 1"):
        checked_heights(surfaces, places_on_it(np.array([10.0, math.nan, 10.0])), seed=1, file="a")
    assert "3.5 σ" in checked_heights(surfaces, source, seed=1, file="a", most_beyond=0.4)


def test_places_without_a_surface_fail_the_build() -> None:
    for source, first in (
        (places_on_it(np.full(3, 10.0), north_m=40.0), 0),
        (places_on_it(np.full(3, 10.0), north_m=1.0, last_north_m=40.0), 2),
    ):
        with pytest.raises(FormatError, match=f"height at place {first}, expected a surface"):
            checked_heights(one_surface(), source, seed=1, file="a")
    of_a_lane_left_out = dataclasses.replace(places_on_it(np.full(3, 99.0)), links=[[4]] * 3)
    assert "not compared" in checked_heights(one_surface(), of_a_lane_left_out, seed=1, file="a")


def one_surface() -> RoadSurfaces:
    """20 m by 4 m at a height of 10 m with σ 2 cm, on link 3."""
    return RoadSurfaces(
        surface_id=[1], link_id=[3], level=[0], latitude_rad=[0.8], longitude_rad=[0.2], yaw_rad=[0.0],
        half_length_m=[10.0], half_width_m=[2.0], sigma_m=[0.02], vehicles=[0], last_seen_ns=[0],
        heights_m=[np.full((2, 2), 10.0)],
    )  # type: ignore[arg-type]  # fmt: skip


def places_on_it(
    height_m: np.ndarray, north_m: float = 1.0, last_north_m: float | None = None
) -> SourceHeights:
    north = np.full(len(height_m), north_m)
    north[-1] = north_m if last_north_m is None else last_north_m
    return SourceHeights(
        latitude_rad=0.8 + north / 6.37e6,
        longitude_rad=np.full(len(height_m), 0.2),
        height_m=height_m,
        links=[[3]] * len(height_m),
        names=[f"place {k}" for k in range(len(height_m))],
    )


def test_the_second_readings_share_no_function_with_the_first() -> None:
    for reading, module in ((lane_places, "opendrive"), (border_places, "lanelet2")):
        source = Path(reading.__code__.co_filename).read_text()
        imports = [line for line in source.splitlines() if re.match(r"\s*(from|import) ", line)]
        assert not [line for line in imports if "camber" in line], module


def test_a_step_of_the_elevation_is_where_the_file_has_it(tmp_path: Path) -> None:
    """A profile that jumps by 8 cm: to a metre before it the road is as it was."""
    step = dataclasses.replace(
        road("5", [geometry((691_000.0, 5_334_000.0, 0.4), 40.0)], [LaneSection(0.0, [lane(-1)])]),
        elevation=cubics((0.0, 500.0, 0.03, 0.0, 0.0), (20.0, 500.68, 0.03, 0.0, 0.0)),
    )
    (tmp_path / "a.xodr").write_bytes(
        opendrive_bytes(dataclasses.replace(road_town(), roads=[step], connections=[]))
    )
    given = ("--sigma-m", "0.001", "--vertical-datum", "ellipsoidal", "--check-seed", "4")
    assert build_map("opendrive", tmp_path / "map", tmp_path / "a.xodr", *given) == 0
