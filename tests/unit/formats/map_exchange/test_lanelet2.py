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
WAYS = """
  <way id="5"><nd ref="1"/><nd ref="2"/></way>
  <way id="6"><nd ref="3"/><nd ref="4"/></way>"""
LANELET = """
  <relation id="7">
    <member type="way" ref="5" role="left"/><member type="way" ref="6" role="right"/>
    <tag k="type" v="lanelet"/><tag k="subtype" v="road"/>
  </relation>"""


def osm(nodes: str = NODES, ways: str = WAYS, lanelets: str = LANELET) -> bytes:
    return f"<?xml version='1.0'?>\n<osm>{nodes}{ways}{lanelets}\n</osm>\n".encode()


def test_a_map_comes_back_from_a_round_trip_within_a_tenth_of_a_millimetre() -> None:
    made = town()
    found = lanelet_map(lanelet2_bytes(made), "town.osm")
    assert [own.lanelet_id for own in found.lanelets] == [own.lanelet_id for own in made.lanelets]
    for ours, theirs in zip(made.lanelets, found.lanelets, strict=True):
        assert (ours.left, ours.right) == (theirs.left, theirs.right)
        assert ours.tags == theirs.tags
    assert len(found.row_of) > 300
    rows = [[m.row_of[identity] for identity in found.row_of] for m in (made, found)]
    plane_m = [
        FRAME.east_north_from_geodetic_array(m.latitude_rad, m.longitude_rad, 0.0) for m in (made, found)
    ]
    assert np.abs(plane_m[1][rows[1]] - plane_m[0][rows[0]]).max() < 1e-4
    assert np.abs(found.height_m[rows[1]] - made.height_m[rows[0]]).max() < 1e-4


def test_ways_are_turned_into_the_direction_in_which_the_left_border_is_on_the_left() -> None:
    forward = lanelet_map(osm(), "a.osm").lanelets[0]
    assert (forward.left, forward.right) == ((1, 2), (3, 4))
    turned = osm(ways=WAYS.replace('<nd ref="3"/><nd ref="4"/>', '<nd ref="4"/><nd ref="3"/>'))
    assert lanelet_map(turned, "a.osm").lanelets[0].right == (3, 4)
    swapped = osm(lanelets=LANELET.replace("left", "l").replace("right", "left").replace('"l"', '"right"'))
    back = lanelet_map(swapped, "a.osm").lanelets[0]
    assert (back.left, back.right) == ((4, 3), (2, 1))


def test_the_oncoming_lane_shares_its_left_border_and_goes_the_other_way() -> None:
    lanelets = {own.lanelet_id: own for own in lanelet_map(lanelet2_bytes(town()), "town.osm").lanelets}
    street, oncoming = lanelets[101], lanelets[ONCOMING]
    assert oncoming.left == street.left[::-1]


def test_a_lanelet_on_which_nobody_drives_is_left_out_and_counted() -> None:
    walk = LANELET.replace('id="7"', 'id="8"').replace("road", "crosswalk")
    found = lanelet_map(osm(lanelets=LANELET + walk), "a.osm")
    assert [own.lanelet_id for own in found.lanelets] == [7]
    assert found.left_out == {"crosswalk": 1}


def test_points_without_a_position_are_placed_by_their_square_of_the_grid() -> None:
    with_square = lanelet_map(
        osm(
            nodes=NODES.replace(
                '<node id="2" lat="48.1" lon="11.601">',
                '<node id="2" lat="" lon=""><tag k="mgrs_code" v="32UPU935300"/>'
                '<tag k="local_x" v="93570.0"/><tag k="local_y" v="30000.0"/>',
            )
        ),
        "a.osm",
    )
    row = with_square.row_of[2]
    assert math.degrees(with_square.latitude_rad[row]) == pytest.approx(48.1, abs=0.05)
    assert math.degrees(with_square.longitude_rad[row]) == pytest.approx(11.601, abs=0.05)


def test_squares_of_the_grid_are_where_a_recorded_map_says() -> None:
    data = os.environ.get("CAMBER_DATA")
    if data is None or not (Path(data) / "lanelet2").exists():
        pytest.skip("CAMBER_DATA does not name a folder with lanelet2")
    found = read_lanelet2(Path(data) / "lanelet2" / "monza.osm")
    # Node 186 of the map has both: 45.62358179353931 N 9.28174112541207 E and 32TNR, 21963.326 m, 52264.8289 m.
    place = geodetic_from_mgrs("32TNR219522", 21963.326, 52264.8289, file="monza.osm", field="mgrs_code")
    np.testing.assert_allclose(np.degrees(place), (45.62358179353931, 9.28174112541207), atol=1e-9)
    assert len(found.lanelets) == 30


@pytest.mark.parametrize(
    ("code", "latitude_deg", "longitude_deg"),
    [("54SUE00", 35.2, 138.8), ("56HLH00", -34.3, 150.8), ("31NAA00", 0.0, -0.6), ("18TWL00", 40.6, -75.0)],
)
def test_squares_of_the_grid_all_over_the_world(code: str, latitude_deg: float, longitude_deg: float) -> None:
    latitude, longitude = np.degrees(geodetic_from_mgrs(code, 0.0, 0.0, file="a.osm", field="mgrs_code"))
    assert (latitude, longitude) == (
        pytest.approx(latitude_deg, abs=0.2),
        pytest.approx(longitude_deg, abs=0.2),
    )


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (osm(nodes=NODES.replace('<tag k="ele" v="501.0"/>', "", 1)), "a.osm: node 2, ele, expected a number from"),
        (osm(nodes=NODES.replace("501.0", "nan", 1)), "a.osm: node 2, ele is 'nan'"),
        (osm(nodes=NODES.replace("501.0", "1e300", 1)), "a.osm: node 2, ele is '1e300'"),
        (osm(nodes=NODES.replace("48.1", "91", 1)), "a.osm: node 1, lat is '91'"),
        (osm(nodes=NODES.replace('lat="48.1" lon="11.6"', "", 1)), "a.osm: node 1, lat, expected"),
        (osm(ways=WAYS.replace('ref="2"', 'ref="99"')), "a.osm: way 5, nd is '99', expected a node of this file"),
        (osm(ways=WAYS.replace('<nd ref="2"/>', "")), "a.osm: way 5, nd is '1', expected two nodes or more"),
        (osm(ways=WAYS.replace('ref="2"', 'ref="1"')), "a.osm: way 5, expected a border longer than a millimetre"),
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
def test_a_map_that_is_not_as_it_must_be_is_one_line(data: bytes, said: str) -> None:
    with pytest.raises(FormatError) as refused:
        lanelet_map(data, "a.osm")
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)


def test_a_file_is_read_as_its_bytes_are(tmp_path: Path) -> None:
    (tmp_path / "a.osm").write_bytes(osm())
    assert read_lanelet2(tmp_path / "a.osm").lanelets[0].left == (1, 2)
