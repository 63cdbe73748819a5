"""Triangles of roads and of what belongs to them: verges, decks, retaining walls, tunnels, the ground around.

Sections across a link stand every 2.5 m, and closer where a new surface begins: between them the mesh lies some
millimetres off the closed form.
"""

from __future__ import annotations

import numpy as np

from camber.simulator.scene import Booleans, Floats, Integers, Material
from camber.simulator.world.roads import (
    FLAT_END,
    FLAT_START,
    HALF_WIDTH,
    RESURFACED,
    RESURFACING_FADE_M,
    Roads,
)

Mesh = tuple[Floats, Integers]

# Chosen: fine enough for the millimetres above, coarse for the land; heights as built.
_STEP_M = 2.5
_GROUND_CELL_M = 20.0
_GROUND_BELOW_M = 0.3
_GROUND_BEYOND_M = 100.0
_VERGE_M = 7.0
_KERB_M = 0.12
_PARAPET_M = 0.9
_DECK_M = 0.8
_LIFTED_M = 0.05
_SECTORS = 24
CEILING_M = 4.8  # of a tunnel above its road; chosen: 4.5 m of clearance and lamps
WALL_BEYOND_M = 0.05  # chosen: walls and parapets stand so far off the road


def road_mesh(roads: Roads) -> Mesh:
    """Triangles (n, 3, 3) and their material (n,) of all roads of a district and the ground about them."""
    meshes: list[Mesh] = []
    for link in range(len(roads.link_id)):
        meshes += _link(roads, link)
    meshes += [
        _of(_disc(roads, k), Material.ROAD) for k in range(len(roads.node_id)) if roads.nodes_m[k, 2] > 0.0
    ]
    meshes.append(_of(_ground(roads), Material.GROUND))
    return np.concatenate([m[0] for m in meshes]), np.concatenate([m[1] for m in meshes])


def _of(triangles: Floats, material: Material) -> Mesh:
    return triangles, np.full(len(triangles), int(material), np.int64)


def _sheet(points_m: Floats) -> Floats:
    """Two triangles for each cell of a grid of points (rows, columns, 3)."""
    a, b, c, d = points_m[:-1, :-1], points_m[1:, :-1], points_m[1:, 1:], points_m[:-1, 1:]
    cells = np.stack((np.stack((a, b, c), axis=2), np.stack((a, c, d), axis=2)), axis=2)
    return cells.reshape(-1, 3, 3)


def _across(roads: Roads, link: int, s: Floats, y: Floats) -> tuple[Floats, Floats]:
    """East and north (len(s), len(y)) of sections across a link."""
    east, north, yaw = (column[:, None] for column in roads.centre_line(link, s))
    return east - np.sin(yaw) * y, north + np.cos(yaw) * y


def _link(roads: Roads, link: int) -> list[Mesh]:
    length, half = float(roads.length_m[link]), float(roads.shape[link, HALF_WIDTH])
    s = _sections(roads, link)
    east, north = _across(roads, link, s, np.array([-half, 0.0, half]))
    up = roads.link_height_m(np.array(link), east, north)
    meshes = [_of(_sheet(np.stack((east, north, up), axis=2)), Material.ROAD)]
    lift = roads.lift_m(link, s)
    for side in (-1.0, 1.0):
        if roads.level[link] == 0:
            meshes.append(_of(_verge(roads, link, s, side * (half + 0.05)), Material.GROUND))
        elif np.abs(lift).max() > _LIFTED_M:
            meshes += _side_walls(roads, link, (s, lift), side)
    bridge, covered = roads.bridge_m[link], roads.covered_m[link]
    if bridge[1] > bridge[0]:
        meshes.append(_of(_plate(roads, link, bridge, -_DECK_M), Material.BUILDING))
    if covered[1] > covered[0]:
        meshes.append(_of(_plate(roads, link, covered, CEILING_M), Material.TUNNEL))
        meshes += [_portal(roads, link, float(end)) for end in covered if 0.0 < end < length]
    return meshes


