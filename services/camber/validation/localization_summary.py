"""Poses, scan matches and antenna heights of a recording, and their summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.drive.recording import Recorded
from camber.schemas.antenna import AntennaHeight
from camber.schemas.base import Float64, Int64
from camber.validation.localization_columns import MatchColumns, PoseColumns


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalizerRecord:
    """Poses, matches, and by method the antenna heights: times (n,) and metres (n,)."""

    poses: PoseColumns
    matches: MatchColumns
    heights: dict[str, tuple[Int64, Float64]]

    @classmethod
    def from_recording(cls, recorded: Mapping[str, Sequence[Recorded[Any]]]) -> LocalizerRecord:
        """From the messages by channel; a missing one counts as empty."""
        return cls(
            poses=PoseColumns.from_poses([item.message for item in recorded.get("pose", ())]),
            matches=MatchColumns.from_matches([item.message for item in recorded.get("scan_match", ())]),
            heights=_heights([item.message for item in recorded.get("antenna_height", ())]),
        )

    def summary(self) -> dict[str, Any]:
        """Counts of modes and statuses, and medians; None without a value."""
        distance_m = self.matches.layer_mean_distance_m
        return {
            "modes": dict(Counter(self.poses.mode.tolist()).most_common()),
            "matches": dict(Counter(self.matches.status.tolist()).most_common()),
            "layer_mean_distance_m": [_median(column) for column in distance_m.T],
            "sensor_height_m": _median(self.matches.sensor_height_m),
            "ground_height_m": _median(self.matches.ground_height_m),
            "antenna_height_m": {method: _median(height_m) for method, (_, height_m) in self.heights.items()},
        }


def _heights(messages: Sequence[AntennaHeight]) -> dict[str, tuple[Int64, Float64]]:
    heights: dict[str, list[tuple[int, float]]] = {}
    for message in messages:
        if message.way is not None and message.height_m is not None:
            heights.setdefault(message.way, []).append((message.time_ns, message.height_m))
        for other in message.others:
            heights.setdefault(other.way, []).append((message.time_ns, other.height_m))
    return {
        method: (np.array([t for t, _ in rows], np.int64), np.array([h for _, h in rows], np.float64))
        for method, rows in sorted(heights.items())
    }


def _median(values: Float64) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
