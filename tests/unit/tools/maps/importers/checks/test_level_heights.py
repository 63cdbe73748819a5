"""A map without heights is refused, and with --flat its σ says what it is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from camber.formats.map_exchange.lanelet2 import LaneletMap
from camber.road_map.release import Release, read_release
from support.built_maps import build_map
from support.lanelet_maps import RAMP, lanelet2_bytes
from support.lanelet_maps import town as lanelet_town
from support.opendrive_maps import NO_ROWS, cubics, opendrive_bytes
from support.opendrive_maps import town as road_town
from support.refusals import Refused

pytest.importorskip("pyproj")

GIVEN = ("--sigma-m", "0.02", "--vertical-datum", "ellipsoidal")


def lanelets(folder: Path, town: LaneletMap, *options: str) -> int:
    (folder / "a.osm").write_bytes(lanelet2_bytes(town))
    return build_map("lanelet2", folder / "map", folder / "a.osm", *GIVEN, *options)


def with_heights(height_m: np.ndarray) -> LaneletMap:
    return dataclasses.replace(lanelet_town(), height_m=height_m)


ZERO = np.zeros(len(lanelet_town().height_m))
CONSTANT = ZERO + 431.25
ALMOST = CONSTANT + np.random.default_rng(5).uniform(-0.002, 0.002, len(ZERO))


@pytest.mark.parametrize("height_m", [ZERO, CONSTANT, ALMOST], ids=["zero", "constant", "to 2 mm"])
def test_a_lanelet_map_without_heights_is_refused(
    height_m: np.ndarray, tmp_path: Path, refused: Refused
) -> None:
    line = refused(lambda _: lanelets(tmp_path, with_heights(height_m)))
    assert "heights is 'level', expected a road's, which has slopes, or --flat" in line
    assert not (tmp_path / "map").exists()


def sigma_of(release: Release) -> dict[int, float]:
    surfaces = release.road_surfaces()
    return {
        link: float(surfaces.sigma_m[surfaces.link_id == link].min())
        for link in set(surfaces.link_id.tolist())
    }


def test_with_flat_the_sigma_says_that_there_are_no_heights(tmp_path: Path) -> None:
    assert lanelets(tmp_path, with_heights(CONSTANT), "--flat") == 0
    release = read_release(tmp_path / "map")
    assert list(sigma_of(release).values()) == pytest.approx([10.0] * 5, abs=0.01)
    assert "level roads have no heights, σ 10 m" in release.manifest.surrogate


def test_one_region_without_heights_is_refused_too_and_only_its_sigma_grows(
    tmp_path: Path, refused: Refused
) -> None:
    town = lanelet_town()
    ramp = next(each for each in town.lanelets if each.lanelet_id == RAMP)
    height_m = town.height_m.copy()
    height_m[[town.row_of[ref] for ref in ramp.left + ramp.right]] = height_m[town.row_of[ramp.left[0]]]
    assert "lanelet 301, heights is 'level'" in refused(lambda _: lanelets(tmp_path, with_heights(height_m)))
    assert lanelets(tmp_path, with_heights(height_m), "--flat") == 0
    sigma_m = sigma_of(read_release(tmp_path / "map"))
    assert sigma_m.pop(RAMP) == pytest.approx(10.0, abs=0.01)
    assert max(sigma_m.values()) < 0.03


@pytest.mark.parametrize(
    "rows", [NO_ROWS, cubics((0.0, 0.0, 0.0, 0.0, 0.0)), cubics((0.0, 77.7, 1e-4, 0.0, 0.0))]
)
def test_an_opendrive_map_without_heights_is_refused(
    rows: np.ndarray, tmp_path: Path, refused: Refused
) -> None:
    flat = [dataclasses.replace(road, elevation=rows, superelevation=NO_ROWS) for road in road_town().roads]
    (tmp_path / "a.xodr").write_bytes(opendrive_bytes(dataclasses.replace(road_town(), roads=flat)))

    def build(*options: str) -> int:
        return build_map("opendrive", tmp_path / "map", tmp_path / "a.xodr", *GIVEN, *options)

    assert "--flat" in refused(lambda _: build())
    assert build("--flat", "--flat-sigma-m", "0.05") == 0
    assert list(sigma_of(read_release(tmp_path / "map")).values()) == pytest.approx(
        [np.hypot(0.05, 0.02)] * 10, abs=1e-3
    )


def test_a_flat_road_with_a_crossfall_has_heights(tmp_path: Path) -> None:
    """A street on a plain: no slope along, 1.5 % across, as roads are built to drain."""
    town = road_town()
    roads = [
        dataclasses.replace(
            road,
            elevation=cubics((0.0, 3.0, 0.0, 0.0, 0.0)),
            superelevation=cubics((0.0, 0.015, 0.0, 0.0, 0.0)),
        )
        for road in town.roads
    ]
    (tmp_path / "a.xodr").write_bytes(opendrive_bytes(dataclasses.replace(town, roads=roads)))
    assert build_map("opendrive", tmp_path / "map", tmp_path / "a.xodr", *GIVEN) == 0
