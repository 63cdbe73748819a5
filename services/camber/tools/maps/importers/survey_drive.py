"""`camber map build drive`: confirmed positions of a drive become roads: links where it went, surfaces under it.

From the folder of a replay come the positions that the judge confirmed, and the antenna's height by ways that do not
need the map. From a truth.csv come all its positions: the user is responsible for them, and for the antenna's height.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camber.formats.drive.recording import load_recording
from camber.formats.drive.truth_csv import read_truth
from camber.formats.errors import FormatError
from camber.geodesy.local_frame import LocalFrame
from camber.replay.coarse_links import coarse_links
from camber.replay.road_lines import RoadLines, road_lines
from camber.schemas.antenna import AntennaHeight
from camber.schemas.integrity import CONFIRMED_VERDICTS
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.checks.height_check import (
    PLACES,
    SourceHeights,
    add_check_arguments,
    checked_heights,
    seed_of,
)
from camber.tools.maps.importers.lanes import named_links
from camber.tools.maps.importers.surfaces_along import Floats, Integers, RoadCentreLines, surfaces_along
from camber.tools.maps.importers.track_heights import TrackHeights
from camber.tools.options.number_options import HEIGHT_SIGMA, number_from
from camber.tools.options.parsers import add_with_default

_MAP_FREE = ("fixed", "stroke", "ranging")
_HEIGHT_AGE_NS = 1_000_000_000  # chosen: antenna heights are published at 1 Hz or more
_STEP_M = 0.1  # chosen: below the distance of two positions of a moving vehicle
_LEVEL_WEIGHT = 5.0  # chosen: levels are 5 m apart, and so farther than the next lane
_AT_ONCE = 50  # chosen: with 100 km of road some 100 MB
_LINK_SIGMA_M = 0.5  # chosen: a driver keeps to the lane's middle within this


@dataclass(frozen=True, eq=False, kw_only=True)
class RoadTrack:
    """Places of the antenna (n,) [rad], ellipsoidal heights of the road there and their σ [m], in the order driven."""

    latitude_rad: Floats
    longitude_rad: Floats
    road_height_m: Floats
    sigma_m: Floats
    last_ns: int

    def __len__(self) -> int:
        return len(self.latitude_rad)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only a drive needs."""
    text = "folder of a replay (recording.mcap), or a truth.csv"
    parser.add_argument("drive", type=Path, metavar="PATH", help=text)
    height_m, text = number_from(0.1, 20.0, "m"), "above the road; else as recorded"
    parser.add_argument("--antenna-height-m", type=height_m, metavar="H", help=text)
    sigma = {"type": HEIGHT_SIGMA, "metavar": "S"}
    add_with_default(parser, "--antenna-sigma-m", 0.01, "its σ", **sigma)
    add_with_default(parser, "--position-sigma-m", 0.02, "σ of heights that do not say theirs", **sigma)
    add_with_default(
        parser, "--width-m", 3.0, "of the surfaces", type=number_from(0.5, 20.0, "m"), metavar="W"
    )
    text, spacing_m = "between their heights", number_from(0.1, 20.0, "m")
    add_with_default(parser, "--spacing-m", 2.0, text, type=spacing_m, metavar="D")
    text = "how far along the road a position speaks for it: half the way between two"
    add_with_default(parser, "--reach-m", 4.0, text, type=number_from(1.0, 50.0, "m"), metavar="D")
    add_check_arguments(parser)


