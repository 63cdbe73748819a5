"""Ten OpenDRIVE files by another program's writer: heights are those of an evaluation of its parameters.

The places are computed here from the parameters, by summing small steps; neither the file nor the product's geometry is
used for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.map_server.elevation_queries import SelectedRoads
from camber.road_map.release import read_release
from camber.tools.maps.importers.lanes import named_id
from support.built_maps import build_map, known_roads
from support.opendrive_maps import EAST_M, GEOREFERENCE, NORTH_M

xodr = pytest.importorskip("scenariogeneration").xodr
pyproj = pytest.importorskip("pyproj")

Floats = NDArray[np.float64]

SIGMA_M = 0.02
STEP_M = 0.001


@dataclass(frozen=True, kw_only=True)
class DrawnRoad:
    """Parameters of a road: parts of the reference line, cubics (s, a, b, c, d), lanes of the second section."""

    start: tuple[float, float, float]
    parts: list[tuple[str, tuple[float, ...]]]
    elevation: list[tuple[float, ...]]
    superelevation: list[tuple[float, ...]]
    offset: list[tuple[float, ...]]
    middle: float
    widths: dict[tuple[int, int], tuple[float, ...]]
    """(section, lane) → a, b, c, d."""
    heights: dict[tuple[int, int], tuple[float, float]]


def drawn(rng: np.random.Generator, number: int) -> DrawnRoad:
    """A road of a line, clothoids, an arc and a parametric cubic that is passed unevenly, in some order."""
    bend = rng.uniform(0.005, 0.03) * rng.choice((-1.0, 1.0))
    reach = rng.uniform(40.0, 80.0)
    uneven = (
        0.0,
        0.45 * reach,
        1.35 * reach,
        -0.8 * reach,
        0.0,
        0.0,
        rng.uniform(-9.0, 9.0),
        rng.uniform(-3.0, 3.0),
    )
    parts: list[tuple[str, tuple[float, ...]]] = [
        ("line", (rng.uniform(20.0, 60.0),)),
        ("spiral", (0.0, bend, rng.uniform(20.0, 50.0))),
        ("arc", (bend, rng.uniform(20.0, 50.0))),
        ("paramPoly3", uneven),
        ("spiral", (bend, -0.5 * bend, rng.uniform(20.0, 50.0))),
    ]
    rng.shuffle(parts)  # type: ignore[arg-type]
    slope = rng.uniform(0.02, 0.08) * rng.choice((-1.0, 1.0))
    roll = rng.uniform(-0.05, 0.05)
    return DrawnRoad(
        start=(EAST_M + 2000.0 * number, NORTH_M, rng.uniform(-3.0, 3.0)),
        parts=parts,
        elevation=[(0.0, 500.0, slope, 2e-4, 0.0), (60.0, 500.0 + 60.0 * slope + 0.72, slope, -3e-4, 1e-6)],
        superelevation=[(0.0, roll, 0.0, 0.0, 0.0), (50.0, roll, 4e-4, -2e-6, 0.0)],
        offset=[(0.0, rng.uniform(-1.0, 1.0), 0.0, 0.0, 0.0)],
        middle=rng.uniform(60.0, 100.0),
        widths={
            (section, lane): (rng.uniform(3.0, 4.0), rng.uniform(-0.004, 0.004), 0.0, 0.0)
            for section in (0, 1)
            for lane in (1, -1, -2)
        },
        heights={(section, -2): (0.152, rng.uniform(0.1, 0.2)) for section in (0, 1)},
    )


def written(road: DrawnRoad, number: int) -> Any:
    """The road as the other program's objects."""
    plan = xodr.PlanView(*road.start)
    for kind, numbers in road.parts:
        plan.add_geometry(
            {
                "line": lambda n: xodr.Line(n[0]),
                "spiral": lambda n: xodr.Spiral(n[0], n[1], length=n[2]),
                "arc": lambda n: xodr.Arc(n[0], length=n[1]),
                "paramPoly3": lambda n: xodr.ParamPoly3(*n),
            }[kind](numbers)
        )
    lanes = xodr.Lanes()
    for row in road.offset:
        lanes.add_laneoffset(xodr.LaneOffset(*row))
    for section, begin in enumerate((0.0, road.middle)):
        made = xodr.LaneSection(begin, xodr.Lane(lane_type=xodr.LaneType.none))
        for lane_id in (1, -1, -2):
            kind = xodr.LaneType.shoulder if lane_id == -2 else xodr.LaneType.driving
            lane = xodr.Lane(kind, *road.widths[section, lane_id])
            if (section, lane_id) in road.heights:
                lane.add_height(*road.heights[section, lane_id])
            (made.add_left_lane if lane_id > 0 else made.add_right_lane)(lane)
        lanes.add_lanesection(made)
    made_road = xodr.Road(number, plan, lanes)
    for row in road.elevation:
        made_road.add_elevation(*row)
    for row in road.superelevation:
        made_road.add_superelevation(*row)
    return made_road


