"""A release's columns from lanes: surfaces along each, a link for each, nodes where they meet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from camber.formats.errors import FormatError
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.tools.maps.importers.checks.left_out import LeftOutLanes, lane_area_m2
from camber.tools.maps.importers.checks.level_heights import EXPECTED, is_level_lane
from camber.tools.maps.importers.lane_levels import cuts_and_levels
from camber.tools.maps.importers.lane_pieces import LanePiece, pieces_of
from camber.tools.maps.importers.lanes import Floats, Integers, Lane, distance_along, named_id

_STEP_M = 0.01
"""Deviation of a lane from its surfaces above which a remark is made; chosen: the order of σ of good maps."""


@dataclass(frozen=True, kw_only=True)
class LaneSurvey:
    """How well the lanes are known: σ of heights, σ of links across, and when they were seen (GPS time).

    `level_sigma_m`: σ of lanes that are level, which nobody measured; None: they are invalid.
    """

    sigma_m: float
    link_sigma_m: float
    seen_ns: int
    level_sigma_m: float | None = None


def road_map(
    lanes: Sequence[Lane],
    frame: LocalFrame,
    known: LaneSurvey,
    file: str,
    *,
    left_out: LeftOutLanes | None = None,
) -> tuple[RoadSurfaces, RoadLinks, list[str]]:
    """Surfaces and links of lanes given in the plane of a frame, and remarks on lanes that no surface can follow and on
    invalid ones, which are left out; without `left_out` the first one is raised.

    A surface's id comes from its lane's name and plan and the number of its piece, so a map that is read again, or
    with other heights, has the same ids, and a lane with another course has new ones.
    """
    left_out = left_out or LeftOutLanes()
    lanes, pieces = _cut(lanes, file, known=known, left_out=left_out)
    losses = left_out.remarks(len(lanes), sum(lane_area_m2(lane.sections) for lane in lanes), file)
    cuts, levels = cuts_and_levels(lanes, pieces, file)
    links: list[_LaneLink] = []
    link_of, level_of, id_of = [], [], []
    for lane, of_lane, cut, level in zip(lanes, pieces, cuts, levels, strict=True):
        parts = _links(lane, of_lane, cut, level)
        of_piece = np.searchsorted(cut, np.arange(len(of_lane)), "right")
        link_of += [parts[k].link_id for k in of_piece]
        level_of += [parts[k].level for k in of_piece]
        id_of += [named_id("surface", lane.name, lane.plan, k) for k in range(len(of_lane))]
        links += parts
    flat = [piece for of_lane in pieces for piece in of_lane]
    extra_m = [known.level_sigma_m or 0.0 if is_level_lane(of_lane) else 0.0 for of_lane in pieces]
    sigma_m = np.hypot(known.sigma_m, np.repeat(extra_m, [len(of_lane) for of_lane in pieces]))
    remarks = [
        f"{file}: {lane.name}: heights make a step, σ of a surface is up to {worst_m:.2f} m"
        for lane, of_lane in zip(lanes, pieces, strict=True)
        if (worst_m := max(piece.off_m for piece in of_lane)) > _STEP_M
    ]
    columns = {"surface_id": id_of, "link_id": link_of, "level": level_of}
    numbers = {name: np.array(ids, np.int64) for name, ids in columns.items()}
    surfaces = _surfaces(flat, frame, numbers, sigma_m=sigma_m, seen_ns=known.seen_ns)
    if any(extra_m):
        count = sum(extra > 0.0 for extra in extra_m)
        remarks.append(f"{file}: {count} lanes are level: σ of their heights is {known.level_sigma_m:g} m")
    return surfaces, _road_links(links, frame, known), losses + remarks


def _cut(
    lanes: Sequence[Lane], file: str, *, known: LaneSurvey, left_out: LeftOutLanes
) -> tuple[list[Lane], list[list[LanePiece]]]:
    """The lanes that can be cut into pieces, and these."""

    def cut(lane: Lane) -> list[LanePiece]:
        pieces = pieces_of(lane, file)
        if known.level_sigma_m is None and is_level_lane(pieces):
            raise FormatError(file, f"{lane.name}, heights", EXPECTED, actual="level")
        return pieces

    kept: list[Lane] = []
    pieces: list[list[LanePiece]] = []
    for lane in lanes:
        area_m2 = lane_area_m2(lane.sections)
        of_lane = left_out.attempt(partial(cut, lane), name=lane.name, area_m2=area_m2)
        if of_lane is not None:
            kept.append(lane)
            pieces.append(of_lane)
    return kept, pieces


def lineage(surfaces: RoadSurfaces, previous: Release | None) -> list[tuple[int, int]]:
    """(new surface, surface of the previous release that is no more): on one level, the centre of one on the other.

    What is in both releases has no parents and is none: its id goes on.
    """
    if previous is None:
        return []
    before = previous.road_surfaces()
    gone = np.flatnonzero(~np.isin(before.surface_id, surfaces.surface_id))
    new = np.flatnonzero(~np.isin(surfaces.surface_id, before.surface_id))
    if not len(gone) or not len(new):
        return []
    cell_rad = 2e-4  # more than the longest piece
    cells: dict[tuple[int, int], list[int]] = {}
    for k in gone.tolist():
        place = (int(before.latitude_rad[k] // cell_rad), int(before.longitude_rad[k] // cell_rad))
        cells.setdefault(place, []).append(k)
    pairs = []
    for k in new.tolist():
        i, j = int(surfaces.latitude_rad[k] // cell_rad), int(surfaces.longitude_rad[k] // cell_rad)
        near = [row for a in (-1, 0, 1) for b in (-1, 0, 1) for row in cells.get((i + a, j + b), ())]
        near = [row for row in near if before.level[row] == surfaces.level[k]]
        pairs += [
            (int(surfaces.surface_id[k]), int(before.surface_id[row]))
            for row in near
            if _meet(surfaces, k, before, row)
        ]
    return pairs


def _meet(a: RoadSurfaces, i: int, b: RoadSurfaces, j: int) -> bool:
    """Is the centre of one on the other?"""
    return _is_on(a, i, b, j) or _is_on(b, j, a, i)


def _is_on(a: RoadSurfaces, i: int, b: RoadSurfaces, j: int) -> bool:
    frame = LocalFrame(float(a.latitude_rad[i]), float(a.longitude_rad[i]), 0.0)
    east_m, north_m = frame.east_north_from_geodetic(float(b.latitude_rad[j]), float(b.longitude_rad[j]), 0.0)
    c, s = math.cos(a.yaw_rad[i]), math.sin(a.yaw_rad[i])
    u, v = c * east_m + s * north_m, c * north_m - s * east_m
    return bool(abs(u) <= a.half_length_m[i] and abs(v) <= a.half_width_m[i])


@dataclass(frozen=True, eq=False, kw_only=True)
class _LaneLink:
    link_id: int
    nodes: tuple[int, int]
    level: int
    line_m: Floats


def _links(
    lane: Lane, pieces: Sequence[LanePiece], cuts: Sequence[int], levels: Sequence[int]
) -> list[_LaneLink]:
    """One link, or as many as the lane is cut into: then with ids and nodes of their own between."""
    nodes = [named_id("node", lane.nodes[0])]
    nodes += [named_id("node", lane.name, lane.plan, cut) for cut in cuts]
    nodes.append(named_id("node", lane.nodes[1]))
    line_m = lane.centre_m
    along_m = distance_along(line_m)
    # Where the lane is cut: between two pieces.
    at_m = np.array([0.0] + [_nearest(along_m, pieces, cut) for cut in cuts] + [along_m[-1]])
    links = []
    for k, (begin, end) in enumerate(pairwise(at_m.tolist())):
        at = np.concatenate(([begin], along_m[(along_m > begin + 1e-3) & (along_m < end - 1e-3)], [end]))
        part_m = np.column_stack([np.interp(at, along_m, line_m[:, axis]) for axis in (0, 1)])
        link_id = lane.link_id if not cuts else named_id("link", lane.name, k)
        links.append(
            _LaneLink(link_id=link_id, nodes=(nodes[k], nodes[k + 1]), level=levels[k], line_m=part_m)
        )
    return links


def _nearest(along_m: Floats, pieces: Sequence[LanePiece], cut: int) -> float:
    """How far along a line the beginning of a piece is."""
    length_m = np.array([2.0 * piece.half_length_m for piece in pieces])
    return float(along_m[-1] * length_m[:cut].sum() / length_m.sum())


def _surfaces(
    pieces: Sequence[LanePiece],
    frame: LocalFrame,
    numbers: Mapping[str, Integers],
    *,
    sigma_m: Floats,
    seen_ns: int,
) -> RoadSurfaces:
    """`numbers`: ids, links and levels of the surfaces by column; `sigma_m` (n,): of the heights."""
    n = len(pieces)
    centre_m = np.array([piece.centre_m for piece in pieces]).reshape(n, 2)
    latitude, longitude, _ = frame.geodetic_from_east_north_array(centre_m, np.zeros(n))
    # The frame's north is not quite that of the place.
    east_rad = (longitude - frame.longitude_rad + math.pi) % (2.0 * math.pi) - math.pi
    turned = east_rad * math.sin(frame.latitude_rad)
    return RoadSurfaces(
        **numbers,
        latitude_rad=latitude,
        longitude_rad=longitude,
        yaw_rad=np.array([piece.yaw_rad for piece in pieces]) - turned,
        half_length_m=np.array([piece.half_length_m for piece in pieces]),
        half_width_m=np.array([piece.half_width_m for piece in pieces]),
        # Where the grid cannot follow the lane, as over a step, the surface is as unsure as that.
        sigma_m=np.hypot(sigma_m, [piece.off_m for piece in pieces]),
        vehicles=np.zeros(n, np.int64),
        last_seen_ns=np.full(n, seen_ns),
        heights_m=[piece.heights_m for piece in pieces],
    )


def _road_links(links: Sequence[_LaneLink], frame: LocalFrame, known: LaneSurvey) -> RoadLinks:
    count = [len(link.line_m) for link in links]
    points = np.concatenate([link.line_m for link in links] + [np.zeros((0, 2))])
    latitude, longitude, _ = frame.geodetic_from_east_north_array(points, np.zeros(len(points)))
    lines = np.split(np.column_stack((latitude, longitude)), np.cumsum(count)[:-1]) if links else []
    return RoadLinks(
        link_id=np.array([link.link_id for link in links], np.int64),
        start_node=np.array([link.nodes[0] for link in links], np.int64),
        end_node=np.array([link.nodes[1] for link in links], np.int64),
        level=np.array([link.level for link in links], np.int64),
        sigma_m=np.full(len(links), known.link_sigma_m),
        vertices=lines,
    )