def build(args: argparse.Namespace) -> BuiltMap:
    """Roads where the drive has positions; none where it has not."""
    track = _csv_track(args) if args.drive.suffix == ".csv" else _replay_track(args)
    roads = drive_roads(track, str(args.drive), args.width_m, args.reach_m)
    surfaces = surfaces_along(
        roads.roads, roads.ground, spacing_m=args.spacing_m, seen_ns=track.last_ns, vehicles=1
    )
    if not len(surfaces):
        expected = f"positions nearer to one another than {args.reach_m:g} m"
        raise FormatError(str(args.drive), "track", expected)
    remarks = [f"{args.drive}: {len(track)} positions, {roads.lines.distance_m[-1]:.0f} m"]
    seed = seed_of(args)
    source = driven_heights(track, roads, np.random.default_rng(seed))
    # Noise of the positions is random: 0.3 % of a normal one are beyond 3 σ, and more where it is correlated.
    check = checked_heights(surfaces, source, seed=seed, file=str(args.drive), most_beyond=0.02)
    return BuiltMap(surfaces=surfaces, links=roads.roads.links, remarks=[*remarks, check])


def driven_heights(track: RoadTrack, roads: DriveRoads, rng: np.random.Generator) -> SourceHeights:
    """Heights of the road under random positions of the track, as the file has them, with the link driven there."""
    rows = rng.integers(len(track), size=PLACES)
    place = track.latitude_rad[rows], track.longitude_rad[rows]
    plane = roads.frame.east_north_from_geodetic_array(*place, np.zeros(PLACES))
    samples = np.column_stack((roads.lines.east_north_m, _LEVEL_WEIGHT * roads.lines.height_m))
    at = np.column_stack((plane, _LEVEL_WEIGHT * track.road_height_m[rows]))
    parts = np.split(at, range(_AT_ONCE, PLACES, _AT_ONCE))
    nearest = np.concatenate(
        [np.argmin(((part[:, None, :] - samples) ** 2).sum(axis=2), axis=1) for part in parts]
    )
    links = roads.roads.links.link_id[roads.link_row[nearest]]
    return SourceHeights(
        latitude_rad=place[0],
        longitude_rad=place[1],
        height_m=track.road_height_m[rows],
        links=[[link] for link in links.tolist()],
        names=[f"position {row + 1}" for row in rows.tolist()],
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class DriveRoads:
    """The roads of a track in the plane of a frame, and what says how high they are."""

    roads: RoadCentreLines
    lines: RoadLines
    frame: LocalFrame
    heights: TrackHeights
    link_row: Integers
    """Row of the link of each of the lines' samples (k,)."""

    def lines_level(self) -> Integers:
        """Level of the link of each sample (k,)."""
        level: Integers = self.roads.links.level[self.link_row]
        return level

    def ground(self, latitude: Floats, longitude: Floats, row: Integers) -> tuple[Floats, Floats]:
        """As `surfaces_along` asks: of the level of the link that is asked for."""
        plane = self.frame.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)
        about_m = np.empty(len(plane))
        for link in np.unique(row).tolist():
            mine, samples = np.flatnonzero(row == link), np.flatnonzero(self.link_row == link)
            away = np.sum((plane[mine, None, :] - self.lines.east_north_m[samples]) ** 2, axis=2)
            about_m[mine] = self.lines.height_m[samples[np.argmin(away, axis=1)]]
        return self.heights.at(plane, about_m)


def drive_roads(track: RoadTrack, file: str, width_m: float, reach_m: float) -> DriveRoads:
    """Raises FormatError for a track that does not move."""
    frame = LocalFrame(float(np.median(track.latitude_rad)), float(np.median(track.longitude_rad)), 0.0)
    plane = frame.east_north_from_geodetic_array(
        track.latitude_rad, track.longitude_rad, 0.0 * track.latitude_rad
    )
    try:
        lines = road_lines(plane, track.road_height_m)
        links = coarse_links(lines, 0.0, np.random.default_rng(0))
    except ValueError as error:
        raise FormatError(file, "track", str(error)) from None
    moved = _moved(plane)
    heights = TrackHeights(
        plane_m=plane[moved],
        height_m=track.road_height_m[moved],
        sigma_m=track.sigma_m[moved],
        reach_m=reach_m,
        half_width_m=0.5 * width_m,
    )
    vertices = [
        np.column_stack(frame.geodetic_from_east_north_array(line, 0.0)[:2]) for line in links.vertices_m
    ]
    road_links = named_links("drive", vertices, level=links.level, sigma_m=_LINK_SIGMA_M)
    return DriveRoads(
        roads=RoadCentreLines(road_links, np.full(len(road_links), 0.5 * width_m)),
        lines=lines,
        frame=frame,
        heights=heights,
        link_row=links.link_of_sample - 1,
    )


