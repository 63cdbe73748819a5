"""Lanelet2 maps: a round trip gives the same map; what is not as it must be is one line that names it."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import lanelet_map, read_lanelet2
from camber.formats.map_exchange.mgrs import geodetic_from_mgrs
from support.lanelet_maps import FRAME, ONCOMING, lanelet2_bytes, town

NODES = """
  <node id="1" lat="48.1" lon="11.6"><tag k="ele" v="500.0"/></node>
  <node id="2" lat="48.1" lon="11.601"><tag k="ele" v="501.0"/></node>
  <node id="3" lat="48.09997" lon="11.6"><tag k="ele" v="500.0"/></node>
  <node id="4" lat="48.09997" lon="11.601"><tag k="ele" v="501.0"/></node>"""
LINES = """
  <way id="5"><nd ref="1"/><nd ref="2"/></way>
  <way id="6"><nd ref="3"/><nd ref="4"/></way>"""
LANELET = """
  <relation id="7">
    <member type="way" ref="5" role="left"/><member type="way" ref="6" role="right"/>
    <tag k="type" v="lanelet"/><tag k="subtype" v="road"/>
  </relation>"""


def osm(nodes: str = NODES, lines: str = LINES, lanelets: str = LANELET) -> bytes:
    return f"<?xml version='1.0'?>\n<osm>{nodes}{lines}{lanelets}\n</osm>\n".encode()


def test_a_round_trip_changes_no_point_by_a_tenth_of_a_millimetre() -> None:
    made = town()
    restored = lanelet_map(lanelet2_bytes(made), "town.osm")
    assert [lanelet.lanelet_id for lanelet in restored.lanelets] == [
        lanelet.lanelet_id for lanelet in made.lanelets
    ]
    for ours, theirs in zip(made.lanelets, restored.lanelets, strict=True):
        assert (ours.left, ours.right) == (theirs.left, theirs.right)
        assert ours.tags == theirs.tags
    assert len(restored.row_of) > 300
    rows = [[m.row_of[identity] for identity in restored.row_of] for m in (made, restored)]
    plane_m = [
        FRAME.east_north_from_geodetic_array(m.latitude_rad, m.longitude_rad, 0.0) for m in (made, restored)
    ]
    assert np.abs(plane_m[1][rows[1]] - plane_m[0][rows[0]]).max() < 1e-4
    assert np.abs(restored.height_m[rows[1]] - made.height_m[rows[0]]).max() < 1e-4


def test_borders_are_turned_so_that_the_left_one_is_on_the_left() -> None:
    forward = lanelet_map(osm(), "a.osm").lanelets[0]
    assert (forward.left, forward.right) == ((1, 2), (3, 4))
    turned = osm(lines=LINES.replace('<nd ref="3"/><nd ref="4"/>', '<nd ref="4"/><nd ref="3"/>'))
    assert lanelet_map(turned, "a.osm").lanelets[0].right == (3, 4)
    swapped = osm(lanelets=LANELET.replace("left", "l").replace("right", "left").replace('"l"', '"right"'))
    back = lanelet_map(swapped, "a.osm").lanelets[0]
    assert (back.left, back.right) == ((4, 3), (2, 1))


def test_an_oncoming_lane_has_the_shared_border_reversed() -> None:
    lanelets = {
        lanelet.lanelet_id: lanelet for lanelet in lanelet_map(lanelet2_bytes(town()), "town.osm").lanelets
    }
    street, oncoming = lanelets[101], lanelets[ONCOMING]
    assert oncoming.left == street.left[::-1]


def test_a_lanelet_of_another_subtype_is_left_out_and_counted() -> None:
    walk = LANELET.replace('id="7"', 'id="8"').replace("road", "crosswalk")
    restored = lanelet_map(osm(lanelets=LANELET + walk), "a.osm")
    assert [lanelet.lanelet_id for lanelet in restored.lanelets] == [7]
    assert restored.left_out == {"crosswalk": 1}


def test_points_without_latitude_are_placed_by_their_mgrs_square() -> None:
    local = '<tag k="mgrs_code" v="32UPU935300"/><tag k="local_x" v="93570.0"/><tag k="local_y" v="30000.0"/>'
    node = '<node id="2" lat="48.1" lon="11.601">'
    with_square = lanelet_map(osm(nodes=NODES.replace(node, f'<node id="2" lat="" lon="">{local}')), "a.osm")
    row = with_square.row_of[2]
    assert math.degrees(with_square.latitude_rad[row]) == pytest.approx(48.1, abs=0.05)
    assert math.degrees(with_square.longitude_rad[row]) == pytest.approx(11.601, abs=0.05)


def test_mgrs_squares_agree_with_a_published_map() -> None:
    data = os.environ.get("CAMBER_DATA")
    if data is None or not (Path(data) / "lanelet2").exists():
        pytest.skip("CAMBER_DATA does not name a folder with lanelet2")
    restored = read_lanelet2(Path(data) / "lanelet2" / "monza.osm")
    # Node 186 of the map has both: 45.62358179353931 N 9.28174112541207 E and 32TNR, 21963.326 m, 52264.8289 m.
    place = geodetic_from_mgrs("32TNR219522", 21963.326, 52264.8289, file="monza.osm", field="mgrs_code")
    np.testing.assert_allclose(np.degrees(place), (45.62358179353931, 9.28174112541207), atol=1e-9)
    assert len(restored.lanelets) == 30


@pytest.mark.parametrize(
    ("code", "latitude_deg", "longitude_deg"),
    [("54SUE00", 35.2, 138.8), ("56HLH00", -34.3, 150.8), ("31NAA00", 0.0, -0.6), ("18TWL00", 40.6, -75.0)],
)
def test_mgrs_squares_all_over_the_world(code: str, latitude_deg: float, longitude_deg: float) -> None:
    latitude, longitude = np.degrees(geodetic_from_mgrs(code, 0.0, 0.0, file="a.osm", field="mgrs_code"))
    assert (latitude, longitude) == pytest.approx((latitude_deg, longitude_deg), abs=0.2)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (osm(nodes=NODES.replace('<tag k="ele" v="501.0"/>', "", 1)), "a.osm: node 2, ele, expected a number from"),
        (osm(nodes=NODES.replace("501.0", "nan", 1)), "a.osm: node 2, ele is 'nan'"),
        (osm(nodes=NODES.replace("501.0", "1e300", 1)), "a.osm: node 2, ele is '1e300'"),
        (osm(nodes=NODES.replace("48.1", "91", 1)), "a.osm: node 1, lat is '91'"),
        (osm(nodes=NODES.replace('lat="48.1" lon="11.6"', "", 1)), "a.osm: node 1, lat, expected"),
        (osm(lines=LINES.replace('ref="2"', 'ref="99"')), "a.osm: way 5, nd is '99', expected a node of this file"),
        (osm(lines=LINES.replace('<nd ref="2"/>', "")), "a.osm: way 5, nd is '1', expected two nodes or more"),
        (osm(lines=LINES.replace('ref="2"', 'ref="1"')), "a.osm: way 5, expected a border longer than a millimetre"),
        (osm(lanelets=LANELET.replace('"left"', '"middle"')), "a.osm: lanelet 7, left is '0', expected one way"),
        (osm(lanelets=LANELET.replace('ref="5"', 'ref="77"')), "a.osm: lanelet 7, left is '77', expected a way"),
        (osm(lanelets=LANELET * 2), "a.osm: lanelet 7, expected each id once"),
        (osm(lanelets=""), "a.osm: lanelets, expected at least one"),
        (osm(nodes=NODES.replace('id="1"', 'id="1e3"')), "a.osm: node id is '1e3', expected an integer"),
        (osm()[:-20], "a.osm: XML, expected a whole document"),
        (b"", "a.osm: XML, expected a whole document"),
        (b"<gpx></gpx>", "a.osm: XML is '<gpx>', expected a document <osm>"),
        (b"<!DOCTYPE osm [<!ENTITY a 'b'>]><osm/>", "a.osm: XML, expected a document without a DOCTYPE"),
        (
            osm(nodes=NODES.replace('lat="48.1" lon="11.6">', 'lat="" lon=""><tag k="mgrs_code" v="99XXX1"/>'
                '<tag k="local_x" v="1"/><tag k="local_y" v="1"/>', 1)),
            "a.osm: node 1, mgrs_code is '99XXX1'",
        ),
    ],
)  # fmt: skip
def test_an_invalid_map_is_one_clear_error(data: bytes, message: str) -> None:
    with pytest.raises(FormatError) as refused:
        lanelet_map(data, "a.osm")
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)


def test_a_file_is_read_as_its_bytes_are(tmp_path: Path) -> None:
    (tmp_path / "a.osm").write_bytes(osm())
    assert read_lanelet2(tmp_path / "a.osm").lanelets[0].left == (1, 2)
