"""What stands along the roads: buildings, trees, poles, parked vehicles, on the survey day and on the drive day."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.simulator.random_streams import stream
from camber.simulator.scene import Booleans, Floats, Integers, Material, Shapes
from camber.simulator.world.road_mesh import road_mesh
from camber.simulator.world.roads import HALF_WIDTH, Roads
from camber.simulator.world.tunnel_fittings import tunnel_fittings

Day = Literal["survey", "drive"]

_NODE_CLEAR_M = (
    24.0  # chosen: nothing is parked nearer to a node, nor a tree or pole nearer than two thirds of it
)
_LOWEST_M = 3.0  # chosen: a bungalow


@dataclass(frozen=True, slots=True, kw_only=True)
class Frontage:
    """How a kind of street is built up: metres from the centre line, of lots along it and of houses across it.

    `height_m`: mean and standard deviation of a normal distribution.
    """

    setback_m: float
    lot_m: tuple[float, float]
    depth_m: tuple[float, float]
    height_m: tuple[float, float]
    gap: float
    tree_every_m: float = 0.0
    pole_every_m: float
    parked: float


FRONTAGES = {
    "street": Frontage(
        setback_m=12.0, lot_m=(14.0, 26.0), depth_m=(12.0, 18.0), height_m=(13.0, 5.0), gap=0.25,
        pole_every_m=35.0, parked=0.30,
    ),
    # 30 m blocks, N(50, 15) m, 10 % gaps on a street 20 m wide: the street canyon of Kikuchi (TUMSAT).
    "canyon": Frontage(
        setback_m=10.0, lot_m=(30.0, 30.0), depth_m=(20.0, 20.0), height_m=(50.0, 15.0), gap=0.10,
        pole_every_m=35.0, parked=0.15,
    ),
    "avenue": Frontage(
        setback_m=16.0, lot_m=(15.0, 28.0), depth_m=(12.0, 20.0), height_m=(16.0, 6.0), gap=0.35,
        tree_every_m=9.0, pole_every_m=45.0, parked=0.25,
    ),
    "open": Frontage(
        setback_m=45.0, lot_m=(15.0, 25.0), depth_m=(10.0, 14.0), height_m=(6.0, 1.5), gap=0.92,
        tree_every_m=120.0, pole_every_m=60.0, parked=0.02,
    ),
}  # fmt: skip


def shapes_of(roads: Roads, seed: int, day: Day) -> Shapes:
    """The roads and all that stands along them on one day, with what hangs in tunnels; buildings stay."""
    trunks, crowns = _trees(roads, seed, day)
    boxes = {
        Material.BUILDING: buildings(roads, seed),
        Material.VEHICLE: _vehicles(roads, seed, day),
        Material.POLE: _cabinets(roads, seed, day),
        Material.TUNNEL: tunnel_fittings(roads, seed),
    }
    cylinders = {Material.POLE: _poles(roads, seed, day), Material.TREE: trunks}
    triangles, triangles_material = road_mesh(roads)
    return Shapes(
        boxes_m=np.concatenate([*boxes.values()]),
        boxes_material=_material_of(boxes),
        cylinders_m=np.concatenate([*cylinders.values()]),
        cylinders_material=_material_of(cylinders),
        crowns_m=crowns,
        triangles_m=triangles,
        triangles_material=triangles_material,
    )


def _material_of(parts: dict[Material, Floats]) -> Integers:
    return np.repeat([int(material) for material in parts], [len(part) for part in parts.values()])


def buildings(roads: Roads, seed: int) -> Floats:
    """Boxes (n, 7) along all links that are built up, none on a road or in another."""
    rng = stream(seed, "buildings")
    houses = [np.zeros((0, 7))]
    for link, style in enumerate(roads.style):
        if style in FRONTAGES:
            for side in (-1.0, 1.0):
                houses.append(_row_of_houses((roads, link), side, FRONTAGES[style], rng))
    boxes = np.concatenate(houses)
    boxes = boxes[_clear_of_roads(roads, boxes)]
    kept: list[int] = []
    for k in range(len(boxes)):
        if not kept or not _overlap(boxes[k], boxes[kept]).any():
            kept.append(k)
    return boxes[kept]


def _row_of_houses(at: tuple[Roads, int], side: float, front: Frontage, rng: np.random.Generator) -> Floats:
    roads, link = at
    length = float(roads.length_m[link])
    count = int(length / front.lot_m[0]) + 1
    lot = rng.uniform(*front.lot_m, count)
    end = np.cumsum(lot)
    depth = rng.uniform(*front.depth_m, count)
    height = np.maximum(rng.normal(*front.height_m, count), _LOWEST_M)
    stands = (rng.random(count) >= front.gap) & (end <= length + 0.5 * lot)
    east, north, yaw = roads.at_offset(link, end - 0.5 * lot, side * (front.setback_m + 0.5 * depth))
    base = roads.terrain.height_m(east, north)
    boxes = np.column_stack((east, north, base - 2.0, 0.5 * lot - 0.05, 0.5 * depth, height + 2.0, yaw))
    return boxes[stands]


def _clear_of_roads(roads: Roads, boxes: Floats, margin_m: float = 2.0, but: int | None = None) -> Booleans:
    """Boxes of which no point comes near a road that is not in a tunnel; `but`: a link that does not count."""
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 7)))
    c, s = np.cos(boxes[:, 6:7]), np.sin(boxes[:, 6:7])
    along, left = u * boxes[:, 3:4], v * boxes[:, 4:5]
    east = boxes[:, 0:1] + c * along - s * left
    north = boxes[:, 1:2] + s * along + c * left
    clear = np.ones(len(boxes), bool)
    for link in range(len(roads.link_id)):
        if link == but:
            continue
        at, y = roads.place(np.array(link), east, north)
        covered = roads.covered_m[link]
        near = np.abs(y) < roads.shape[link, HALF_WIDTH] + margin_m
        near &= (at > -margin_m) & (at < roads.length_m[link] + margin_m)
        near &= ~((at > covered[0]) & (at < covered[1]))
        clear &= ~near.any(axis=1)
    for node_east, node_north, radius, _ in roads.nodes_m[roads.nodes_m[:, 2] > 0.0]:
        clear &= ~(np.hypot(east - node_east, north - node_north) < radius + margin_m).any(axis=1)
    return clear


def _overlap(box: Floats, others: Floats) -> Booleans:
    """Does the plan of a box overlap those of others? By separating axes."""
    apart = np.zeros(len(others), bool)
    de, dn = others[:, 0] - box[0], others[:, 1] - box[1]

    def reach(row: Floats, c: Floats, s: Floats) -> Floats:
        turn = row[..., 6]
        across = np.abs(np.cos(turn) * c + np.sin(turn) * s) * row[..., 3]
        return across + np.abs(np.cos(turn) * s - np.sin(turn) * c) * row[..., 4]

    for yaw in (np.full(len(others), box[6]), others[:, 6]):
        for c, s in ((np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))):
            apart |= np.abs(de * c + dn * s) > reach(box, c, s) + reach(others, c, s)
    return ~apart


def _places_along(
    roads: Roads, key: str, out_m: float, clear_m: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """East, north, ground and yaw of places on both sides of all links, as far apart as their frontage says."""
    rows: list[Floats] = [np.zeros((0, 3))]
    for link, style in enumerate(roads.style):
        every_m = float(getattr(FRONTAGES[style], key)) if style in FRONTAGES else 0.0
        if every_m > 0.0:
            s = np.arange(clear_m, float(roads.length_m[link]) - clear_m, every_m)
            for side in (-1.0, 1.0):
                y = side * (roads.shape[link, HALF_WIDTH] + out_m)
                rows.append(np.column_stack(roads.at_offset(link, s + (4.0 if side > 0.0 else 0.0), y)))
    east, north, yaw = np.concatenate(rows).T
    points = np.column_stack((east, north, *np.zeros((4, len(east))), yaw))
    east, north, yaw = points[_clear_of_roads(roads, points, 0.4)][:, [0, 1, 6]].T
    return east, north, roads.terrain.height_m(east, north), yaw


def _poles(roads: Roads, seed: int, day: Day) -> Floats:
    """Lamp posts; until the drive day one in twelve is gone and one in twelve stands half a metre to two metres off."""
    east, north, ground, yaw = _places_along(roads, "pole_every_m", 1.2, _NODE_CLEAR_M * 2.0 / 3.0)
    rng = stream(seed, "poles")
    radius, height = rng.uniform(0.08, 0.16, len(east)), rng.uniform(6.0, 9.0, len(east))
    lot, moved = rng.random(len(east)), rng.uniform(0.5, 2.0, len(east))
    stays = np.ones(len(east), bool)
    if day == "drive":
        stays = lot >= 1.0 / 12.0
        moved = np.where((lot >= 1.0 / 12.0) & (lot < 2.0 / 12.0), moved, 0.0)
        east, north = east + moved * np.cos(yaw), north + moved * np.sin(yaw)
    return np.column_stack((east, north, ground - 0.2, radius, height + 0.2))[stays]


def _trees(roads: Roads, seed: int, day: Day) -> tuple[Floats, Floats]:
    """Trunks and crowns; crowns have grown by 3 to 10 % until the drive day."""
    east, north, ground, _ = _places_along(roads, "tree_every_m", 3.0, _NODE_CLEAR_M * 2.0 / 3.0)
    rng = stream(seed, "trees")
    n = len(east)
    trunk, radius = rng.uniform(2.8, 3.6, n), rng.uniform(1.9, 3.0, n)
    thick, growth = rng.uniform(0.12, 0.25, n), rng.uniform(1.03, 1.10, n)
    high = radius * rng.uniform(0.9, 1.3, n)
    if day == "drive":
        radius, high = radius * growth, high * growth
    trunks = np.column_stack((east, north, ground - 0.2, thick, trunk + 0.5))
    return trunks, np.column_stack((east, north, ground + trunk + 0.8 * high, radius, high))


def _vehicles(roads: Roads, seed: int, day: Day) -> Floats:
    """Parked vehicles at the kerb, a body and a cabin each; a third of those of the survey day are still there."""
    bodies: list[Floats] = [np.zeros((0, 7))]
    for link, style in enumerate(roads.style):
        if style not in FRONTAGES:
            continue
        s = np.arange(_NODE_CLEAR_M, float(roads.length_m[link]) - _NODE_CLEAR_M, 7.5)
        for side, side_name in ((-1.0, "right"), (1.0, "left")):
            rng = stream(seed, f"parked {link} {side_name}")
            then = rng.random(len(s)) < FRONTAGES[style].parked
            now = np.where(rng.random(len(s)) < 1.0 / 3.0, then, rng.random(len(s)) < FRONTAGES[style].parked)
            shift, size = rng.uniform(-0.7, 0.7, (2, len(s))), rng.uniform(0.85, 1.05, (2, len(s)))
            k = 0 if day == "survey" else 1
            taken = then if k == 0 else now
            y = side * (roads.shape[link, HALF_WIDTH] - 0.85)
            east, north, yaw = roads.at_offset(link, s + shift[k], y)
            up = roads.link_height_m(np.array(link), east, north)
            shape = np.tile((0.0, 2.4, 0.9, 1.5), (len(s), 1))
            taken = taken & _clear_of_roads(roads, np.column_stack((east, north, shape, yaw)), 0.3, but=link)
            for low, high, long, wide in ((0.2, 0.75, 2.2, 0.85), (0.95, 0.55, 1.2, 0.72)):
                across = np.tile((wide, high), (len(s), 1))
                body = np.column_stack((east, north, up + low, long * size[k], across, yaw))
                bodies.append(body[taken])
    return np.concatenate(bodies)


def _cabinets(roads: Roads, seed: int, day: Day) -> Floats:
    """Switch cabinets and containers on the pavement; half of them stand elsewhere on the drive day."""
    east, north, ground, yaw = _places_along(roads, "pole_every_m", 2.6, _NODE_CLEAR_M)
    rng = stream(seed, "cabinets")
    n = len(east)
    there, moves, by = rng.random(n) < 0.25, rng.random(n) < 0.5, rng.uniform(-8.0, 8.0, n)
    half_length, height = rng.uniform(0.4, 1.2, n), rng.uniform(0.9, 1.8, n)
    if day == "drive":
        by = np.where(moves, by, 0.0)
        east, north = east + by * np.cos(yaw), north + by * np.sin(yaw)
    boxes = np.column_stack((east, north, ground, half_length, np.full(n, 0.3), height + 0.2, yaw))
    return boxes[there]
