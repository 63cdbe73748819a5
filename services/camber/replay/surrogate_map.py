"""Roads of a map, made from where a drive went: surfaces with a survey's errors, links that are coarse.

Made from truth, so the map knows only roads that were driven, each with its height along the track and no
crossfall. One place and level has ONE height: that of the nearest first-pass track. Antenna height is taken off
along the vertical; pitch and roll of the vehicle are not. A constant offset of the receiver's datum from the
truth's is left in: the map is in the truth's frame, and the judge has to learn the rest.
"""

from __future__ import annotations

import numpy as np

from camber.formats.drive.truth_csv import TruthTable
from camber.geodesy.local_frame import LocalFrame
from camber.replay.coarse_links import PlaneLinks, coarse_links
from camber.replay.road_lines import BEYOND_END_M, OTHER_LEVEL_M, SPACING_M, WIDTH_M, RoadLines, road_lines
from camber.replay.truth_interpolation import plane_of
from camber.road_map.map_error_model import MapErrorModel
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.schemas.base import Float64, Int64
from camber.schemas.drive import Surrogates
from camber.simulator.random_streams import stream

_SAMPLES_PER_SURFACE = 5  # chosen: at 10 m/s and 5 Hz ten metres
_LARGEST_TURN_RAD = np.deg2rad(30.0)
_COLUMNS = 5  # chosen: a node each 1 or 2 m across a road
_NEAR_M = 20.0  # chosen: twice the length of a surface


def make_map(
    truth: TruthTable, errors: Surrogates, antenna_height_m: float
) -> tuple[RoadSurfaces, RoadLinks]:
    """Surfaces and links of the roads that a drive went along.

    Ids depend on the track alone, heights and vertices also on the seed. Raises ValueError for a truth that does
    not move.
    """
    frame = plane_of(truth)
    plane_m = frame.east_north_from_geodetic_array(truth.latitude_rad, truth.longitude_rad, truth.height_m)
    lines = road_lines(plane_m, truth.height_m - antenna_height_m)
    links = coarse_links(lines, errors.link_deviation_m, stream(errors.seed, "links"))
    heights_m = _noisy_heights(lines, errors)
    pieces = _pieces(lines)
    surfaces = _surfaces(
        _Ground(lines, heights_m, pieces),
        pieces,
        links,
        frame=frame,
        sigma_m=errors.map_sigma_m,
        seen_ns=int(truth.time_ns[0]),
    )
    return surfaces, _to_links(links, frame, 0.5 * errors.link_deviation_m)


def _noisy_heights(lines: RoadLines, errors: Surrogates) -> Float64:
    """Heights of all samples as surveyed: noise along new road; a covered sample has its first pass's."""
    model = MapErrorModel(
        short_share=errors.map_short_share,
        short_m=errors.map_short_m,
        long_m=errors.map_long_m,
        common_offset_sigma_m=errors.map_common_offset_sigma_m,
    )
    new = np.flatnonzero(lines.same_as == np.arange(len(lines.same_as)))
    noise_m = np.zeros(len(lines.height_m))
    noise_m[new] = model.simulate(
        lines.distance_m[new], errors.map_sigma_m, stream(errors.seed, "map heights")
    )
    noise_m[new] += model.common_offset(stream(errors.seed, "map offset"))
    surveyed: Float64 = (lines.height_m + noise_m)[lines.same_as]
    return surveyed


def _pieces(lines: RoadLines) -> Int64:
    """First and last samples (n, 2) of surfaces: runs in pieces of at most ten metres that turn by at most 30°."""
    step = np.diff(lines.east_north_m, axis=0)
    yaw_rad = np.arctan2(step[:, 1], step[:, 0])
    pieces: list[tuple[int, int]] = []
    for begin, end in lines.runs:
        first = max(begin - 1, 0)
        stop = min(end, len(lines.height_m) - 1)
        while first < stop:
            last = first + 1
            while (
                last < stop
                and last - first < _SAMPLES_PER_SURFACE
                and np.cos(yaw_rad[last] - yaw_rad[first]) > np.cos(_LARGEST_TURN_RAD)
            ):
                last += 1
            pieces.append((first, last))
            first = last
    return np.array(pieces, np.int64).reshape(-1, 2)


