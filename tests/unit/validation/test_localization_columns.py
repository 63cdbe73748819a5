"""Errors of poses against the truth, as columns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.truth_csv import TruthTable
from camber.schemas.pose import Pose, Road, ScanMatch
from camber.validation.localization_columns import MatchColumns, PoseColumns, PoseErrors
from support.small_map import at

NS = 1_000_000_000
START_NS = 1_300_000_000 * NS
YAW_RAD = math.radians(30.0)
UNKNOWN = Road(status="unknown", reason="no_pose")


def truth(rows: int = 5, **more: list[float]) -> TruthTable:
    """Half a second apart, one metre along 30° from east."""
    along = np.arange(rows, dtype=np.float64)
    places = np.array([at(s * math.cos(YAW_RAD), s * math.sin(YAW_RAD)) for s in along])
    zeros = np.zeros(rows)
    return TruthTable(
        time_ns=START_NS + np.arange(rows) * NS // 2, latitude_rad=places[:, 0], longitude_rad=places[:, 1],
        height_m=zeros + 50.0, roll_rad=zeros, pitch_rad=zeros, yaw_rad=zeros + YAW_RAD,
        velocity_enu_m_s=np.zeros((rows, 3)), more={name: np.array(column) for name, column in more.items()},
    )  # fmt: skip


def pose(after_s: float, along_m: float, cross_m: float, **changed: Any) -> Pose:
    cos, sin = math.cos(YAW_RAD), math.sin(YAW_RAD)
    latitude_rad, longitude_rad = at(along_m * cos - cross_m * sin, along_m * sin + cross_m * cos)
    values: dict[str, Any] = {
        "time_ns": START_NS + round(after_s * NS),
        "mode": "scan_match",
        "provenance": "scan_match",
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "yaw_rad": YAW_RAD,
        "covariance_east_north_yaw": (0.04, 0.0, 0.0, 0.01, 0.0, 1e-4),
        "road": UNKNOWN,
    }
    return Pose(**values | changed)


def errors(*poses: Pose, **more: list[float]) -> PoseErrors:
    return PoseErrors.from_truth(PoseColumns.from_poses(poses), truth(**more))


def test_errors_are_along_and_across_the_truths_heading() -> None:
    result = errors(pose(0.5, 1.3, 0.2), pose(0.75, 1.5, -0.1))
    assert result.along_m == pytest.approx([0.3, 0.0], abs=1e-5)
    assert result.cross_m == pytest.approx([0.2, -0.1], abs=1e-5)
    assert result.horizontal_m == pytest.approx([math.hypot(0.3, 0.2), 0.1], abs=1e-5)


def test_yaw_errors_are_wrapped() -> None:
    result = errors(pose(0.5, 1.0, 0.0, yaw_rad=YAW_RAD + 0.1 - 2.0 * math.pi))
    assert result.yaw_rad == pytest.approx([0.1])


def test_errors_are_nan_where_pose_or_truth_is_unknown() -> None:
    lost = Pose(time_ns=START_NS, mode="none", provenance="none", road=UNKNOWN)
    result = errors(lost, pose(2.6, 5.0, 0.0), road_height_m=[40.0] * 5, level=[0.0] * 5)
    for column in (
        result.along_m,
        result.cross_m,
        result.yaw_rad,
        result.share_of_ellipse,
        result.elevation_m,
    ):
        assert np.isnan(column).all()
    assert np.isnan(result.level).all()


def test_shares_of_a_correlated_ellipse_are_those_of_its_inverse() -> None:
    covariance = (0.05, 0.02, 0.0, 0.03, 0.0, 1e-4)
    result = errors(pose(0.5, 1.2, 0.3, covariance_east_north_yaw=covariance))
    cos, sin = math.cos(YAW_RAD), math.sin(YAW_RAD)
    error = np.array([0.2 * cos - 0.3 * sin, 0.2 * sin + 0.3 * cos])
    square = error @ np.linalg.inv([[0.05, 0.02], [0.02, 0.03]]) @ error
    assert result.share_of_ellipse == pytest.approx([square / (-2.0 * math.log(0.01))], rel=1e-4)


def test_elevation_and_level_are_those_of_the_road_at_that_time() -> None:
    known = {"surface_id": 3, "sigma_m": 0.02, "slope_east": 0.0, "slope_north": 0.0, "extent_m": 5.0}
    roads = [
        Road(status="known", elevation_m=elevation, level=level, **known)
        for elevation, level in ((40.55, 0), (41.0, 1), (42.0, 0))
    ]
    poses = [pose(s, 2 * s, 0.0, road=road) for s, road in zip((0.25, 0.9, 1.1), roads, strict=True)]
    result = errors(*poses, road_height_m=[40.0, 41.0, 42.0, 43.0, 44.0], level=[0.0, 0.0, 1.0, 1.0, 1.0])
    assert result.elevation_m == pytest.approx([0.05, -0.8, -0.2], abs=1e-9)
    assert result.level.tolist() == [1.0, 1.0, 0.0]


def test_a_truth_without_a_road_gives_no_errors_of_it() -> None:
    result = errors(pose(0.5, 1.0, 0.0))
    assert np.isnan(result.elevation_m).all()
    assert np.isnan(result.level).all()


def test_covariances_are_symmetric_and_missing_ones_are_nan() -> None:
    upper = (0.05, 0.02, 0.001, 0.03, 0.002, 1e-3)
    columns = PoseColumns.from_poses([pose(0.0, 0.0, 0.0, covariance_east_north_yaw=upper), pose(0.0, 0.0, 0.0,
                              covariance_east_north_yaw=None)])  # fmt: skip
    assert columns.covariance[0].tolist() == [[0.05, 0.02, 0.001], [0.02, 0.03, 0.002], [0.001, 0.002, 1e-3]]
    assert np.isnan(columns.covariance[1]).all()
    assert np.isnan(columns.radius_m[1])
    larger_m2 = np.linalg.eigvalsh([[0.05, 0.02], [0.02, 0.03]])[1]
    assert columns.radius_m[0] == pytest.approx(math.sqrt(-2.0 * math.log(0.01) * larger_m2))


def test_matches_with_different_layers_share_columns() -> None:
    matches = [
        ScanMatch(time_ns=START_NS, status="lost"),
        ScanMatch(
            time_ns=START_NS, status="converged", layer_mean_distance_m=np.array([0.1, 0.2]), overlap=0.7
        ),
        ScanMatch(time_ns=START_NS, status="ambiguous", layer_mean_distance_m=np.array([0.3])),
    ]
    columns = MatchColumns.from_matches(matches)
    assert columns.status.tolist() == ["lost", "converged", "ambiguous"]
    expected = [[np.nan, np.nan], [0.1, 0.2], [0.3, np.nan]]
    assert np.array_equal(columns.layer_mean_distance_m, expected, equal_nan=True)
    assert np.array_equal(columns.overlap, [np.nan, 0.7, np.nan], equal_nan=True)
    assert MatchColumns.from_matches([]).layer_mean_distance_m.shape == (0, 0)