def _moved(plane_m: Floats) -> Integers:
    """Rows of a track that are _STEP_M on from the one before: standing still is one position."""
    kept, last = [0], plane_m[0]
    for row in range(1, len(plane_m)):
        if math.hypot(*(plane_m[row] - last)) >= _STEP_M:
            kept.append(row)
            last = plane_m[row]
    return np.array(kept)


def _csv_track(args: argparse.Namespace) -> RoadTrack:
    truth = read_truth(args.drive, "camber")
    if args.antenna_height_m is None:
        raise FormatError(str(args.drive), "antenna", "--antenna-height-m: a truth.csv does not say it")
    if len(truth) < 2:
        raise FormatError(str(args.drive), "track", "at least two positions", actual=str(len(truth)))
    sigma = math.hypot(args.position_sigma_m, args.antenna_sigma_m)
    return RoadTrack(
        latitude_rad=truth.latitude_rad,
        longitude_rad=truth.longitude_rad,
        road_height_m=truth.height_m - args.antenna_height_m,
        sigma_m=np.full(len(truth), sigma),
        last_ns=int(truth.time_ns[-1]),
    )


def _replay_track(args: argparse.Namespace) -> RoadTrack:
    """Raises FormatError where nothing was confirmed, or the antenna's height is not known beside it."""
    path = args.drive / "recording.mcap" if args.drive.is_dir() else args.drive
    messages, _ = load_recording(path, ("verdict", "antenna_height"))
    heights = (m.message for m in messages["antenna_height"])
    antenna = [each for each in heights if each.way in _MAP_FREE and each.height_m is not None]
    antenna_ns = np.array([message.time_ns for message in antenna], np.int64)
    rows = []
    for verdict in (m.message for m in messages["verdict"]):
        if (
            verdict.verdict not in CONFIRMED_VERDICTS
            or verdict.latitude_rad is None
            or verdict.height_m is None
        ):
            continue
        height = _antenna_at(args, antenna, antenna_ns, verdict.time_ns)
        if height is None:
            continue
        covariance, road_m = verdict.covariance_enu_m2, verdict.height_m - height[0]
        up2 = args.position_sigma_m**2 if covariance is None else covariance[5]
        place = (verdict.latitude_rad, verdict.longitude_rad, road_m, math.sqrt(up2 + height[1] ** 2))
        rows.append((verdict.time_ns, *place))
    if len(rows) < 2:
        expected = "at least two confirmed positions with an antenna height that does not rest on the map"
        raise FormatError(str(path), "verdicts", expected, actual=str(len(rows)))
    columns = np.array(rows)
    latitude, longitude, height_m, sigma_m = columns[:, 1:].T
    return RoadTrack(
        latitude_rad=latitude,
        longitude_rad=longitude,
        road_height_m=height_m,
        sigma_m=sigma_m,
        last_ns=int(rows[-1][0]),
    )


def _antenna_at(
    args: argparse.Namespace, heights: list[AntennaHeight], times_ns: Integers, time_ns: int
) -> tuple[float, float] | None:
    """Height of the antenna above the road and its σ: as given, or the newest recorded, of at most a second before."""
    if args.antenna_height_m is not None:
        return args.antenna_height_m, args.antenna_sigma_m
    place = int(np.searchsorted(times_ns, time_ns, "right")) - 1
    if place < 0 or time_ns - int(times_ns[place]) > _HEIGHT_AGE_NS:
        return None
    newest = heights[place]
    assert newest.height_m is not None  # only such are kept
    return newest.height_m, args.antenna_sigma_m if newest.sigma_m is None else newest.sigma_m
