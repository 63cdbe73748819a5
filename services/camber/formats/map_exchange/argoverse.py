"""Read a log of Argoverse 2 (the sensor data set): poses, calibration, sweeps, ground height raster, lanes.

Frames, by the data set's own documents (github.com/argoverse/av2-api: guide/src/datasets/sensor.md and
src/av2/map/README.md): *egovehicle* has its origin at the middle of the rear axle, x forward, y left, z up; *city* is
flat metres, z up. A sweep holds the returns of two LiDARs, `up_lidar` and `down_lidar`, which is mounted upside down;
its points are deskewed to egovehicle at the sweep's time, which is the file's name. The raster has cells of 0.3 m,
counted from their corners, with heights in half precision: a resolution of 6 cm at 70 m.

Feather is read by nanoarrow, which comes with the extra `map` and is imported when a file is read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.geodesy.se3 import rigid_motion

Floats = NDArray[np.float64]

_MAGIC = b"ARROW1\0\0"  # of an Arrow file; what follows can be read as a stream
_POSE_COLUMNS = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_SWEEP_COLUMNS = ("x", "y", "z", "laser_number")


def read_feather(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Read columns (n,) without missing values of a Feather file (version 2): numbers, and texts as objects.

    Raises FormatError for an invalid file or a missing column, OSError if it cannot be read.
    """
    import nanoarrow
    from nanoarrow import ipc

    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise FormatError(path.name, "signature", "an Arrow file")
        try:
            table = nanoarrow.ArrayStream(ipc.InputStream.from_readable(file)).read_all()
            columns = {field.name: _column(table.child(k)) for k, field in enumerate(table.schema.fields)}
        except Exception as error:  # nanoarrow raises nearly anything for damaged files
            why = " ".join(str(error).split())[:120] or type(error).__name__
            raise FormatError(path.name, "Arrow", f"a whole file ({why})") from None
    missing = [name for name in names if name not in columns]
    if missing:
        raise FormatError(path.name, "columns", ", ".join(names), actual=", ".join(columns))
    return columns


def _column(array: Any) -> NDArray[Any]:
    if array.schema.type.name == "STRING":
        return np.array(array.to_pylist(), object)
    return np.concatenate([np.asarray(part.buffer(1)) for part in array.iter_chunks()])


