"""OpenDRIVE: a round trip gives the same map, geometries are those of the books, and bad input is one line."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import fresnel

from camber.formats.errors import FormatError
from camber.formats.map_exchange.opendrive import LaneSection, OpenDriveLane, PlanViewGeometry, opendrive_map
from camber.formats.map_exchange.opendrive_geometry import lane_points, reference_line, stations
from support.opendrive_maps import (
    NO_ROWS,
    RADIUS_M,
    cubics,
    lane,
    opendrive_bytes,
    road,
    street_geometries,
    town,
)

Floats = NDArray[np.float64]


def plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return [plain(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def geometry(shape: str, length_m: float, numbers: tuple[float, ...] = (), **more: Any) -> PlanViewGeometry:
    start = {"s_m": 0.0, "x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, **more}
    return PlanViewGeometry(shape=shape, length_m=length_m, numbers=numbers, **start)


def test_a_round_trip_is_exact() -> None:
    made = town()
    assert plain(opendrive_map(opendrive_bytes(made), "town.xodr")) == plain(made)


def test_a_round_trip_of_the_remaining_elements_is_exact() -> None:
    rng = np.random.default_rng(3)
    start = {"x_m": 1.0, "y_m": 2.0, "heading_rad": 0.3}
    poly = geometry("poly3", 10.0, (0.0, 0.1, 0.01, -0.001), **start)
    arc_length = geometry("paramPoly3", 10.0, tuple(rng.normal(size=8)), s_m=10.0, **start)
    with_border = dataclasses.replace(
        lane(-1),
        widths=NO_ROWS,
        borders=cubics((0.0, -3.5, 0.0, 0.0, 0.0)),
        heights=np.array([(0.0, 0.1, 0.2), (4.0, 0.0, 0.0)]),
        level=True,
    )
    made = dataclasses.replace(
        town(),
        offset_m=(10.0, -20.0, 0.5),
        roads=[
            road(
                "a&b",
                [poly, arc_length],
                [LaneSection(0.0, [with_border])],
                crossfall_left=rng.normal(size=(1, 5)),
                crossfall_right=rng.normal(size=(1, 5)),
                shape=np.array(sorted(rng.normal(size=(4, 6)).tolist())),
                lane_offset=rng.normal(size=(1, 5)),
                left_hand_traffic=True,
            )
        ],
    )
    assert plain(opendrive_map(opendrive_bytes(made), "made.xodr")) == plain(made)


def test_a_direct_junction_leads_to_the_linked_road() -> None:
    made = opendrive_bytes(town())
    direct = made.replace(b"connectingRoad", b"linkedRoad")
    assert direct != made
    assert plain(opendrive_map(direct, "town.xodr")) == plain(town())


def test_a_spiral_is_the_clothoid_of_fresnel() -> None:
    spiral = street_geometries()[1]
    s = np.linspace(0.0, spiral.length_m, 50)
    line = reference_line(road("1", [dataclasses.replace(spiral, s_m=0.0)], []), s)
    scale = math.sqrt(math.pi * RADIUS_M * spiral.length_m)
    v, u = fresnel(s / scale)
    cos, sin = math.cos(spiral.heading_rad), math.sin(spiral.heading_rad)
    expected = np.column_stack(
        (spiral.x_m + scale * (cos * u - sin * v), spiral.y_m + scale * (sin * u + cos * v))
    )
    np.testing.assert_allclose(line[:, :2], expected, atol=1e-8)
    np.testing.assert_allclose(
        line[:, 2], spiral.heading_rad + s**2 / (2.0 * RADIUS_M * spiral.length_m), atol=1e-12
    )


def test_an_arc_is_a_circle() -> None:
    arc = geometry("arc", 150.0, (-0.02,), x_m=100.0, y_m=50.0, heading_rad=0.7)
    s = np.linspace(0.0, 150.0, 40)
    line = reference_line(road("1", [arc], []), s)
    centre = np.array([100.0 + 50.0 * math.sin(0.7), 50.0 - 50.0 * math.cos(0.7)])
    np.testing.assert_allclose(np.hypot(*(line[:, :2] - centre).T), 50.0, atol=1e-10)
    np.testing.assert_allclose(line[:, 2], 0.7 - 0.02 * s, atol=1e-12)


def test_a_cubic_is_parametrised_by_arc_length() -> None:
    poly = geometry("poly3", 30.0, (0.0, 0.0, 0.02, 0.0))
    s = np.linspace(0.0, 30.0, 200)
    line = reference_line(road("1", [poly], []), s)
    np.testing.assert_allclose(line[:, 1], 0.02 * line[:, 0] ** 2, atol=1e-9)
    # The length of a parabola v = k u² from 0 to u.
    q = 2.0 * 0.02 * line[:, 0]
    np.testing.assert_allclose((q * np.sqrt(1.0 + q**2) + np.arcsinh(q)) / (4.0 * 0.02), s, atol=1e-5)


def curve_by_dense_sums(numbers: tuple[float, ...], last: float) -> tuple[Floats, Floats]:
    """Arc lengths and places (n,), (n, 2) of a parametric cubic, from a million chords."""
    p = np.linspace(0.0, last, 1_000_001)
    places = np.column_stack([np.polynomial.polynomial.polyval(p, numbers[k : k + 4]) for k in (0, 4)])
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T))), places


@pytest.mark.parametrize("normalised", [True, False])
@pytest.mark.parametrize(
    "unit_numbers",
    [
        (0.0, 15.0, 120.0, -75.0, 0.0, 0.0, 30.0, -10.0),  # slow at both ends
        (0.0, 90.0, -60.0, 30.0, 0.0, 0.0, -20.0, 35.0),  # slow in the middle
    ],
)
def test_a_parametric_cubic_is_placed_by_arc_length_with_both_ranges_of_its_parameter(
    unit_numbers: tuple[float, ...], normalised: bool
) -> None:
    length_m = float(curve_by_dense_sums(unit_numbers, 1.0)[0][-1])
    last = 1.0 if normalised else length_m
    numbers = tuple(
        float(number / last**power) for number, power in zip(unit_numbers, (0, 1, 2, 3) * 2, strict=True)
    )
    part = geometry("paramPoly3", length_m, numbers, normalised=normalised)
    s = np.linspace(0.0, length_m, 333)
    line = reference_line(road("1", [part], []), s)
    along, places = curve_by_dense_sums(numbers, last)
    expected = np.column_stack([np.interp(s, along, places[:, axis]) for axis in (0, 1)])
    assert np.abs(line[:, :2] - expected).max() < 1e-4
    # What this guards against: the parameter taken for the share of the length.
    by_share = np.column_stack(
        [np.polynomial.polynomial.polyval(s * last / length_m, numbers[k : k + 4]) for k in (0, 4)]
    )
    assert np.abs(by_share - expected).max() > 1.0
    direction = np.gradient(expected, axis=0)
    np.testing.assert_allclose(line[2:-2, 2], np.arctan2(direction[:, 1], direction[:, 0])[2:-2], atol=2e-3)


def test_a_parametric_cubic_whose_length_is_rounded_ends_where_its_parameter_does() -> None:
    numbers = (0.0, 20.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0)
    line = reference_line(
        road("1", [geometry("paramPoly3", 20.0, numbers, normalised=True)], []), np.array([20.0])
    )
    np.testing.assert_allclose(line[0], (20.0, 3.0, math.atan2(6.0, 20.0)), atol=1e-12)


def borders(segment: Any, lane_id: int, s: float) -> Floats:
    """Right and left border point of a lane at the station that is nearest to s."""
    at = stations(segment, 0, "a.xodr")
    return lane_points(segment, 0, at, "a.xodr")[lane_id][np.argmin(np.abs(at - s))]


STRAIGHT = [geometry("line", 100.0)]
BOTH = [LaneSection(0.0, [lane(1), lane(-1)])]


def test_superelevation_lifts_the_left_side() -> None:
    segment = road("1", STRAIGHT, BOTH, superelevation=cubics((0.0, 0.05, 0.0, 0.0, 0.0)))
    expected = [(50.0, 0.0, 0.0), (50.0, 3.5 * math.cos(0.05), 3.5 * math.sin(0.05))]
    np.testing.assert_allclose(borders(segment, 1, 50.0), expected, atol=1e-12)
    assert borders(segment, -1, 50.0)[0, 2] == pytest.approx(-3.5 * math.sin(0.05))


def test_crossfall_lets_both_sides_fall() -> None:
    both = cubics((0.0, 0.03, 0.0, 0.0, 0.0))
    segment = road("1", STRAIGHT, BOTH, crossfall_left=both, crossfall_right=both)
    assert borders(segment, 1, 50.0)[-1, 2] == pytest.approx(-3.5 * math.tan(0.03))
    assert borders(segment, -1, 50.0)[0, 2] == pytest.approx(-3.5 * math.tan(0.03))


def test_a_lateral_shape_is_straight_between_its_stations() -> None:
    starts = [(0.0, -10.0), (100.0, -10.0), (100.0, 0.0)]
    rows = [(s, t, 0.0, 0.0, 0.01 * (t == 0.0), 0.0) for s, t in starts]
    segment = road("1", STRAIGHT, BOTH, shape=np.array(rows))
    line = borders(segment, 1, 50.0)
    np.testing.assert_allclose(line[:, 2], 0.5 * 0.01 * line[:, 1] ** 2, atol=1e-12)


def test_the_lane_offset_moves_all_lanes_and_borders_stand_for_widths() -> None:
    by_border = dataclasses.replace(lane(-1), widths=NO_ROWS, borders=cubics((0.0, -3.0, 0.0, 0.0, 0.0)))
    segment = road(
        "1", STRAIGHT, [LaneSection(0.0, [lane(1), by_border])], lane_offset=cubics((0.0, 1.0, 0.0, 0.0, 0.0))
    )
    np.testing.assert_allclose(borders(segment, 1, 50.0)[:, 1], (1.0, 4.5))
    np.testing.assert_allclose(borders(segment, -1, 50.0)[:, 1], (-2.0, 1.0))


def with_heights(lane_id: int, *rows: tuple[float, float, float]) -> OpenDriveLane:
    return dataclasses.replace(lane(lane_id), kind="shoulder", heights=np.array(rows))


@pytest.mark.parametrize(("lane_id", "right_m", "left_m"), [(-1, 0.2, 0.1), (1, 0.1, 0.2)])
def test_a_lane_height_is_added_from_the_inner_to_the_outer_border(
    lane_id: int, right_m: float, left_m: float
) -> None:
    lanes = [LaneSection(0.0, [with_heights(lane_id, (0.0, 0.1, 0.2))])]
    for more in ({}, {"crossfall_left": cubics((0.0, 0.0, 0.0, 0.0, 0.0))}):
        line = borders(
            road("1", STRAIGHT, lanes, elevation=cubics((0.0, 7.0, 0.0, 0.0, 0.0)), **more), lane_id, 50.0
        )
        np.testing.assert_allclose(
            line[:, 2], np.linspace(7.0 + right_m, 7.0 + left_m, len(line)), atol=1e-12
        )


def test_a_lane_height_is_valid_from_its_offset_until_the_next_one() -> None:
    rows = ((10.0, 0.152, 0.152), (40.0, 0.05, 0.05))
    segment = road("1", STRAIGHT, [LaneSection(20.0, [with_heights(-1, *rows)])])
    at = stations(segment, 0, "a.xodr")
    z = lane_points(segment, 0, at, "a.xodr")[-1][:, 0, 2]
    np.testing.assert_allclose(z, np.where(at < 30.0 - 1e-9, 0.0, np.where(at < 60.0 - 1e-9, 0.152, 0.05)))
    assert (np.diff(at)[np.abs(np.diff(z)) > 0.01] < 0.0011).all(), "the steps are short"


def test_an_unreadable_lane_costs_itself_and_those_outside_of_it() -> None:
    made = dataclasses.replace(
        town(), roads=[road("7", STRAIGHT, [LaneSection(0.0, [lane(k) for k in (1, -1, -2, -3)])])]
    )
    data = opendrive_bytes(dataclasses.replace(made, connections=[]))
    at = data.index(b'lane id="-2"')
    data = data[:at] + data[at:].replace(b'a="3.5"', b'a="?"', 1)
    with pytest.raises(FormatError, match="road 7, laneSection at s 0, lane -2, width, a is"):
        opendrive_map(data, "a.xodr")
    segment = opendrive_map(data, "a.xodr", strict=False).roads[0]
    errors: dict[int, FormatError] = {}
    points = lane_points(segment, 0, stations(segment, 0, "a.xodr"), "a.xodr", errors=errors)
    assert sorted(points) == [-1, 1]
    assert sorted(errors) == [-3, -2]
    assert {str(error) for error in errors.values()} == {
        "a.xodr: road 7, laneSection at s 0, lane -2, width, a is '?', expected a number of at most 1e9"
    }


def test_an_unreadable_road_costs_itself_and_says_how_many_lanes_it_had() -> None:
    data = opendrive_bytes(town()).replace(b"<paramPoly3", b"<bezier").replace(b"</paramPoly3", b"</bezier")
    drive = opendrive_map(data, "a.xodr", strict=False)
    assert [each.identity for each in drive.roads] == ["1", "2", "4"]
    assert [(each.identity, list(each.lane_kinds)) for each in drive.unreadable] == [("3", ["driving"] * 2)]
    assert "expected one of line" in str(drive.unreadable[0].error)


SMALL = opendrive_bytes(dataclasses.replace(town(), roads=[road("7", STRAIGHT, BOTH)], connections=[]))


def damaged(old: str, new: str) -> bytes:
    assert old.encode() in SMALL
    return SMALL.replace(old.encode(), new.encode(), 1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (damaged('length="100.0" junction', 'length="1e9" junction'), "a.xodr: road 7, length is '1e9', expected more"),
        (damaged('length="100.0" junction', 'length="x" junction'), "a.xodr: road 7, length is 'x', expected a number"),
        (damaged('hdg="0.0"', 'hdg="nan"'), "a.xodr: road 7, geometry at s 0.0, hdg is 'nan'"),
        (damaged("<line />", "<bezier/>"), "a.xodr: road 7, geometry at s 0.0 is 'bezier', expected one of line"),
        (damaged("<line />", '<arc curvature="99"/>'), "a.xodr: road 7, geometry at s 0.0, arc is '99.0'"),
        (damaged('<laneSection s="0.0">', '<laneSection>'), "a.xodr: road 7, laneSection, s, expected a number"),
        (damaged('lane id="-1"', 'lane id="-3"'), "a.xodr: road 7, laneSection at s 0, lane id is '[-3, 1]'"),
        (damaged('lane id="-1"', 'lane id="1.5"'), "a.xodr: road 7, laneSection at s 0, lane, id is '1.5'"),
        (damaged("<planView>", "<plan>").replace(b"</planView>", b"</plan>"), "a.xodr: road 7, planView, expected"),
        (damaged("<lanes>", "<l>").replace(b"</lanes>", b"</l>"), "a.xodr: road 7, lanes, expected laneSections"),
        (SMALL[:-30], "a.xodr: XML, expected a whole document"),
        (b"<osm/>", "a.xodr: XML is '<osm>', expected a document <OpenDRIVE>"),
        (b"<OpenDRIVE/>", "a.xodr: road, expected at least one"),
        (b"<!DOCTYPE x []><OpenDRIVE/>", "a.xodr: XML, expected a document without a DOCTYPE"),
    ],
)  # fmt: skip
def test_an_invalid_map_is_one_clear_error(data: bytes, message: str) -> None:
    with pytest.raises(FormatError) as refused:
        opendrive_map(data, "a.xodr")
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        (
            road("7", [*STRAIGHT, dataclasses.replace(STRAIGHT[0], s_m=100.0, x_m=101.0, y_m=9.0)], BOTH),
            "road 7, planView, expected no",
        ),
        (
            road("7", [geometry("paramPoly3", 100.0, (0.0, 110.0, *[0.0] * 6), normalised=True)], BOTH),
            "road 7, geometry at s 0, length is '100', expected its curve's, 110.00",
        ),
        (road("7", STRAIGHT, [LaneSection(200.0, [lane(1)])]), "road 7, laneSection at s 200, s, expected less than"),
        (road("7", STRAIGHT, [LaneSection(0.0, [lane(1, -2.0)])]), "road 7, laneSection at s 0, lane 1, width is '-2'"),
        (
            road("7", STRAIGHT, [LaneSection(0.0, [dataclasses.replace(lane(1), widths=NO_ROWS)])]),
            "road 7, laneSection at s 0, lane 1, expected a width or a border",
        ),
    ],
)  # fmt: skip
def test_an_impossible_road_is_one_clear_error(segment: Any, message: str) -> None:
    with pytest.raises(FormatError) as refused:
        lane_points(segment, 0, stations(segment, 0, "a.xodr"), "a.xodr")
    assert str(refused.value).startswith(f"a.xodr: {message}")
