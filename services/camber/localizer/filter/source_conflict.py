"""Conflict between two sources that hold the pose.

Anchors, scan matches and odometry are independent. Where the source that the pose follows is fresh and the other keeps
contradicting it, nothing shows which of them is right: the pose stays, and its covariance grows to the second
moment of both being equally likely, half of the offset's square about the pose. The conflict lasts until the
contradicting source agrees, is silent, or is believed because the other one is silent.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from camber.localizer.arrays import Floats

ConflictSource: TypeAlias = Literal["anchors", "matches", "odometry"]


class SourceConflict:
    """The source that contradicts the pose, by how much, and how long that counts."""

    def __init__(self, lasts_s: float) -> None:
        self._lasts_ns = round(lasts_s * 1e9)
        self.forget()

    def forget(self) -> None:
        """Clear the conflict."""
        self._by: ConflictSource | None = None
        self._offset = np.zeros(2)
        self._time_ns = 0

    def report(self, by: ConflictSource, offset_m: tuple[float, float], time_ns: int) -> None:
        """Record that a source contradicts the pose by this offset, east and north."""
        self._by, self._time_ns = by, time_ns
        self._offset = np.array(offset_m)

    def resolve(self, by: ConflictSource) -> None:
        """End the conflict with this source."""
        if self._by == by:
            self.forget()

    def source(self, now_ns: int | None) -> ConflictSource | None:
        """Return the source that contradicts the pose now."""
        return None if now_ns is None or now_ns - self._time_ns > self._lasts_ns else self._by

    def covariance(self, now_ns: int | None) -> Floats:
        """Return what the conflict adds to the covariance (3, 3)."""
        added = np.zeros((3, 3))
        if self.source(now_ns) is not None:
            added[:2, :2] = 0.5 * np.outer(self._offset, self._offset)
        return added
