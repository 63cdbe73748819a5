"""`camber map build clouds`: LAS, LAZ, PCD or PLY clouds and where the vehicle went become roads and clouds of a map.

The clouds are in a reference system that they name (LAS), or in metres east, north and up of --origin. With --sweeps
each is in the sensor's own frame, the k-th (or the one named after its time) at the k-th of the poses.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import read_truth
from camber.formats.errors import FormatError
from camber.formats.map_exchange.las import read_las
from camber.formats.map_exchange.pcd import cloud_from_pcd, read_header, sweep_time_ns
from camber.formats.map_exchange.ply import read_ply
from camber.formats.map_exchange.vertical_datum import ELLIPSOIDAL, VerticalDatum, crs_of
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import map_from_vehicle, transform_points
from camber.replay.truth_interpolation import interpolate_truth
from camber.road_map.cloud_tiles import cloud_tiles, first_of_voxels
from camber.tools.maps.importers import ground_points
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.height_options import add_height_arguments, sigma_of, vertical_of
from camber.tools.maps.importers.height_raster import horizontal_and_vertical, to_horizontal
from camber.tools.maps.importers.surfaces_along import Floats, Integers, surfaces_along
from camber.tools.maps.importers.survey_drive import DriveRoads, RoadTrack, drive_roads
from camber.tools.options.number_options import HEIGHT, LATITUDE, LONGITUDE, each_of, number_from
from camber.tools.options.parsers import add_with_default
from camber.tools.options.progress_display import ProgressDisplay

_REACH_M = 4.0  # chosen: as the default of --reach-m in `survey_drive`


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only clouds need."""
    add = parser.add_argument
    add("files", type=Path, nargs="+", metavar="CLOUD", help=".las, .laz, .pcd, .ply; or folders of them")
    text = "where the vehicle went: a truth.csv, or rows of 12 numbers, 3 × 4 from the poses' frame to --origin's"
    add("--poses", type=Path, required=True, metavar="FILE", help=text)
    above_m = number_from(0.0, 20.0, "m")
    add("--above-road-m", type=above_m, required=True, metavar="H", help="of what the poses are of")
    add("--sweeps", action="store_true", help="each cloud is a sweep in the sensor's own frame")
    bounds = each_of(*[number_from(-50.0, 50.0, "m")] * 3, *[number_from(-360.0, 360.0, "°")] * 3)
    names = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")
    text = "with --sweeps: where the sensor is in the poses' frame, metres and degrees (default: at it)"
    add("--sensor", nargs=6, action=bounds, default=(0.0,) * 6, metavar=names, help=text)
    place = each_of(LATITUDE, LONGITUDE, HEIGHT)
    text = "degrees, metres above the ellipsoid: of clouds and poses that name no reference system"
    add("--origin", nargs=3, action=place, metavar=("LAT", "LON", "H"), help=text)
    for name, default, (least, most), text in (
        ("--width-m", 6.0, (1.0, 40.0), "of the road"),
        ("--spacing-m", 0.5, (0.1, 5.0), "of heights"),
        ("--voxel-m", 0.1, (0.02, 1.0), "of the clouds"),
    ):
        add_with_default(parser, name, default, text, type=number_from(least, most, "m"), metavar="D")
    add_height_arguments(parser)


