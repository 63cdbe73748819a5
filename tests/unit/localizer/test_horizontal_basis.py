"""What the pose's horizontal position rests on, by its mode and the times of its sources."""

from __future__ import annotations

from typing import Any

import pytest

from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.horizontal_basis import horizontal_basis

CASES: list[tuple[str, dict[str, Any], float]] = [
    ("none", {"mode": "none", "provenance": "none"}, 0.0),
    ("fixes", {"mode": "provisional", "provenance": "fixes"}, 0.0),
    ("given", {"mode": "dead_reckoning", "provenance": "given"}, 50.0),
    ("odometry", {"mode": "dead_reckoning", "provenance": "given"}, 150.0),
    ("fixes", {"mode": "anchored", "provenance": "confirmed", "anchor_time_ns": 5}, 10.0),
    ("fixes", {"mode": "dead_reckoning", "provenance": "confirmed", "anchor_time_ns": 5}, 10.0),
    ("scan_match", {"mode": "scan_match", "anchor_time_ns": 9, "match_time_ns": 8}, 0.0),
    ("odometry", {"mode": "dead_reckoning", "anchor_time_ns": 5, "match_time_ns": 8}, 0.0),
    ("fixes", {"mode": "dead_reckoning", "anchor_time_ns": 9, "match_time_ns": 8}, 0.0),
    ("odometry", {"mode": "dead_reckoning", "provenance": "scan_match", "match_time_ns": 8}, 0.0),
]


@pytest.mark.parametrize(("basis", "fields", "since_given_m"), CASES)
def test_the_newest_source_is_the_basis(basis: str, fields: dict[str, Any], since_given_m: float) -> None:
    known = {"provenance": "confirmed", "anchor_time_ns": None, "match_time_ns": None} | fields
    estimate = object.__new__(PoseEstimate)
    for name, value in known.items():
        object.__setattr__(estimate, name, value)
    assert horizontal_basis(estimate, since_given_m=since_given_m) == basis
