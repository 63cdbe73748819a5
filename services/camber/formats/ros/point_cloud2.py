"""sensor_msgs/PointCloud2 as a sweep: any layout of fields, and the times of points as makers' drivers give them.

Source: sensor_msgs/msg/PointCloud2.msg and PointField.msg; the fields of time are in `TIME_FIELDS`. Points are in the
order of time. Those that were not measured are left out: a coordinate is no number or far beyond any sensor, or all
three are zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.ros.livox_points import LIVOX_TYPES, point_cloud2_of_livox
from camber.formats.ros.message_types import gps_time_ns, stamp_unix_ns
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.schemas.base import Float32, Int64
from camber.schemas.lidar import Sweep

POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
CLOUD_TYPES = (POINT_CLOUD2, *LIVOX_TYPES)

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8", 9: "i8", 10: "u8"}
"""numpy's codes of PointField's constants; the last two are of Lyrical."""
_MOST_POINTS = 20_000_000  # chosen: beyond any sensor's sweep, so that damage does not fill the memory
_MOST_POINT_BYTES = 65_536  # chosen: as for that
_FARTHEST_M = 1e5  # chosen: beyond any sensor, so that no sum of coordinates overflows
_FARTHEST_NS = 1_000_000_000
"""Chosen: a stamp is that of a sweep's begin or end, and no sweep takes longer (`sensors.sweep_assembly`)."""
_NANOSECONDS_FROM = 1e14
"""Chosen: absolute times are Unix time, 1.7e9 in seconds and 1.7e18 in nanoseconds; this is between them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointTimeField:
    """A field with the time of each point: `unit_ns` after the message's stamp, or absolute Unix time."""

    name: str
    datatype: Literal["u4", "f4", "f8"]
    unit_ns: float | None
    makers: str