def build(args: argparse.Namespace) -> BuiltMap:
    """Surfaces where the road's points are, and two clouds: the road's, and all else."""
    ground_points.open3d()  # before minutes of reading
    poses = Poses.read(args)
    roads = drive_roads(poses.track(args.above_road_m), str(args.poses), args.width_m, _REACH_M)
    vertical: VerticalDatum | None = None
    parts, files = [], _files(args.files)
    with ProgressDisplay(len(files), "cloud") as display:
        for number, path in enumerate(files):
            points_m, conversion = _placed(path, (number, len(files)), poses, frame=roads.frame, args=args)
            vertical = conversion or vertical
            parts.append(ground_points.thinned(points_m, args.voxel_m) if len(points_m) else points_m)
            display.advance()
    points_m = ground_points.thinned(np.concatenate(parts), args.voxel_m)
    if not len(points_m):
        raise FormatError(str(args.files[0]), "points", "at least one")
    level = ground_points.levels_of_ground(points_m, _path(roads), roads.lines_level(), 0.5 * args.width_m)
    on_road = level != ground_points.NO_ROAD
    heights = ground_points.GroundHeights.of(points_m[on_road], level[on_road], args.spacing_m)
    sigma_m = args.sigma_m if vertical is None else sigma_of(args, vertical)

    def ground(latitude: Floats, longitude: Floats, row: Integers) -> tuple[Floats, Floats]:
        plane = roads.frame.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)
        height_m, off_m = heights.at(plane, roads.roads.links.level[row])
        return height_m, np.hypot(off_m, sigma_m)

    surfaces = surfaces_along(
        roads.roads, ground, spacing_m=args.spacing_m, seen_ns=args.surveyed_ns, vehicles=1
    )
    if not len(surfaces):
        expected = "a road's under the poses: are --above-road-m, --origin and --sensor right?"
        raise FormatError(str(args.files[0]), "points", expected)
    tiles = []
    for layer, mine in (("environment_cloud", ~on_road), ("road_cloud", on_road)):
        kept = points_m[mine]
        tiles += cloud_tiles(kept[first_of_voxels(kept, args.voxel_m)], roads.frame, layer, args.surveyed_ns)  # type: ignore[arg-type]
    how = "" if vertical is None else f"; heights: {vertical.how}"
    remark = f"{len(files)} clouds, {len(points_m)} points, {int(on_road.sum())} of them road{how}"
    return BuiltMap(
        surfaces=surfaces,
        links=roads.roads.links,
        clouds=tiles,
        surrogate="" if vertical is None else vertical.surrogate,
        remarks=[remark],
    )


def _path(roads: DriveRoads) -> Floats:
    return np.column_stack((roads.lines.east_north_m, roads.lines.height_m))


def _files(paths: list[Path]) -> list[Path]:
    """The clouds themselves, those of a folder by name. Raises FormatError for a folder without any."""
    clouds: list[Path] = []
    for path in paths:
        listed = [path]
        if path.is_dir():
            listed = sorted(each for each in path.iterdir() if each.suffix.lower() in _READERS)
        if not listed:
            raise FormatError(str(path), "folder", f"clouds: {', '.join(_READERS)}")
        clouds += listed
    return clouds


@dataclass(frozen=True, eq=False, kw_only=True)
class Poses:
    """Poses (n, 4, 4) in the tangent frame `frame`, east, north, up; `time_ns` (n,) where they have times."""

    file: str
    frame: LocalFrame
    frame_from_pose: Floats
    time_ns: Integers | None
    truth: Any = None

    @classmethod
    def read(cls, args: argparse.Namespace) -> Poses:
        """Raises FormatError for what is neither a truth.csv nor rows of 12 numbers with an --origin."""
        file = str(args.poses)
        with args.poses.open(encoding="utf-8", errors="replace") as stream:
            has_times = stream.readline().startswith("time_ns,")
        if has_times:
            truth = read_truth(args.poses, "camber")
            if not len(truth):
                raise FormatError(file, "poses", "at least two")
            place = [float(np.median(a)) for a in (truth.latitude_rad, truth.longitude_rad, truth.height_m)]
            frame = LocalFrame(*place)
            poses = _matrices(truth, frame)
            return cls(file=file, frame=frame, frame_from_pose=poses, time_ns=truth.time_ns, truth=truth)
        if args.origin is None:
            raise FormatError(file, "poses", "--origin LAT LON H, to which they are")
        frame = _at(args.origin)
        try:
            rows = np.loadtxt(_numbers(args.poses), ndmin=2)
        except ValueError as error:
            why = " ".join(str(error).split())[:80]
            raise FormatError(file, "poses", f"rows of 12 numbers ({why})") from None
        if rows.shape[1:] != (12,) or len(rows) < 2 or not np.isfinite(rows).all():
            raise FormatError(file, "poses", "two rows of 12 numbers or more", actual=f"{rows.shape}")
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        poses[:, :3] = rows.reshape(-1, 3, 4)
        return cls(file=file, frame=frame, frame_from_pose=poses, time_ns=None)

    def track(self, above_road_m: float) -> RoadTrack:
        """The road under the poses: as far below each as its own up says."""
        below = self.frame_from_pose[:, :3, 3] - above_road_m * self.frame_from_pose[:, :3, 2]
        latitude, longitude, height_m = self.frame.geodetic_from_enu_array(below)
        last_ns = 0 if self.time_ns is None else int(self.time_ns[-1])
        return RoadTrack(
            latitude_rad=latitude,
            longitude_rad=longitude,
            road_height_m=height_m,
            sigma_m=np.full(len(below), 0.05),
            last_ns=last_ns,
        )

    def of_sweep(self, path: Path, number: int, count: int) -> Floats:
        """The pose (4, 4) of a sweep: at the time in its name, or of its number. Raises FormatError where none is."""
        if self.truth is not None:
            table, known = interpolate_truth(self.truth, np.array([sweep_time_ns(path)]))
            if not known[0]:
                raise FormatError(path.name, "time", f"within the poses of {self.file}")
            pose: Floats = _matrices(table, self.frame)[0]
            return pose
        if count != len(self.frame_from_pose):
            expected = f"as many poses as sweeps, {count}"
            raise FormatError(self.file, "poses", expected, actual=str(len(self.frame_from_pose)))
        numbered: Floats = self.frame_from_pose[number]
        return numbered


