"""The recording `street-lidar` as messages of five makers' drivers: the same points, and the same scan matches.

The recording has no times of points: they are made up, by azimuth over a tenth of a second.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from camber.formats.map_exchange.pcd import PointCloud, cloud_from_pcd, read_header
from camber.formats.ros.message_types import message_types
from camber.formats.ros.point_cloud2 import point_layout, sweep_from_point_cloud2
from camber.localizer.matching.layered_matching import LayeredMatch, MatchOptions
from camber.schemas.lidar import Sweep
from support import street_lidar
from support.ros_bags import MAKERS, POINT_CLOUD2, point_cloud2_bytes
from support.street_lidar_tables import matched

FOLDER = street_lidar.folder()
pytestmark = pytest.mark.skipif(FOLDER is None, reason="CAMBER_DATA/street-lidar is not there")
TIME_NS = 1_400_000_000_000_000_000
_POINT_BYTES = 16


def recorded_sweep(k: int) -> Sweep:
    assert FOLDER is not None
    data = Path(FOLDER / f"{k:010d}.pcd").read_bytes()
    header = read_header(data, "sweep")
    return timed(cloud_from_pcd(data[: header.begin + _POINT_BYTES * header.points], "sweep"))


def timed(cloud: PointCloud) -> Sweep:
    """A sweep in the order of azimuth, with even times."""
    order = np.argsort(np.arctan2(cloud.points_m[:, 1], cloud.points_m[:, 0]), kind="stable")
    assert cloud.intensity is not None
    return Sweep(
        time_ns=TIME_NS,
        sensor="lidar",
        points_m=cloud.points_m[order],
        intensity=cloud.intensity[order],
        offset_ns=np.rint(np.linspace(-1e8, 0.0, len(order))).astype(np.int32),
    )


def through_ros(sweep: Sweep, maker: str) -> Sweep:
    message = message_types().deserialize_cdr(point_cloud2_bytes(sweep, maker), POINT_CLOUD2)
    return sweep_from_point_cloud2(message, point_layout(message, "/points"), "/points", "lidar")


@pytest.mark.parametrize("maker", MAKERS)
def test_the_layout_of_a_maker_gives_the_same_points(maker: str) -> None:
    for k in (0, 17, 39):
        sweep = recorded_sweep(k)
        assert len(sweep.points_m) > 50_000
        again = through_ros(sweep, maker)
        measured = sweep.points_m.any(axis=1)  # the files have a point of zero range each, or none
        assert measured.sum() >= len(measured) - 1
        assert np.array_equal(again.points_m, sweep.points_m[measured])
        assert np.array_equal(again.intensity, sweep.intensity[measured])


@pytest.mark.slow
@pytest.mark.parametrize("maker", MAKERS)
def test_the_layout_of_a_maker_gives_the_same_scan_matches(
    maker: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    street_lidar.ground()  # the map stays that of the recording
    expected = matches_of(lambda sweep: sweep, monkeypatch)
    again = matches_of(lambda sweep: through_ros(sweep, maker), monkeypatch)
    assert len(again) == len(expected) >= 3
    for match, other in zip(again, expected, strict=True):
        assert match.status == other.status == "converged"
        assert np.array_equal(match.map_from_local, other.map_from_local)


def matches_of(change: Callable[[Sweep], Sweep], monkeypatch: pytest.MonkeyPatch) -> list[LayeredMatch]:
    """Matches of every third query of the recording with changed sweeps."""

    def read(data: bytes, name: str) -> PointCloud:
        return PointCloud(points_m=change(timed(cloud_from_pcd(data, name))).points_m)

    caches = (street_lidar.sweep, street_lidar.overlaid)
    with monkeypatch.context() as context:
        context.setattr(street_lidar, "cloud_from_pcd", read)
        for cache in caches:
            cache.cache_clear()
        matches = [matched(query, MatchOptions()) for query in street_lidar.queries(0.5, 2.0, 1)[::3]]
    for cache in caches:
        cache.cache_clear()
    return matches