def reference(road: DrawnRoad) -> tuple[Floats, Floats]:
    """Distances (n,) and x, y, heading (n, 3) of the reference line, a millimetre or so apart."""
    x, y, heading = road.start
    distances, rows, begin = [], [], 0.0
    for kind, numbers in road.parts:
        if kind == "paramPoly3":
            p = np.linspace(0.0, 1.0, 100_001)
            u, v = (np.polynomial.polynomial.polyval(p, numbers[k : k + 4]) for k in (0, 4))
            s = np.append(0.0, np.cumsum(np.hypot(np.diff(u), np.diff(v))))
            du, dv = (
                np.polynomial.polynomial.polyval(p, np.polynomial.polynomial.polyder(numbers[k : k + 4]))
                for k in (0, 4)
            )
            turn = np.arctan2(dv, du)
        else:
            first, last, length = {
                "line": lambda n: (0.0, 0.0, n[0]),
                "arc": lambda n: (n[0], n[0], n[1]),
                "spiral": lambda n: n,
            }[kind](numbers)
            s = np.linspace(0.0, length, int(length / STEP_M) + 1)
            turn = first * s + 0.5 * (last - first) / length * s**2
            half = 0.5 * (turn[1:] + turn[:-1])
            u, v = (np.append(0.0, np.cumsum(f(half) * np.diff(s))) for f in (np.cos, np.sin))
        c, w = math.cos(heading), math.sin(heading)
        rows.append(np.column_stack((x + c * u - w * v, y + w * u + c * v, heading + turn)))
        distances.append(begin + s)
        x, y, heading = rows[-1][-1]
        begin += s[-1]
    return np.concatenate(distances), np.concatenate(rows)


def profile(rows: list[tuple[float, ...]], s: Floats) -> Floats:
    values = np.zeros(len(s))
    for start, *cubic in rows:
        values = np.where(s >= start, np.polynomial.polynomial.polyval(s - start, cubic), values)
    return values


def places(road: DrawnRoad, section: int, lane: int, rng: np.random.Generator) -> Floats:
    """Random x, y, z (n, 3) on a lane."""
    at, line = reference(road)
    begin, end = (0.0, road.middle) if section == 0 else (road.middle, float(at[-1]))
    s, share = rng.uniform(begin, end, 200), rng.uniform(0.02, 0.98, 200)
    side = 1 if lane > 0 else -1
    ds, edge = s - begin, np.zeros(200)
    for k in range(1, abs(lane) + 1):
        inner = edge
        edge = inner + np.polynomial.polynomial.polyval(ds, road.widths[section, side * k])
    t = profile(road.offset, s) + side * (inner + share * (edge - inner))
    roll = profile(road.superelevation, s)
    x, y, heading = (np.interp(s, at, column) for column in line.T)
    low, high = road.heights.get((section, lane), (0.0, 0.0))
    z = profile(road.elevation, s) + t * np.sin(roll) + low + share * (high - low)
    return np.column_stack(
        (x - np.sin(heading) * t * np.cos(roll), y + np.cos(heading) * t * np.cos(roll), z)
    )


@pytest.mark.parametrize("seed", range(10))
def test_heights_of_a_file_of_another_writer_are_right_to_millimetres(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(100 + seed)
    roads = [drawn(rng, number) for number in range(2)]
    file = xodr.OpenDrive("drawn", geo_reference=GEOREFERENCE)
    for number, road in enumerate(roads):
        file.add_road(written(road, number))
    file.adjust_roads_and_lanes()
    file.write_xml(str(tmp_path / "drawn.xodr"))
    given = ("--sigma-m", str(SIGMA_M), "--vertical-datum", "ellipsoidal", "--check-seed", str(seed))
    assert build_map("opendrive", tmp_path / "map", tmp_path / "drawn.xodr", *given, "--strict") == 0
    release = read_release(tmp_path / "map")
    off_m, sigmas = [], []
    for number, road in enumerate(roads):
        for section in (0, 1):
            for lane in (1, -1, -2):
                at = places(road, section, lane, rng)
                longitude, latitude = pyproj.Proj(GEOREFERENCE)(at[:, 0], at[:, 1], inverse=True)
                link = named_id("link", f"road {number}, section {section}, lane {lane}")
                known: SelectedRoads = known_roads(release, np.radians(latitude), np.radians(longitude), link)
                off_m.append(np.abs(known.elevation_m - at[:, 2]))
                sigmas.append(off_m[-1] / known.sigma_m)
    assert np.quantile(np.concatenate(off_m), 0.999) <= 0.005
    assert np.concatenate(sigmas).max() < 3.0