def _sections(roads: Roads, link: int) -> Floats:
    """Where sections stand, s; twice as many where a new surface begins and ends."""
    length = float(roads.length_m[link])
    s = np.linspace(0.0, length, max(2, int(np.ceil(length / _STEP_M)) + 1))
    if roads.shape[link, RESURFACED] == 0.0:
        return s
    flat = roads.shape[link, [FLAT_START, FLAT_END]] + RESURFACING_FADE_M
    middle = 0.5 * (s[1:] + s[:-1])
    return np.sort(np.concatenate((s, middle[(middle < flat[0]) | (middle > length - flat[1])])))


def _verge(roads: Roads, link: int, s: Floats, y: float) -> Floats:
    """The strip along a road, a kerb higher, without what lies on another road."""
    out = y + np.sign(y) * np.array([0.0, 0.5 * _VERGE_M, _VERGE_M])
    east, north = _across(roads, link, s, out)
    # It keeps the crossfall of the road's edge, not more.
    edge_east, edge_north = _across(roads, link, s, np.array([y]))
    edge = roads.link_height_m(np.array(link), edge_east, edge_north)
    edge -= roads.terrain.height_m(edge_east, edge_north)
    up = roads.terrain.height_m(east, north) + edge + _KERB_M
    triangles = _sheet(np.stack((east, north, up), axis=2))
    return triangles[~_touches_road(roads, triangles)]


def _touches_road(roads: Roads, triangles: Floats) -> Booleans:
    """Is a corner or the middle of a triangle on a street, or over a road in an open cut?"""
    points = np.concatenate((triangles, triangles.mean(axis=1, keepdims=True)), axis=1).reshape(-1, 3)
    on_street = np.isfinite(roads.surface_m(points[:, 0], points[:, 1], np.array(0)))
    over_cut = _in_open_cut(roads, points[:, 0], points[:, 1])
    on_any: Integers = np.logical_or(on_street, over_cut).reshape(-1, 4).sum(axis=1)
    return on_any > 0


def _in_open_cut(roads: Roads, east: Floats, north: Floats, margin_m: float = 0.3) -> Booleans:
    """Places over, or within `margin_m` of, a road that lies below the ground under the open sky."""
    inside = np.zeros(east.shape, bool)
    for link in np.flatnonzero(roads.level < 0).tolist():
        s, y = roads.place(np.array(link), east, north)
        length, covered = float(roads.length_m[link]), roads.covered_m[link]
        within = (np.abs(y) < roads.shape[link, HALF_WIDTH] + margin_m) & (s > 0.0) & (s < length)
        within &= ~((s > covered[0]) & (s < covered[1]))
        inside |= within & (roads.lift_m(link, s.ravel()).reshape(s.shape) < -_LIFTED_M)
    return inside


def _side_walls(roads: Roads, link: int, sections: tuple[Floats, Floats], side: float) -> list[Mesh]:
    """Parapets and retaining walls, walls of a tunnel; none where another road joins. Sections: s and lift."""
    s, lift = sections
    y = side * (roads.shape[link, HALF_WIDTH] + WALL_BEYOND_M)
    east, north = (v.ravel() for v in _across(roads, link, s, np.array([y])))
    road = roads.link_height_m(np.array(link), east, north)
    ground = roads.terrain.height_m(east, north)
    bridge, covered = roads.bridge_m[link], roads.covered_m[link]
    above = lift > _LIFTED_M
    bottom = np.where(above, ground - 0.5, road - 0.1)
    top = np.where(above, road + np.where(lift > 0.3, _PARAPET_M, 0.0), ground + _KERB_M)
    over = (s >= bridge[0]) & (s <= bridge[1]) & (bridge[1] > bridge[0])
    bottom = np.where(over, road - _DECK_M, bottom)
    roofed = (s >= covered[0]) & (s <= covered[1]) & (covered[1] > covered[0])
    top = np.where(roofed, road + CEILING_M + 0.1, top)
    low, high = (np.column_stack((east, north, v)) for v in (bottom, top))
    quads = _sheet(np.stack((low, high), axis=1)).reshape(-1, 2, 3, 3)
    beyond = np.array([side * (roads.shape[link, HALF_WIDTH] + 0.4)])
    out_east, out_north = _across(roads, link, 0.5 * (s[1:] + s[:-1]), beyond)
    free = np.isnan(roads.surface_m(out_east, out_north, roads.level[link]).ravel())
    free &= np.abs(0.5 * (lift[1:] + lift[:-1])) > _LIFTED_M
    inner = 0.5 * (roofed[1:].astype(float) + roofed[:-1]) >= 0.5
    return [
        _of(quads[free & ~inner].reshape(-1, 3, 3), Material.BUILDING),
        _of(quads[free & inner].reshape(-1, 3, 3), Material.TUNNEL),
    ]


