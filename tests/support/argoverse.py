"""A log of Argoverse 2 (the sensor data set): poses, calibration, sweeps, and the raster of the ground's height.

Frames, by the data set's own documents (github.com/argoverse/av2-api: guide/src/datasets/sensor.md and
src/av2/map/README.md): *egovehicle* has its origin at the middle of the rear axle, x forward, y left, z up; *city* is
flat metres, z up. A sweep holds the returns of two LiDARs, `up_lidar` and `down_lidar`, which hangs upside down; its
points are in egovehicle already, moved to the pose of the sweep's time, which is the file's name. The raster has cells
of 0.3 m, each counting from its corner; a height is kept in half precision, which at 70 m is a grid of 6 cm.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nanoarrow
import numpy as np
from nanoarrow import ipc
from numpy.typing import NDArray

from camber.geodesy.se3 import rigid_motion

Floats = NDArray[np.float64]

_MAGIC = b"ARROW1\0\0"  # of an Arrow file; what follows can be read as a stream
_UP_LASERS = 32  # of 64: the first belong to up_lidar


def read_feather(path: Path) -> dict[str, NDArray[Any]]:
    """The columns (n,) of a Feather file (version 2) without gaps: numbers, and texts as objects."""
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError(f"{path.name}: expected an Arrow file")
        table = nanoarrow.ArrayStream(ipc.InputStream.from_readable(file)).read_all()
    return {field.name: _column(table.child(k)) for k, field in enumerate(table.schema.fields)}


def _column(array: nanoarrow.Array) -> NDArray[Any]:
    if array.schema.type is nanoarrow.Type.STRING:
        return np.array(array.to_pylist(), object)
    return np.concatenate([np.asarray(part.buffer(1)) for part in array.iter_chunks()])


@dataclass(frozen=True, eq=False)
class LidarSweep:
    """Points (n, 3) [m] in egovehicle, numbers of their lasers (n,), and where egovehicle was (4, 4)."""

    time_ns: int
    points_m: Floats
    laser: NDArray[np.uint8]
    city_from_egovehicle: Floats

    def of_sensor(self, name: str) -> NDArray[np.bool_]:
        """Which points (n,) are of `up_lidar` or `down_lidar`."""
        return (self.laser < _UP_LASERS) == (name == "up_lidar")


@dataclass(frozen=True, eq=False)
class GroundRaster:
    """Heights (rows, columns) [m], NaN beyond the roads; cell (0, 0) begins at `corner_m` (2,) in city."""

    height_m: Floats
    corner_m: Floats
    cell_m: float

    def height(self, city_m: Floats) -> Floats:
        """Of the cell that each place (n, 2 or 3) is in (n,); NaN where none is known."""
        column, row = np.floor((city_m[:, :2] - self.corner_m) / self.cell_m).astype(np.int64).T
        rows, columns = self.height_m.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        found = self.height_m[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, found, np.nan)

    def points_near(self, city_m: Floats, reach_m: float) -> Floats:
        """Middles of the cells within a square around a place: (n, 3) in city, only those with a height."""
        rows, columns = np.nonzero(np.isfinite(self.height_m))
        places = self.corner_m + self.cell_m * (np.column_stack((columns, rows)) + 0.5)
        near = (np.abs(places - city_m[:2]) < reach_m).all(axis=1)
        return np.column_stack((places[near], self.height_m[rows[near], columns[near]]))


@dataclass(frozen=True, eq=False)
class ArgoverseLog:
    """What of a log is at hand; `egovehicle_from_sensor` by name (4, 4), empty where there is no calibration."""

    time_ns: NDArray[np.int64]
    city_from_egovehicle: Floats
    """(n, 4, 4) at `time_ns`."""
    egovehicle_from_sensor: dict[str, Floats]
    ground: GroundRaster
    sweeps: tuple[LidarSweep, ...]


def read_log(folder: Path) -> ArgoverseLog:
    """Read a log's folder."""
    poses = read_feather(folder / "city_SE3_egovehicle.feather")
    time_ns, motions = poses["timestamp_ns"], _motions(poses)
    calibration = folder / "calibration" / "egovehicle_SE3_sensor.feather"
    sensors: dict[str, Floats] = {}
    if calibration.exists():
        found = read_feather(calibration)
        sensors = dict(zip(found["sensor_name"], _motions(found), strict=True))
    sweeps = []
    for path in sorted((folder / "sensors" / "lidar").glob("*.feather")):
        columns = read_feather(path)
        (at,) = np.flatnonzero(time_ns == int(path.stem)).tolist()
        points_m = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
        sweeps.append(LidarSweep(int(path.stem), points_m, columns["laser_number"], motions[at]))
    return ArgoverseLog(time_ns, motions, sensors, _ground(folder / "map"), tuple(sweeps))


def _motions(columns: dict[str, NDArray[Any]]) -> Floats:
    """Unit quaternions qw, qx, qy, qz and translations of rows, as (n, 4, 4)."""
    w, x, y, z = (columns[name] for name in ("qw", "qx", "qy", "qz"))
    rotations = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    places = np.column_stack([columns[name] for name in ("tx_m", "ty_m", "tz_m")])
    return np.array([rigid_motion(r, t) for r, t in zip(rotations, places, strict=True)])


def _ground(folder: Path) -> GroundRaster:
    """Raster and `Sim2`: array = scale (R city + t), and R is the identity in all logs."""
    (raster,) = folder.glob("*_ground_height_surface____*.npy")
    (similarity,) = folder.glob("*___img_Sim2_city.json")
    said = json.loads(similarity.read_text())
    if said["R"] != [1.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"{similarity.name}: R is {said['R']}, expected the identity")
    return GroundRaster(np.load(raster).astype(np.float64), -np.array(said["t"]), 1.0 / said["s"])
