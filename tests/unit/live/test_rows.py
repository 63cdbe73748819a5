"""RowWriter: numbers of messages, places of terms, the place of a refused fix, ages of inputs, errors by the truth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from camber.live.history import History
from camber.live.rows import LAYOUTS, TERMS, RowWriter
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose, Road
from camber.validation.reference_trajectory import ReferenceTrajectory

START_NS = 1_400_000_000 * 1_000_000_000
LAT, LON = math.radians(35.0), math.radians(137.0)


def fix(time_ns: int = START_NS, **more: Any) -> Fix:
    fields = {
        "fix_id": 7,
        "origin": "receiver",
        "quality": "fixed",
        "latitude_rad": LAT,
        "longitude_rad": LON,
    }
    fields |= {"height_m": 41.5, "covariance_enu_m2": (0.04, 0.0, 0.0, 0.01, 0.0, 0.09), "satellites": 12}
    return Fix(time_ns=time_ns, **fields | more)


def verdict(time_ns: int = START_NS, **more: Any) -> Verdict:
    fields = {"fix_id": 7, "verdict": "erroneous", "reason": "height_disagrees", "detail": "why"}
    return Verdict(time_ns=time_ns, **fields | more)


def row_of(history: History, table: str) -> dict[str, float]:
    """The newest row of a table."""
    layout = next(layout for layout in LAYOUTS if layout.name == table)
    rows = history._tables[table]
    _, exact, rest = rows.rows(rows.count - 1, 1)
    return dict(zip((*layout.exact, *layout.rest), (*exact[0].tolist(), *rest[0].tolist()), strict=True))


def history_of(*messages: tuple[str, Any], truth: ReferenceTrajectory | None = None) -> History:
    history = History(LAYOUTS, 100)
    rows = RowWriter(history, truth)
    for channel, message in messages:
        rows.add(channel, message)
    return history


def test_a_fix_is_in_degrees_with_its_deviations() -> None:
    row = row_of(history_of(("fix", fix())), "fix")
    assert (row["lat"], row["lon"]) == pytest.approx((35.0, 137.0))
    assert row["sigma_m"] == pytest.approx(0.2)
    assert row["sigma_up_m"] == pytest.approx(0.3)
    assert TERMS["quality"][int(row["quality"])] == "fixed"
    assert math.isnan(row["ratio"])


def test_a_refused_fix_is_shown_where_it_was() -> None:
    history = history_of(("fix", fix()), ("verdict", verdict(evidence=("height", "consistency"))))
    row = row_of(history, "verdict")
    assert (row["lat"], row["lon"]) == pytest.approx((35.0, 137.0))
    assert TERMS["verdict"][int(row["verdict"])] == "erroneous"
    assert TERMS["reason"][int(row["reason"])] == "height_disagrees"
    evidence = [term for place, term in enumerate(TERMS["evidence"]) if int(row["evidence"]) >> place & 1]
    assert evidence == ["height", "consistency"]
    assert history.text(0, 0) == "why"


def test_a_verdict_whose_fix_never_came_has_no_place() -> None:
    row = row_of(history_of(("verdict", verdict(fix_id=8))), "verdict")
    assert math.isnan(row["lat"])


def test_many_fixes_without_a_verdict_take_no_more_memory() -> None:
    rows = RowWriter(History(LAYOUTS, 10))
    for k in range(1000):
        rows.add("fix", fix(START_NS + k, fix_id=k))
    assert len(rows._fixes) == 256


def test_ages_are_those_at_the_position() -> None:
    position = Position(time_ns=START_NS + 300_000_000, source="none", usable=False, alert_limit_m=1.5)
    motion = Motion(time_ns=START_NS + 200_000_000, wheel_speed_m_s=None, yaw_rate_rad_s=None)
    row = row_of(history_of(("fix", fix()), ("motion", motion), ("position", position)), "position")
    assert row["age_fix_s"] == pytest.approx(0.3, abs=1e-5)
    assert row["age_motion_s"] == pytest.approx(0.1, abs=1e-5)
    assert math.isnan(row["age_pose_s"])
    assert row["usable"] == 0.0


def test_errors_are_against_the_truth() -> None:
    truth = ReferenceTrajectory(
        time_ns=np.array([START_NS, START_NS + 10**9]),
        latitude_rad=np.array([LAT, LAT]),
        longitude_rad=np.array([LON, LON]),
        height_m=np.array([40.0, 40.0]),
    )
    history = history_of(("fix", fix()), ("verdict", verdict()), truth=truth)
    assert row_of(history, "verdict")["error_m"] == pytest.approx(1.5, abs=1e-4)


def test_a_pose_says_what_it_rests_on() -> None:
    pose = Pose(
        time_ns=START_NS,
        mode="anchored",
        provenance="confirmed",
        latitude_rad=LAT,
        longitude_rad=LON,
        yaw_rad=1.0,
        covariance_east_north_yaw=(0.25, 0.01, 0.0, 0.5, 0.0, 0.001),
        horizontal_basis="relief",
        road=Road(status="unknown", reason="no_surface"),
    )
    row = row_of(history_of(("pose", pose)), "pose")
    assert TERMS["basis"][int(row["basis"])] == "relief"
    assert TERMS["road_reason"][int(row["road_reason"])] == "no_surface"
    assert (row["ee"], row["en"], row["nn"]) == pytest.approx((0.25, 0.01, 0.5))