def _matrices(truth: Any, frame: LocalFrame) -> Floats:
    enu = frame.enu_from_geodetic_array(truth.latitude_rad, truth.longitude_rad, truth.height_m)
    attitude = np.column_stack((truth.roll_rad, truth.pitch_rad, truth.yaw_rad))
    rows = np.column_stack((enu, attitude)).tolist()
    return np.array([map_from_vehicle(*row) for row in rows])


def _numbers(path: Path) -> list[str]:
    lines = path.read_text("utf-8", "replace").replace(",", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


def _placed(
    path: Path, place: tuple[int, int], poses: Poses, *, frame: LocalFrame, args: argparse.Namespace
) -> tuple[Floats, VerticalDatum | None]:
    """Points (n, 3): east, north in the plane of `frame` and ellipsoidal height; what made them that, for LAS.

    `place`: number of the cloud, and how many there are.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise FormatError(str(path), "name", f"one of {', '.join(_READERS)}")
    points, crs_wkt = reader(path)
    if not len(points):
        return np.zeros((0, 3)), None
    vertical = None
    if args.sweeps:
        x, y, z, *angles = args.sensor
        pose_from_sensor = map_from_vehicle(x, y, z, *map(math.radians, angles))
        placed = transform_points(poses.of_sweep(path, *place) @ pose_from_sensor, points)
        latitude, longitude, height_m = poses.frame.geodetic_from_enu_array(placed)
    elif crs_wkt is not None:
        crs = crs_of(crs_wkt, str(path), "CRS", "one that PROJ knows")
        horizontal, stated = horizontal_and_vertical(crs, str(path))
        vertical = vertical_of(args, str(path), stated)
        transformer = to_horizontal(horizontal, args.datum, str(path))
        places_deg = transformer.transform(points[:, 0], points[:, 1], direction="INVERSE")
        longitude, latitude = np.radians(places_deg)
        if not np.isfinite(latitude).all():
            raise FormatError(str(path), "x y", "places within the reference system that the file names")
        height_m = vertical.ellipsoidal_m(latitude, longitude, points[:, 2], str(path))
    elif args.origin is not None:
        if args.vertical_datum not in (None, ELLIPSOIDAL):
            raise FormatError(str(path), "--vertical-datum", "ellipsoidal: --origin's height is that")
        latitude, longitude, height_m = _at(args.origin).geodetic_from_enu_array(points)
    else:
        raise FormatError(str(path), "place", "--origin LAT LON H, to which its metres are")
    plane = frame.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)
    return np.column_stack((plane, height_m)), vertical


def _at(origin: tuple[float, float, float]) -> LocalFrame:
    latitude_deg, longitude_deg, height_m = origin
    return LocalFrame(math.radians(latitude_deg), math.radians(longitude_deg), height_m)


def _las(path: Path) -> tuple[Floats, str | None]:
    cloud = read_las(path)
    return cloud.points, cloud.crs_wkt


def _pcd(path: Path) -> tuple[Floats, str | None]:
    data = path.read_bytes()
    header = read_header(data, path.name)
    if header.data == "binary":
        # Some writers fill the file up to a page; what is missing is still found.
        data = data[: header.begin + header.row().itemsize * header.points]
    return cloud_from_pcd(data, path.name).points_m.astype(np.float64), None


def _ply(path: Path) -> tuple[Floats, str | None]:
    return read_ply(path), None


_READERS = {".las": _las, ".laz": _las, ".pcd": _pcd, ".ply": _ply}
