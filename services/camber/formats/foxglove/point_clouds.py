"""Sweeps as point clouds of Foxglove, and back: x, y, z and intensity as float32, `offset_ns` as int32.

The frame is the sensor's name. GPS time is made of the cloud's Unix time: exact but within a leap second.
"""

from __future__ import annotations

import numpy as np

from camber.formats.foxglove.protobuf import ProtobufError, decode, encode
from camber.geodesy.gps_time import NS_PER_SECOND, gps_ns_from_unix_ns, unix_ns_from_gps_ns
from camber.schemas.codec import DecodeError, validate
from camber.schemas.lidar import Sweep

_POINT = np.dtype([("xyz", "<f4", 3), ("intensity", "<f4"), ("offset_ns", "<i4")])
_INT32, _FLOAT32 = 6, 7  # of PackedElementField
_FIELDS = [
    {"name": name, "offset": 4 * nth, "type": _INT32 if name == "offset_ns" else _FLOAT32}
    for nth, name in enumerate(("x", "y", "z", "intensity", "offset_ns"))
]


def cloud_from_sweep(sweep: Sweep) -> bytes:
    """Return a PointCloud of all points of a sweep."""
    points = np.empty(len(sweep.points_m), _POINT)
    points["xyz"], points["intensity"], points["offset_ns"] = sweep.points_m, sweep.intensity, sweep.offset_ns
    seconds, nanos = divmod(unix_ns_from_gps_ns(sweep.time_ns), NS_PER_SECOND)
    values = {
        "timestamp": {"seconds": seconds, "nanos": nanos},
        "frame_id": sweep.sensor,
        "pose": {"position": {}, "orientation": {"w": 1.0}},
        "point_stride": _POINT.itemsize,
        "fields": _FIELDS,
        "data": points.tobytes(),
    }
    return encode("PointCloud", values)


def sweep_from_cloud(data: bytes) -> Sweep:
    """Return the sweep that `cloud_from_sweep` has written; raises DecodeError and nothing else."""
    try:
        cloud = decode("PointCloud", data)
        described = [{**field, "offset": field.get("offset", 0)} for field in cloud.get("fields", ())]
        if cloud.get("point_stride") != _POINT.itemsize or described != _FIELDS:
            raise DecodeError("a point cloud that is no sweep of Camber")
        points = np.frombuffer(cloud.get("data", b""), _POINT)
        timestamp = cloud.get("timestamp", {})
        unix_ns = timestamp.get("seconds", 0) * NS_PER_SECOND + timestamp.get("nanos", 0)
        time_ns = gps_ns_from_unix_ns(unix_ns)
    except (ProtobufError, ValueError, OverflowError) as error:
        raise DecodeError(f"Sweep: {error}"[:300]) from None
    fields = {
        "time_ns": time_ns,
        "sensor": cloud.get("frame_id", ""),
        "points_m": points["xyz"].copy(),
        "intensity": points["intensity"].copy(),
        "offset_ns": points["offset_ns"].copy(),
    }
    return validate(Sweep, fields)