def _plate(roads: Roads, link: int, part_m: Floats, above_m: float) -> Floats:
    """A sheet over a part of a link at some height above (or below) its surface."""
    s = np.linspace(part_m[0], part_m[1], max(2, int((part_m[1] - part_m[0]) / _STEP_M) + 1))
    half = float(roads.shape[link, HALF_WIDTH]) + WALL_BEYOND_M
    east, north = _across(roads, link, s, np.array([-half, half]))
    up = roads.link_height_m(np.array(link), east, north) + above_m
    return _sheet(np.stack((east, north, up), axis=2))


def _portal(roads: Roads, link: int, s: float) -> Mesh:
    """The wall over a tunnel's mouth, from its ceiling to the ground."""
    half = float(roads.shape[link, HALF_WIDTH]) + WALL_BEYOND_M
    east, north = (v.ravel() for v in _across(roads, link, np.array([s]), np.array([-half, half])))
    low = roads.link_height_m(np.array(link), east, north) + CEILING_M
    high = roads.terrain.height_m(east, north) + _KERB_M
    points = np.stack([np.column_stack((east, north, v)) for v in (low, high)])
    return _of(_sheet(points), Material.TUNNEL)


def _disc(roads: Roads, node: int) -> Floats:
    """The road about a node."""
    east, north, radius, lift = roads.nodes_m[node]
    angle = np.linspace(0.0, 2.0 * np.pi, _SECTORS + 1)
    r = np.array([0.0, 0.25, 0.5, 0.75, 1.0])[:, None] * radius
    e, n = east + r * np.cos(angle), north + r * np.sin(angle)
    points = np.stack((e, n, roads.terrain.height_m(e, n) + lift), axis=2)
    return _sheet(points)


def _ground(roads: Roads) -> Floats:
    """The land, a little lower than the roads, open over open cuts."""
    reach = roads.nodes_m[:, :2]
    low = np.minimum(reach.min(axis=0), roads.elements[:, :2].min(axis=0)) - _GROUND_BEYOND_M
    high = np.maximum(reach.max(axis=0), roads.elements[:, :2].max(axis=0)) + _GROUND_BEYOND_M
    axes = [np.arange(a, b + _GROUND_CELL_M, _GROUND_CELL_M) for a, b in zip(low, high, strict=True)]
    e, n = np.meshgrid(*axes, indexing="ij")
    sheet = _sheet(np.stack((e, n, roads.terrain.height_m(e, n) - _GROUND_BELOW_M), axis=2))
    cells = sheet.reshape(-1, 2, 3, 3)
    fine = np.linspace(0.0, _GROUND_CELL_M, 6)
    corner = cells[:, 0, 0, :2]
    at_e = corner[:, 0, None, None] + fine[:, None] + 0.0 * fine
    at_n = corner[:, 1, None, None] + fine + 0.0 * fine[:, None]
    cut = _in_open_cut(roads, at_e, at_n, margin_m=3.0).reshape(len(cells), -1).any(axis=1)
    return cells[~cut].reshape(-1, 3, 3)
