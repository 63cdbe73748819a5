"""Two sources that hold the pose and contradict each other: neither wins in silence.

Anchors and scan matches are independent. Where the one that the pose follows is fresh and the other insists on
another place, the pose stays where it is, for nothing says which is right, and its covariance grows to the second
moment of both being as likely: half of the offset's square about the pose. It lasts until the one that insists
agrees, falls silent, or is believed because the other has fallen silent.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from camber.localizer.links.link_filter import Array

Disputing: TypeAlias = Literal["anchors", "matches"]


class Dispute:
    """Who contradicts the pose, by how much, and until when that counts."""

    def __init__(self, lasts_s: float) -> None:
        self._lasts_ns = round(lasts_s * 1e9)
        self.forget()

    def forget(self) -> None:
        """Nobody does."""
        self._by: Disputing | None = None
        self._offset = np.zeros(2)
        self._time_ns = 0

    def raised(self, by: Disputing, east_m: float, north_m: float, time_ns: int) -> None:
        """Somebody insists on a place that is off by this from the pose."""
        self._by, self._time_ns = by, time_ns
        self._offset = np.array([east_m, north_m])

    def settled(self, by: Disputing) -> None:
        """That one agrees with the pose, or the pose with it."""
        if self._by == by:
            self.forget()

    def by(self, now_ns: int | None) -> Disputing | None:
        """Who disputes the pose now."""
        return None if now_ns is None or now_ns - self._time_ns > self._lasts_ns else self._by

    def covariance(self, now_ns: int | None) -> Array:
        """What it adds to the covariance (3, 3)."""
        added = np.zeros((3, 3))
        if self.by(now_ns) is not None:
            added[:2, :2] = 0.5 * np.outer(self._offset, self._offset)
        return added
