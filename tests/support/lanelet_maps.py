"""A Lanelet2 map made up: a street of two lanes, a bridge over it, and a ramp in a curve from the one to the other."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_exchange.lanelet2 import Lanelet, LaneletMap
from camber.geodesy.local_frame import LocalFrame

Floats = NDArray[np.float64]

FRAME = LocalFrame(math.radians(48.1), math.radians(11.6), 0.0)
STREET_WEST, STREET_EAST, ONCOMING, BRIDGE, RAMP = 101, 102, 103, 201, 301
WIDTH_M = 3.5


def street_height_m(east_m: Floats, across_m: Floats | float) -> Floats:
    """Of the street along east: a dip of 1.5 m under the bridge, a crossfall of 2.5 %."""
    height: Floats = 500.0 - 1.5 * np.exp(-((east_m / 60.0) ** 2)) + 0.025 * across_m
    return height


def bridge_height_m(north_m: Floats, across_m: Floats | float) -> Floats:
    """Of the bridge along north over east 0: an arch, level across."""
    height: Floats = 506.5 - north_m**2 / 1500.0 + 0.0 * across_m
    return height


class _Maker:
    def __init__(self) -> None:
        self.rows: dict[int, int] = {}
        self.points: list[tuple[float, float, float]] = []
        self.lanelets: list[Lanelet] = []

    def border(
        self, first_id: int, east_m: Floats | float, north_m: Floats | float, height_m: Floats
    ) -> tuple[int, ...]:
        places = list(zip(*np.broadcast_arrays(east_m, north_m, height_m), strict=True))
        ids = range(first_id, first_id + len(places))
        self.rows |= dict(zip(ids, range(len(self.points), len(self.points) + len(places)), strict=True))
        self.points += places
        return tuple(ids)

    def lanelet(
        self, identity: int, left: tuple[int, ...], right: tuple[int, ...], border_ids: tuple[int, int]
    ) -> None:
        self.lanelets.append(
            Lanelet(
                lanelet_id=identity,
                left=left,
                right=right,
                left_border_id=border_ids[0],
                right_border_id=border_ids[1],
                tags={"type": "lanelet", "subtype": "road"},
            )
        )

    def map(self) -> LaneletMap:
        plane = np.array(self.points)
        latitude, longitude, _ = FRAME.geodetic_from_east_north_array(plane[:, :2], np.zeros(len(plane)))
        return LaneletMap(
            row_of=self.rows,
            latitude_rad=latitude,
            longitude_rad=longitude,
            height_m=plane[:, 2],
            lanelets=self.lanelets,
            left_out={},
        )


def town() -> LaneletMap:
    """The map; borders have a point every 2 m: heights between them are as the functions say to half a millimetre."""
    make = _Maker()
    east = np.arange(-120.0, 121.0, 2.0)
    borders = [
        make.border(1000 + 200 * k, east, across, street_height_m(east, across))
        for k, across in enumerate((-WIDTH_M, 0.0, WIDTH_M))
    ]
    right, middle, left = ((ids[:61], ids[60:]) for ids in borders)  # the lanelets meet at a point
    make.lanelet(STREET_WEST, middle[0], right[0], (11, 12))
    make.lanelet(STREET_EAST, middle[1], right[1], (21, 22))
    make.lanelet(ONCOMING, middle[0][::-1], left[0][::-1], (11, 13))
    north = np.arange(-60.0, 61.0, 2.0)
    sides = [
        make.border(first_id, side, north, bridge_height_m(north, side))
        for side, first_id in ((-2.0, 3000), (2.0, 3200))
    ]
    make.lanelet(BRIDGE, sides[0], sides[1], (31, 32))
    # From the bridge's northern end down to the right: a quarter of a circle of 30 m, then nothing.
    turn = np.linspace(0.0, 0.5 * math.pi, 40)[1:]
    ends = [
        side[-1:]
        + make.border(
            first_id, 30.0 - radius * np.cos(turn), 60.0 + radius * np.sin(turn), ramp_height_m(turn)
        )
        for side, radius, first_id in zip(sides, (32.0, 28.0), (4000, 4200), strict=True)
    ]
    make.lanelet(RAMP, ends[0], ends[1], (41, 42))
    return make.map()


def ramp_height_m(turn_rad: Floats) -> Floats:
    """Of the ramp, by how far it has turned: it goes on as the bridge ends."""
    height: Floats = bridge_height_m(np.array(60.0), 0.0) - 2.4 * turn_rad
    return height


def lanelet2_bytes(lanelets: LaneletMap) -> bytes:
    """A map as OSM XML that is read as the same: positions to 1e-11 degrees, heights to 1e-5 m."""
    root = Element("osm", version="0.6", generator="Camber")
    latitude, longitude = np.degrees(lanelets.latitude_rad), np.degrees(lanelets.longitude_rad)
    for identity, row in lanelets.row_of.items():
        place = {"lat": f"{latitude[row]:.11f}", "lon": f"{longitude[row]:.11f}"}
        node = SubElement(root, "node", id=str(identity), **place)
        SubElement(node, "tag", k="ele", v=f"{lanelets.height_m[row]:.5f}")
    borders: dict[int, tuple[int, ...]] = {}
    for lanelet in lanelets.lanelets:
        borders.setdefault(lanelet.left_border_id, lanelet.left)
        borders.setdefault(lanelet.right_border_id, lanelet.right)
    for identity, refs in borders.items():
        border = SubElement(root, "way", id=str(identity))
        for ref in refs:
            SubElement(border, "nd", ref=str(ref))
        SubElement(border, "tag", k="type", v="line_thin")
    for lanelet in lanelets.lanelets:
        relation = SubElement(root, "relation", id=str(lanelet.lanelet_id))
        for role, border_id in (("left", lanelet.left_border_id), ("right", lanelet.right_border_id)):
            SubElement(relation, "member", type="way", ref=str(border_id), role=role)
        for key, value in {"subtype": "road", **lanelet.tags, "type": "lanelet"}.items():
            SubElement(relation, "tag", k=key, v=value)
    indent(root)
    return tostring(root, "UTF-8")
