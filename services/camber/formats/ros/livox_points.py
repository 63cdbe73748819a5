"""livox_ros_driver2's CustomMsg as a PointCloud2: both hold the same points.

Source: livox_ros_driver2, CustomMsg.msg and CustomPoint.msg; livox_ros_driver has the same fields. `offset_time` is in
nanoseconds after `timebase`, which the driver also gives as the message's stamp.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from camber.formats.ros.message_types import new_message

LIVOX_TYPES = ("livox_ros_driver2/msg/CustomMsg", "livox_ros_driver/msg/CustomMsg")

_FIELDS = {"x": "f4", "y": "f4", "z": "f4", "reflectivity": "f4", "offset_time": "u4"}
_DATATYPES = {"f4": 7, "u4": 6}  # PointField.FLOAT32 and UINT32


def point_cloud2_of_livox(message: Any) -> Any:
    """Return the PointCloud2 with the points of a CustomMsg: `reflectivity` is its intensity."""
    points = np.zeros(len(message.points), [(name, f"<{kind}") for name, kind in _FIELDS.items()])
    for name in _FIELDS:
        points[name] = [getattr(point, name) for point in message.points]
    names = ("intensity" if name == "reflectivity" else name for name in _FIELDS)
    offsets_and_kinds = zip(names, range(0, points.itemsize, 4), _FIELDS.values(), strict=True)
    return new_message(
        "sensor_msgs/msg/PointCloud2",
        header=message.header,
        height=1,
        width=len(points),
        fields=[
            new_message(
                "sensor_msgs/msg/PointField", name=name, offset=offset, datatype=_DATATYPES[kind], count=1
            )
            for name, offset, kind in offsets_and_kinds
        ],
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=points.view(np.uint8),
        is_dense=False,
    )
