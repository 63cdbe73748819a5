"""Static transforms of tf2: where the frames of sensors are on the vehicle.

Source: tf2_msgs/TFMessage; REP 105 (`base_link`) and REP 120 (`base_footprint`, on the ground).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from camber.geodesy.se3 import invert, rigid_motion
from camber.schemas.base import Float64


class StaticFrames:
    """A tree of frames; later transforms replace earlier ones of the same frame."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Float64]] = {}

    @property
    def names(self) -> frozenset[str]:
        """All frames."""
        return frozenset(self._parents) | {parent for parent, _ in self._parents.values()}

    def __contains__(self, frame: str) -> bool:
        return _name(frame) in self.names

    def add(self, message: Any) -> None:
        """Add the transforms of a TFMessage. Raises ValueError for one that is no rigid motion."""
        for transform in message.transforms:
            turn, place = transform.transform.rotation, transform.transform.translation
            matrix = rigid_motion(
                rotation_from_quaternion(turn.x, turn.y, turn.z, turn.w), (place.x, place.y, place.z)
            )
            self._parents[_name(transform.child_frame_id)] = _name(transform.header.frame_id), matrix

    def base_from(self, base: str, frame: str) -> Float64 | None:
        """Return the transform (4, 4) from a frame to the base, None where no transforms connect them."""
        base_root, root_from_base = self._to_root(_name(base))
        root, root_from_frame = self._to_root(_name(frame))
        return invert(root_from_base) @ root_from_frame if root == base_root else None

    def _to_root(self, frame: str) -> tuple[str, Float64]:
        matrix: Float64 = np.eye(4)
        for _ in range(len(self._parents)):  # of a loop the walk ends somewhere
            if frame not in self._parents:
                break
            frame, parent_from_frame = self._parents[frame]
            matrix = parent_from_frame @ matrix
        return frame, matrix


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Float64:
    """Return the rotation (3, 3) of a quaternion of any length. Raises ValueError for length zero or infinity."""
    q = np.array([x, y, z, w], np.float64)
    length = float(np.linalg.norm(q))
    if not 0.0 < length < np.inf:
        raise ValueError(f"quaternion is {q.tolist()}, expected a length above zero")
    x, y, z, w = (q / length).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _name(frame: str) -> str:
    """Without the slash that ROS 1 put in front."""
    return frame.removeprefix("/")