TIME_FIELDS = (
    PointTimeField(name="t", datatype="u4", unit_ns=1.0, makers="Ouster"),
    PointTimeField(name="time", datatype="f4", unit_ns=1e9, makers="Velodyne"),
    PointTimeField(name="timestamp", datatype="f8", unit_ns=None, makers="Hesai, RoboSense (s), Livox (ns)"),
    PointTimeField(name="offset_time", datatype="u4", unit_ns=1.0, makers="Livox"),
    PointTimeField(name="time_stamp", datatype="u4", unit_ns=1.0, makers="Autoware's Nebula"),
)
"""Of the makers' ROS drivers: ouster-ros, velodyne_pointcloud, HesaiLidar_ROS_2.0, rslidar_sdk, livox_ros_driver2 and
Nebula (PointXYZIRCAEDT). Absolute times (`unit_ns` None) are in seconds or nanoseconds, by their size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLayout:
    """Where the fields of a point are that a sweep is made of. `time` None: `no_time` says why.

    Without times of points a sweep cannot be de-skewed.
    """

    row: np.dtype[Any]
    time: PointTimeField | None
    no_time: str


def point_cloud2(message: Any, kind: str) -> Any:
    """Return a message of one of `CLOUD_TYPES` as a PointCloud2."""
    return message if kind == POINT_CLOUD2 else point_cloud2_of_livox(message)


def point_layout(message: Any, topic: str) -> PointLayout:
    """Return the layout of a PointCloud2. Raises FormatError for one that cannot be read."""
    order, step = (">" if message.is_bigendian else "<"), int(message.point_step)
    if step > _MOST_POINT_BYTES:
        raise FormatError(topic, "point_step", f"at most {_MOST_POINT_BYTES} bytes", actual=str(step))
    formats: dict[str, str] = {}
    offsets: dict[str, int] = {}
    for field in message.fields:
        kind = _DATATYPES.get(int(field.datatype))
        if field.name in formats or kind is None or int(field.count) > 1:
            continue  # what a sweep needs is one number a point
        formats[field.name], offsets[field.name] = order + kind, int(field.offset)
        if offsets[field.name] + np.dtype(kind).itemsize > step:
            raise FormatError(topic, f"fields.{field.name[:40]!r}", f"an offset within point_step {step}")
    if missing := [axis for axis in "xyz" if axis not in formats]:
        raise FormatError(topic, "fields", f"x, y and z, but there is no {', '.join(missing)}")
    time, no_time = _time_field({name: kind[1:] for name, kind in formats.items()})
    names = ("x", "y", "z", *(name for name in ("intensity",) if name in formats))
    names += () if time is None else (time.name,)
    row = np.dtype(
        {
            "names": names,
            "formats": [formats[name] for name in names],
            "offsets": [offsets[name] for name in names],
            "itemsize": step,
        }
    )
    return PointLayout(row=row, time=time, no_time=no_time)


# What is beyond a type or no number is left out or refused.
@np.errstate(over="ignore", invalid="ignore")
def sweep_from_point_cloud2(
    message: Any, layout: PointLayout, topic: str, sensor: str, *, ahead_ns: int = 0
) -> Sweep:
    """Return the sweep of a PointCloud2 with such a layout, in the sensor's frame.

    `ahead_ns`: Unix time less the time of stamps. Without times of points the message's stamp is the sweep's end and
    all offsets are zero. Raises FormatError for a damaged message, one without points, and one whose points are a
    second or more off its stamp.
    """
    points = _points(message, layout.row, topic)
    xyz = np.column_stack([points[axis] for axis in "xyz"]).astype(np.float32)
    measured = (np.abs(xyz) <= _FARTHEST_M).all(axis=1) & xyz.any(axis=1)
    if layout.time is not None:
        measured &= np.isfinite(points[layout.time.name])
    if not measured.any():
        raise FormatError(topic, "data", "at least one measured point")
    points, xyz = points[measured], xyz[measured]
    stamp_ns = stamp_unix_ns(message)
    at_ns = _point_times(points, layout, stamp_ns, topic)
    order = np.argsort(at_ns, kind="stable")
    intensity = _intensity(points)
    end_ns = int(at_ns[order[-1]])
    return Sweep(
        time_ns=gps_time_ns(stamp_ns + end_ns + ahead_ns, topic),
        sensor=sensor,
        points_m=xyz[order],
        intensity=intensity[order],
        offset_ns=(at_ns[order] - end_ns).astype(np.int32),
    )


def _time_field(kinds: dict[str, str]) -> tuple[PointTimeField | None, str]:
    other = ""
    for field in TIME_FIELDS:
        kind = kinds.get(field.name)
        if kind == field.datatype:
            return field, ""
        if kind is not None:
            names = np.dtype(kind).name, np.dtype(field.datatype).name
            other = f"field {field.name} is {names[0]}, expected {names[1]} as of {field.makers}"
    return None, other or f"none of the fields {', '.join(field.name for field in TIME_FIELDS)}"


def _points(message: Any, row: np.dtype[Any], topic: str) -> NDArray[Any]:
    """Rows (n,) of all points, organised or not."""
    height, width, step = int(message.height), int(message.width), int(message.row_step)
    count, data = height * width, np.ascontiguousarray(message.data, dtype=np.uint8)
    if not 0 < count <= _MOST_POINTS:
        raise FormatError(topic, "height × width", f"1 to {_MOST_POINTS} points", actual=str(count))
    needed = (height - 1) * step + width * row.itemsize
    if (height > 1 and step < width * row.itemsize) or len(data) < needed:
        expected = f"row_step {step} of at least {width} points of {row.itemsize} bytes, and {needed} bytes"
        raise FormatError(topic, "data", expected, actual=f"{len(data)} bytes")
    return np.ndarray((height, width), row, data.data, strides=(step, row.itemsize)).reshape(-1)


def _intensity(points: NDArray[Any]) -> Float32:
    """Intensities (n,), zero where there are none or they are not finite."""
    if "intensity" not in (points.dtype.names or ()):
        return np.zeros(len(points), np.float32)
    values = points["intensity"].astype(np.float32)
    return np.where(np.isfinite(values), values, np.float32(0.0))


def _point_times(points: NDArray[Any], layout: PointLayout, stamp_ns: int, topic: str) -> Int64:
    """Nanoseconds (n,) of each point after the message's stamp."""
    if layout.time is None:
        return np.zeros(len(points), np.int64)
    # Far beyond any date, so that sums stay finite.
    values = points[layout.time.name].astype(np.float64).clip(-1e19, 1e19)
    if layout.time.unit_ns is not None:
        after_ns = values * layout.time.unit_ns
    else:
        unit_ns = 1 if float(np.abs(values).max()) >= _NANOSECONDS_FROM else NS_PER_SECOND
        whole = math.floor(values.min())  # the difference of large times in integers, which lose nothing
        after_ns = (values - whole) * unit_ns + float(whole * unit_ns - stamp_ns)
    farthest = float(after_ns[np.argmax(np.abs(after_ns))])
    if abs(farthest) > _FARTHEST_NS:
        expected = f"times of points within {_FARTHEST_NS / 1e9:g} s of header.stamp"
        raise FormatError(topic, layout.time.name, expected, actual=f"{farthest / 1e9:.3f} s off")
    return np.rint(after_ns).astype(np.int64)
