"""Localizer and antenna height in summary and report."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.recording import Recorded
from camber.replay.run_folder import DriveFacts, RunFacts
from camber.schemas.antenna import AntennaHeight, HeightByMethod
from camber.schemas.pose import Pose, Road, ScanMatch
from camber.validation.evaluation import Evaluation, evaluate
from camber.validation.report.chart_data import chart_data, filled_tables
from camber.validation.report.page import render

START_NS = 1_373_000_000_000_000_000
STEP_NS = 100_000_000


def wrap(*messages: Any) -> list[Recorded[Any]]:
    return [
        Recorded(channel="", key="", message=message, source="", sequence=0, arrival_ns=0)
        for message in messages
    ]


def at(step: int) -> int:
    return START_NS + step * STEP_NS


def match(step: int, layers_m: list[float], height_m: float) -> ScanMatch:
    distances = np.array(layers_m)
    return ScanMatch(
        time_ns=at(step), status="converged", layer_mean_distance_m=distances, sensor_height_m=height_m
    )


def height(step: int, method: Any, height_m: float, other: Any, other_m: float) -> AntennaHeight:
    others = (HeightByMethod(way=other, height_m=other_m, sigma_m=0.02),)
    known: dict[str, Any] = {"status": "known", "height_m": height_m, "sigma_m": 0.02}
    return AntennaHeight(time_ns=at(step), way=method, others=others, **known)


DRIVE = DriveFacts(drive="by hand", truth=False)


def evaluated(messages: dict[str, list[Recorded[Any]]]) -> Evaluation:
    return evaluate(messages, DRIVE, RunFacts(), None)


def rendered(messages: dict[str, list[Recorded[Any]]]) -> str:
    return render(evaluated(messages), chart_data(messages, DRIVE, None, None))


def recorded() -> dict[str, list[Recorded[Any]]]:
    road, modes = Road(status="unknown", reason="no_pose"), ("none", "scan_match", "scan_match")
    poses = (Pose(time_ns=at(k), mode=mode, provenance="none", road=road) for k, mode in enumerate(modes))
    lost = ScanMatch(time_ns=at(0), status="lost")
    unknown = AntennaHeight(time_ns=at(0), status="unknown")
    return {
        "pose": wrap(*poses),
        "scan_match": wrap(lost, match(1, [0.1, 0.2], 1.90), match(2, [0.12, 0.4], 1.94)),
        "antenna_height": wrap(
            unknown,
            height(1, "stroke", 1.58, "ranging", 1.60),
            height(2, "ranging", 1.62, "scan_matching", 1.55),
        ),
    }


def test_the_summary_has_counts_and_medians() -> None:
    assert evaluated(recorded()).summary["localizer"] == {
        "modes": {"scan_match": 2, "none": 1},
        "matches": {"converged": 2, "lost": 1},
        "layer_mean_distance_m": pytest.approx([0.11, 0.3]),
        "sensor_height_m": pytest.approx(1.92),
        "ground_height_m": None,
        "antenna_height_m": pytest.approx({"ranging": 1.61, "scan_matching": 1.55, "stroke": 1.58}),
    }


def test_the_page_has_a_row_for_each_mode_and_status_and_the_heights() -> None:
    page = rendered(recorded())
    row = r'<td class="left">{}</td><td class="left">{}</td><td>{}</td><td>{}'
    assert re.search(row.format("pose", "scan match", 2, "66.7"), page)
    assert re.search(row.format("scan match", "lost", 1, "33.3"), page)
    assert "sensor, by matches 1.920\u00a0m; antenna, by ranging 1.610\u00a0m" in page


def test_the_charts_have_layers_and_heights_at_their_times() -> None:
    tables = filled_tables(recorded(), DRIVE, None)
    layers = np.array(tables.rest["scan_match"])
    assert layers == pytest.approx(np.array([[np.nan] * 2, [0.1, 0.2], [0.12, 0.4]]), nan_ok=True)
    # ranging, scan matching, stroke
    heights = np.array(tables.rest["height"])
    assert heights == pytest.approx(np.array([[1.60, np.nan, 1.58], [1.62, 1.55, np.nan]]), nan_ok=True)


def test_a_run_without_a_localizer_is_reported() -> None:
    page = rendered({})
    assert "The localizer published nothing." in page
    assert json.dumps(evaluated({}).summary["localizer"]["layer_mean_distance_m"]) == "[]"