def _surfaces(
    ground: _Ground,
    pieces: Int64,
    links: PlaneLinks,
    *,
    frame: LocalFrame,
    sigma_m: float,
    seen_ns: int,
) -> RoadSurfaces:
    lines = ground.lines
    n, middle = len(pieces), pieces.sum(axis=1) // 2
    begin_m, end_m = lines.east_north_m[pieces[:, 0]], lines.east_north_m[pieces[:, 1]]
    chord_m, centre_m = end_m - begin_m, 0.5 * (end_m + begin_m)
    yaw_rad = np.arctan2(chord_m[:, 1], chord_m[:, 0])
    half_length_m = 0.5 * np.hypot(*chord_m.T) + BEYOND_END_M
    link_id = links.link_of_sample[middle]
    grids = []
    for k in range(n):
        rows = max(2, round(2.0 * half_length_m[k] / SPACING_M) + 1)
        nodes = _grid(centre_m[k], float(yaw_rad[k]), float(half_length_m[k]), rows)
        level_height_m = float(lines.height_m[middle[k]])
        grids.append(ground.heights(nodes, centre_m[k], level_height_m).reshape(rows, _COLUMNS))
    latitude, longitude, _ = frame.geodetic_from_east_north_array(centre_m, np.zeros(n))
    return RoadSurfaces(
        surface_id=np.arange(1, n + 1),
        link_id=link_id,
        level=links.level[link_id - 1],
        latitude_rad=latitude,
        longitude_rad=longitude,
        yaw_rad=yaw_rad,
        half_length_m=half_length_m,
        half_width_m=np.full(n, 0.5 * WIDTH_M),
        sigma_m=np.full(n, sigma_m),
        vehicles=np.zeros(n, dtype=np.int64),
        last_seen_ns=np.full(n, seen_ns),
        heights_m=grids,
    )


def _grid(centre_m: Float64, yaw_rad: float, half_length_m: float, rows: int) -> Float64:
    """Nodes (rows · columns, 2) of a surface, from the rear to the front, from the right to the left."""
    along, across = np.meshgrid(
        np.linspace(-half_length_m, half_length_m, rows),
        np.linspace(-0.5 * WIDTH_M, 0.5 * WIDTH_M, _COLUMNS),
        indexing="ij",
    )
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    nodes_m: Float64 = centre_m + np.column_stack(
        (c * along.ravel() - s * across.ravel(), s * along.ravel() + c * across.ravel())
    )
    return nodes_m


class _Ground:
    """The one height of each place and level: that of the nearest piece of new track."""

    def __init__(self, lines: RoadLines, heights_m: Float64, pieces: Int64) -> None:
        self.lines = lines
        first = np.concatenate([np.arange(first, last) for first, last in pieces])
        self._from_m = lines.east_north_m[first]
        self._step_m = lines.east_north_m[first + 1] - self._from_m
        self._true_m = lines.height_m[first]
        self._height_m = heights_m[first]
        self._climb_m = heights_m[first + 1] - self._height_m

    def heights(self, nodes_m: Float64, centre_m: Float64, level_height_m: float) -> Float64:
        """Heights (n,) at nodes (n, 2) about a centre, on the level that is near `level_height_m`."""
        near = np.hypot(*(self._from_m - centre_m).T) <= _NEAR_M
        near &= np.abs(self._true_m - level_height_m) <= OTHER_LEVEL_M
        from_m, step_m = self._from_m[near], self._step_m[near]
        length2 = np.maximum(np.sum(step_m**2, axis=1), 1e-12)
        to_node = nodes_m[:, None, :] - from_m
        share = np.clip(np.sum(to_node * step_m, axis=2) / length2, 0.0, 1.0)
        away2 = np.sum((to_node - share[..., None] * step_m) ** 2, axis=2)
        nearest = np.argmin(away2, axis=1)
        along: Float64 = share[np.arange(len(nodes_m)), nearest]
        return np.asarray(self._height_m[near][nearest] + along * self._climb_m[near][nearest])


def _to_links(links: PlaneLinks, frame: LocalFrame, sigma_m: float) -> RoadLinks:
    n = len(links.vertices_m)
    vertices = []
    for line in links.vertices_m:
        latitude, longitude, _ = frame.geodetic_from_east_north_array(line, np.zeros(len(line)))
        vertices.append(np.column_stack((latitude, longitude)))
    return RoadLinks(
        link_id=np.arange(1, n + 1),
        start_node=links.start_node,
        end_node=links.end_node,
        level=links.level,
        sigma_m=np.full(n, sigma_m),
        vertices=vertices,
    )
