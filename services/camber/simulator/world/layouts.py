"""Where the roads of each kind of district lie, and the routes through them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

from camber.simulator.world.road_building import LinkKind, RoadBuilder
from camber.simulator.world.roads import Roads
from camber.simulator.world.routes import Leg
from camber.simulator.world.terrain import rolling_terrain

_QUARTER = 0.5 * math.pi
_GROUND_M = 45.0
"""Ellipsoidal height of the plain: some 7 m above the sea at Nagoya, whose geoid lies 38 m above the ellipsoid."""
_DECK_M = 5.4  # chosen: 4.5 m of clearance and the deck
_TUBE_M = -7.5  # chosen: a tunnel's ceiling and a street above it
_HILL = (5.5, 820.0, 330.0, 75.0, 57.0)
_ROOFED_M = 5.7
"""A road is in a tunnel where it lies deeper than this below the ground."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """Links to follow, from `start_m` on the first to `end_m` before the end of the last; `signals`: may stop."""

    legs: tuple[Leg, ...]
    start_m: float = 10.0
    end_m: float = 10.0
    signals: bool = True


@dataclass(frozen=True, slots=True)
class Layout:
    """Roads and the routes through them, one of which is "default"."""

    roads: Roads
    routes: Mapping[str, Route]


def _route(b: RoadBuilder, links: str, *, start_m: float = 10.0, signals: bool = True) -> Route:
    """From names of links; −name: against its direction."""
    legs = tuple(Leg(b.row_of_link[link.lstrip("-")], not link.startswith("-")) for link in links.split())
    return Route(legs=legs, start_m=start_m, signals=signals)


def city_layout(seed: int) -> Layout:
    """A grid of streets with a canyon and an avenue, an overpass with a ramp, an open stretch, a tunnel; 1.1 × 0.5 km.

    The arterial "A-C", "C-D" goes over the street "R-E" at level 1, the tunnel "T-U" under the street "W-J1" at level
    −1. The open stretch in the east crosses a hill of 5.5 m. The route "round" ends where it begins; "rounds" goes
    three times about the east, 5.2 km under an open sky, without canyon and tunnel.
    """
    b = RoadBuilder()
    for column, east in zip("JKL", (0.0, 200.0, 400.0), strict=True):
        for row, north in zip("012", (0.0, 180.0, 480.0), strict=True):
            b.node(column + row, east, north)
    street, canyon = LinkKind(crossfall=0.02), LinkKind(style="canyon", speed_m_s=9.0, crossfall=-0.015)
    avenue = LinkKind(style="avenue", speed_m_s=13.0, crossfall=0.02)
    for columns in ("JK", "KL"):
        for row in "012":
            b.straight(columns[0] + row, columns[1] + row, avenue if columns + row == "KL2" else street)
    for column in "JKL":
        b.straight(column + "0", column + "1", street)
        b.straight(column + "1", column + "2", canyon if column == "K" else street)
    _overpass_roads(b)
    b.straight("L2", "D", avenue)
    b.straight("L0", "A", street)
    _under_street(b)
    b.node("W", -200.0, 180.0)
    b.straight("W", "J1", street)
    terrain = rolling_terrain(seed, base_m=_GROUND_M, slope=0.015, hills=[_HILL])
    main = "K1-K2 K2-L2 L2-D -C-D -A-C -L0-A -K0-L0 -J0-K0"
    outside = "L1-R R-E E-F F-D -C-D -A-C"
    routes = {
        "default": _route(b, f"J1-K1 {main}", start_m=90.0),
        "overpass": _route(b, "L2-D -C-D -A-C", start_m=20.0),
        "tunnel": _route(b, "-K0-L0 -J0-K0 J0-T T-U U-J2 J2-K2", start_m=100.0),
        "ramp": _route(b, "K1-L1 L1-R R-C C-D -L2-D", start_m=100.0),
        "open": _route(b, outside, start_m=5.0),
        "round": _route(b, f"J1-K1 {main} J0-T T-U U-J2 -J1-J2", start_m=90.0),
        "rounds": _route(b, " ".join(3 * [f"L0-L1 {outside} -L0-A"])),
        "all": _route(b, f"W-J1 J1-K1 {main} J0-T T-U U-J2 J2-K2 K2-L2 -L1-L2 {outside}"),
    }
    return Layout(b.roads(terrain), routes)


def overpass_layout(seed: int) -> Layout:
    """A street, an arterial that goes over it, the ramp between them, and the road round from one to the other."""
    b = RoadBuilder()
    b.node("L1", 300.0, 180.0)
    _overpass_roads(b)
    b.node("Z", 590.0, -120.0)
    b.straight("Z", "A", LinkKind(crossfall=0.02))
    routes = {
        "default": _route(b, "L1-R R-E E-F F-D -C-D -A-C -Z-A", start_m=20.0),
        "ramp": _route(b, "L1-R R-C C-D", start_m=20.0),
    }
    return Layout(b.roads(rolling_terrain(seed, base_m=_GROUND_M, slope=0.015, hills=[_HILL])), routes)


def _overpass_roads(b: RoadBuilder) -> None:
    """From the node L1 in the west; A and D are the ends of the arterial."""
    b.node("A", 590.0, 0.0)
    b.node("R", 440.0, 180.0, radius_m=0.0)
    b.node("C", 590.0, 310.0, radius_m=0.0, lift_m=_DECK_M, level=1)
    b.node("D", 590.0, 480.0)
    b.node("E", 760.0, 180.0, radius_m=0.0)
    b.node("F", 820.0, 330.0, radius_m=0.0)
    street = LinkKind(speed_m_s=13.0)
    b.straight("L1", "R", street)
    b.straight("R", "E", replace(street, crossfall=0.02, flat_m=(120.0, 2.0)))
    bow = (60.0 * _QUARTER, 1.0 / 60.0)
    stretch = LinkKind(style="open", speed_m_s=13.0, crossfall=-0.02)
    b.chain("E F", 0.0, [bow, (90.0, 0.0)], stretch)
    b.chain("F D", _QUARTER, [(90.0, 0.0), bow, (170.0, 0.0)], stretch)
    over = LinkKind(style="none", level=1, speed_m_s=13.0)
    up = replace(over, lift_m=(0.0, _DECK_M), rise_m=(15.0, 146.0), bridge_m=(150.0, 212.0))
    b.straight("A", "C", up)
    b.straight("C", "D", replace(over, lift_m=(_DECK_M, 0.0), rise_m=(15.0, 150.0)))
    ramp = replace(over, speed_m_s=10.0, half_width_m=4.0, lift_m=(0.0, _DECK_M), rise_m=(60.0, 176.0))
    b.chain("R C", 0.0, [(20.0, 0.0), (130.0 * _QUARTER, 1.0 / 130.0)], ramp)


def _under_street(b: RoadBuilder) -> None:
    """From J0 to the west, down, northwards under the street to J1, up and back to J2."""
    b.node("T", -80.0, 120.0, radius_m=0.0, lift_m=_TUBE_M, level=-1)
    b.node("U", -80.0, 360.0, radius_m=0.0, lift_m=_TUBE_M, level=-1)
    bow = (60.0 * _QUARTER, -1.0 / 60.0)
    down = [(20.0, 0.0), bow, (60.0, 0.0)]
    long = 80.0 + bow[0]
    tube = LinkKind(style="none", level=-1, half_width_m=4.5)
    rise = (18.0, long - 4.0)
    roofed = _reached(rise, _ROOFED_M / -_TUBE_M)
    ramp = replace(tube, lift_m=(0.0, _TUBE_M), rise_m=rise, covered_m=(roofed, long))
    b.chain("J0 T", math.pi, down, ramp)
    deep = replace(tube, lift_m=(_TUBE_M, _TUBE_M), covered_m=(0.0, 240.0))
    b.straight("T", "U", deep)
    back = replace(tube, lift_m=(_TUBE_M, 0.0), rise_m=(4.0, long - 18.0), covered_m=(0.0, long - roofed))
    b.chain("U J2", _QUARTER, down[::-1], back)


def tunnel_layout(seed: int) -> Layout:
    """A street, a ramp down into a tunnel with a loop of 1.7 km, and another ramp out.

    The default route goes round it six times and then some: more than 1,000 s below the ground.
    """
    b = RoadBuilder()
    depth, away, third = -9.0, 120.0, math.pi / 3.0
    east = 200.0 + 2.0 * away * math.sin(third) + 150.0
    for name, sign in (("S", -1.0), ("X", 1.0)):
        b.node(f"{name}0", sign * (east + 250.0), away)
        b.node(f"{name}1", sign * east, away)
    for name, at in (("P", (-200.0, 0.0)), ("Q", (200.0, 0.0)), ("M", (0.0, -160.0))):
        b.node(name, *at, radius_m=0.0, lift_m=depth, level=-1)
    street = LinkKind(crossfall=0.02)
    b.straight("S0", "S1", street)
    b.straight("X1", "X0", street)
    tube = LinkKind(style="none", level=-1, speed_m_s=10.0, half_width_m=4.5, lift_m=(depth, depth))
    swing = (away * third, 1.0 / away)
    down = [(150.0, 0.0), (swing[0], -swing[1]), swing]
    long, rise = 150.0 + 2.0 * swing[0], (18.0, 250.0)
    roofed = _reached(rise, _ROOFED_M / -depth)
    ramp = replace(tube, lift_m=(0.0, depth), rise_m=rise, covered_m=(roofed, long))
    b.chain("S1 P", 0.0, down, ramp)
    up = (long - 250.0, long - 18.0)
    out = replace(tube, lift_m=(depth, 0.0), rise_m=up, covered_m=(0.0, long - roofed))
    b.chain("Q X1", 0.0, [swing, (swing[0], -swing[1]), (150.0, 0.0)], out)
    b.straight("P", "Q", replace(tube, covered_m=(0.0, 400.0)))
    half = [(100.0, 0.0), (80.0 * math.pi, -1.0 / 80.0), (300.0, 0.0)]
    loop = replace(tube, covered_m=(0.0, 400.0 + 80.0 * math.pi))
    b.chain("Q M", 0.0, half, loop)
    b.chain("M P", math.pi, half[::-1], loop)
    rounds = " ".join(["Q-M M-P P-Q"] * 6)
    routes = {
        "default": _route(b, f"S0-S1 S1-P P-Q {rounds} Q-X1 X1-X0", signals=False),
        "once": _route(b, "S0-S1 S1-P P-Q Q-M M-P P-Q Q-X1 X1-X0", signals=False),
    }
    return Layout(b.roads(rolling_terrain(seed, base_m=_GROUND_M, slope=0.01)), routes)


def canyon_layout(seed: int, heading_rad: float, length_m: float) -> Layout:
    """One straight street through the origin; heading clockwise from north."""
    b = RoadBuilder()
    half = 0.5 * length_m
    east, north = half * math.sin(heading_rad), half * math.cos(heading_rad)
    b.node("A", -east, -north)
    b.node("B", east, north)
    kind = LinkKind(style="canyon", speed_m_s=8.0, half_width_m=6.5, lane_offset_m=3.0, crossfall=0.015)
    b.straight("A", "B", kind)
    routes = {"default": _route(b, "A-B", signals=False), "back": _route(b, "-A-B", signals=False)}
    return Layout(b.roads(rolling_terrain(seed, base_m=_GROUND_M, slope=0.02)), routes)


def canyons_layout(seed: int) -> Layout:
    """Four by four crossings of canyon streets, 0.6 × 0.78 km; the default route takes every street twice, 16 km.

    Three blocks of 30 m fit between houses of two streets: lines of sight are as narrow as in one street alone.
    """
    b = RoadBuilder()
    kind = LinkKind(style="canyon", speed_m_s=8.0, half_width_m=6.5, lane_offset_m=3.0, crossfall=0.015)
    for column in range(4):
        for row in range(4):
            b.node(f"{column}{row}", 200.0 * column - 300.0, 260.0 * row - 390.0)
    for line in range(4):
        for at in range(3):
            b.straight(f"{at}{line}", f"{at + 1}{line}", kind)
            b.straight(f"{line}{at}", f"{line}{at + 1}", kind)
    rows = "00 10 20 30 31 21 11 01 02 12 22 32 33 23 13 03"
    columns = "02 01 00 10 11 12 13 23 22 21 20 30 31 32 33 23 13 03 02 01 00"
    stops = [*f"{rows} {columns}".split(), *f"{rows} {columns}".split()[1:]]
    legs = [f"{p}-{q}" if f"{p}-{q}" in b.row_of_link else f"-{q}-{p}" for p, q in pairwise(stops)]
    terrain = rolling_terrain(seed, base_m=_GROUND_M, slope=0.02)
    return Layout(b.roads(terrain), {"default": _route(b, " ".join(legs))})


def open_layout(seed: int) -> Layout:
    """A road of 2.3 km over rolling land in wide bends."""
    b = RoadBuilder()
    angle, radius = 0.6, 250.0
    bend = (angle * radius, 1.0 / radius)
    bends = [(200.0, 0.0), bend, (bend[0], -bend[1]), (200.0, 0.0), (bend[0], -bend[1]), bend, (140.0, 0.0)]
    long = 540.0 + 4.0 * radius * math.sin(angle)
    b.node("A", -long, 0.0)
    b.node("B", 0.0, 0.0, radius_m=0.0)
    b.node("C", long, 0.0)
    kind = LinkKind(style="open", speed_m_s=12.0, crossfall=0.02)
    b.chain("A B", 0.0, bends, kind)
    b.chain("B C", 0.0, bends, kind)
    routes = {"default": _route(b, "A-B B-C", signals=False), "back": _route(b, "-B-C -A-B", signals=False)}
    return Layout(b.roads(rolling_terrain(seed, base_m=_GROUND_M, slope=0.04)), routes)


def _reached(rise_m: tuple[float, float], share: float) -> float:
    """Where on a rise, s, this share of it is reached."""
    low, high = 0.0, 1.0
    for _ in range(60):
        x = 0.5 * (low + high)
        if x**3 * (10.0 + x * (6.0 * x - 15.0)) < share:
            low = x
        else:
            high = x
    return rise_m[0] + low * (rise_m[1] - rise_m[0])


LAYOUTS: Mapping[str, Callable[[int], Layout]] = {
    "open-sky": open_layout,
    "city": city_layout,
    "canyons": canyons_layout,
    "overpass": overpass_layout,
    "tunnel": tunnel_layout,
}
"""By kind of district, from the seed; a canyon also has a heading and a length."""