@dataclass(frozen=True, eq=False, kw_only=True)
class LidarSweep:
    """Points (n, 3) [m] in egovehicle, numbers of their lasers (n,), and where egovehicle was (4, 4)."""

    time_ns: int
    points_m: Floats
    laser: NDArray[np.uint8]
    city_from_egovehicle: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundRaster:
    """Heights (rows, columns) [m], NaN beyond the roads; cell (0, 0) begins at `corner_m` (2,) in city."""

    height_m: Floats
    corner_m: Floats
    cell_m: float

    def height(self, city_m: Floats) -> Floats:
        """Return the height (n,) of the cell of each place (n, 2 or 3); NaN if unknown."""
        column, row = np.floor((city_m[:, :2] - self.corner_m) / self.cell_m).astype(np.int64).T
        rows, columns = self.height_m.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return np.where(inside, self.height_m[row * inside, column * inside], np.nan)

    def height_between(self, city_m: Floats) -> Floats:
        """Interpolate bilinearly between cell centres (n,); NaN if one of the four is unknown."""
        at = (city_m[:, :2] - self.corner_m) / self.cell_m - 0.5
        first = np.floor(at).astype(np.int64)
        rows, columns = self.height_m.shape
        inside = (first >= 0).all(axis=1) & (first[:, 0] < columns - 1) & (first[:, 1] < rows - 1)
        column, row = np.where(inside[:, None], first, 0).T
        u, v = (at - first).T
        h = self.height_m
        lower = (1.0 - u) * h[row, column] + u * h[row, column + 1]
        upper = (1.0 - u) * h[row + 1, column] + u * h[row + 1, column + 1]
        return np.where(inside, (1.0 - v) * lower + v * upper, np.nan)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaneSegment:
    """A lane segment; boundaries (k, 3) in city, in the direction of travel, of any number of points."""

    lane_id: int
    kind: str
    left_m: Floats
    right_m: Floats
    successors: tuple[int, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class ArgoverseLog:
    """Contents of a log; `egovehicle_from_sensor` (4, 4) by name, empty without a calibration."""

    city: str
    """The abbreviation in the names of the files of its map, e.g. PIT."""
    time_ns: NDArray[np.int64]
    city_from_egovehicle: Floats
    """(n, 4, 4) at `time_ns`."""
    egovehicle_from_sensor: dict[str, Floats]
    ground: GroundRaster
    lanes: tuple[LaneSegment, ...]
    sweeps: tuple[LidarSweep, ...]


def read_log(folder: Path) -> ArgoverseLog:
    """Read a log's folder. Raises FormatError for invalid contents, OSError for a missing file."""
    poses = read_feather(folder / "city_SE3_egovehicle.feather", ("timestamp_ns", *_POSE_COLUMNS))
    time_ns, motions = poses["timestamp_ns"], _motions(poses, "city_SE3_egovehicle.feather")
    calibration = folder / "calibration" / "egovehicle_SE3_sensor.feather"
    sensors: dict[str, Floats] = {}
    if calibration.exists():
        columns = read_feather(calibration, ("sensor_name", *_POSE_COLUMNS))
        sensors = dict(zip(columns["sensor_name"], _motions(columns, calibration.name), strict=True))
    sweeps = []
    for path in sorted((folder / "sensors" / "lidar").glob("*.feather")):
        columns = read_feather(path, _SWEEP_COLUMNS)
        at = np.flatnonzero(time_ns == (int(path.stem) if path.stem.isdecimal() else -1))
        if len(at) != 1:
            raise FormatError(path.name, "name", "the time of one of the poses in ns")
        points_m = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
        sweeps.append(
            LidarSweep(
                time_ns=int(path.stem),
                points_m=points_m,
                laser=columns["laser_number"],
                city_from_egovehicle=motions[at[0]],
            )
        )
    raster = _only(folder / "map", "*_ground_height_surface____*.npy")
    city = raster.stem.rsplit("____", 1)[1]
    return ArgoverseLog(
        city=city,
        time_ns=time_ns,
        city_from_egovehicle=motions,
        egovehicle_from_sensor=sensors,
        ground=_ground(raster),
        lanes=_lanes(folder / "map"),
        sweeps=tuple(sweeps),
    )


def _motions(columns: Mapping[str, NDArray[Any]], source_name: str) -> Floats:
    """Convert rows of unit quaternions and translations to poses (n, 4, 4)."""
    w, x, y, z = (columns[name] for name in _POSE_COLUMNS[:4])
    rotations = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    places = np.column_stack([columns[name] for name in _POSE_COLUMNS[4:]])
    try:
        return np.array([rigid_motion(r, t) for r, t in zip(rotations, places, strict=True)])
    except ValueError as error:
        raise FormatError(source_name, "poses", f"rigid motions ({error})") from None


def _ground(path: Path) -> GroundRaster:
    """Read the raster and its `Sim2`: array = s (R city + t), where R is the identity in all logs."""
    similarity = _only(path.parent, "*___img_Sim2_city.json")
    sim2 = _read_json(similarity)
    try:
        turn, shift, scale = sim2["R"], np.array(sim2["t"], np.float64), float(sim2["s"])
        heights = np.load(path, allow_pickle=False).astype(np.float64)
    except (KeyError, TypeError, ValueError, EOFError) as error:
        raise FormatError(path.name, "raster", f"heights, and R, t, s of their position ({error})") from None
    if turn != [1.0, 0.0, 0.0, 1.0] or shift.shape != (2,) or not scale > 0.0 or heights.ndim != 2:
        expected = "R the identity, t of two numbers, s above 0 and a raster of two axes"
        raise FormatError(similarity.name, "R, t, s", expected, actual=str(sim2))
    return GroundRaster(height_m=heights, corner_m=-shift, cell_m=1.0 / scale)


def _lanes(folder: Path) -> tuple[LaneSegment, ...]:
    path = _only(folder, "log_map_archive_*.json")
    try:
        segments = _read_json(path)["lane_segments"]
        return tuple(
            LaneSegment(
                lane_id=int(lane["id"]),
                kind=str(lane["lane_type"]),
                left_m=_line(lane["left_lane_boundary"]),
                right_m=_line(lane["right_lane_boundary"]),
                successors=tuple(int(other) for other in lane["successors"]),
            )
            for _, lane in sorted(segments.items(), key=lambda item: int(item[0]))
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        why = " ".join(f"{type(error).__name__} {error}".split())
        raise FormatError(path.name, "lane_segments", f"lanes with their boundaries ({why})") from None


def _line(points: Any) -> Floats:
    line = np.array([[point[axis] for axis in "xyz"] for point in points], np.float64)
    if line.ndim != 2 or len(line) < 2 or not np.isfinite(line).all():
        raise ValueError("a boundary of less than two points")
    return line


def _only(folder: Path, pattern: str) -> Path:
    paths = sorted(folder.glob(pattern))
    if len(paths) != 1:
        raise FormatError(str(folder), "files", f"one {pattern}", actual=f"{len(paths)} of them")
    return paths[0]


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise FormatError(path.name, "JSON", f"a whole file ({error})") from None
