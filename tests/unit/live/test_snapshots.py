"""Snapshots: the newest at a time, within a limit of bytes; satellites as the page reads them."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from camber.live.history import History
from camber.live.rows import LAYOUTS, RowWriter
from camber.live.snapshots import Snapshots, match_points_as_bytes, satellites_as_json
from camber.schemas.gnss import SATELLITE_USES, SatellitesInView
from camber.schemas.pose import ScanMatchPoints

START_NS = 1_400_000_000 * 1_000_000_000
USED, OUTLIER = SATELLITE_USES.index("used"), SATELLITE_USES.index("outlier")


def satellites(time_ns: int = START_NS) -> SatellitesInView:
    return SatellitesInView(
        time_ns=time_ns,
        quality="fixed",
        satellite=np.array([ord("G") * 256 + 5, ord("E") * 256 + 11], np.int32),
        present=np.array([3, 0], np.uint8),
        azimuth_rad=np.array([-math.pi / 2, 0.0], np.float32),
        elevation_rad=np.array([math.pi / 4, 0.0], np.float32),
        cn0_dbhz=np.array([44.25, 0.0], np.float32),
        use=np.array([USED, OUTLIER], np.uint8),
    )


def test_the_newest_at_or_before_a_time() -> None:
    snapshots = Snapshots()
    for time_s in (1.0, 2.0, 1.5):  # the last one comes too late
        snapshots.add("kind", time_s, f"{time_s}".encode())
    assert [snapshots.at("kind", time_s) for time_s in (0.9, 1.0, 1.9, 9.0)] == [None, b"1.0", b"1.0", b"2.0"]
    assert snapshots.at("other", 9.0) is None


def test_of_too_many_bytes_the_oldest_go() -> None:
    snapshots = Snapshots(limit_bytes=1000)
    for k in range(100):
        snapshots.add("kind", float(k), bytes(100))
    assert snapshots.at("kind", 85.0) is None
    assert snapshots.at("kind", 95.0) == bytes(100)


def test_satellites_are_in_degrees_and_what_is_not_known_is_null() -> None:
    shown = json.loads(satellites_as_json(satellites(), 12.5))
    assert (shown["t"], shown["quality"]) == (12.5, "fixed")
    assert shown["satellites"] == [["G05", 270.0, 45.0, 44.2, "used"], ["E11", None, None, None, "outlier"]]


def test_satellites_of_the_bus_are_kept_until_time_goes_back() -> None:
    history = History(LAYOUTS, 100)
    rows = RowWriter(history)
    rows.add("satellites", satellites())
    assert history.snapshots.at("satellites", 4e9) is not None
    for time_s in (100.0, 0.0):
        history.append("pose", (time_s, 0.0, 0.0), (0.0,) * 9)
    assert history.snapshots.at("satellites", 4e9) is None


def test_points_of_a_match_are_in_whole_centimetres_and_one_without_a_partner_has_the_least_number() -> None:
    points = ScanMatchPoints(
        time_ns=START_NS,
        status="converged",
        latitude_rad=0.5,
        longitude_rad=-1.0,
        east_m=np.array([1.234, -999.0, 0.0], np.float32),
        north_m=np.array([-2.0, 0.0, 3.0], np.float32),
        paired=np.array([1, 1, 0], np.uint8),
        residual_m=np.array([-0.0123, 1e9, 0.0], np.float32),
    )
    data = match_points_as_bytes(points, 12.5)
    assert np.frombuffer(data, "<f8", 3) == pytest.approx([12.5, math.degrees(0.5), math.degrees(-1.0)])
    east_cm, north_cm, residual_mm = np.frombuffer(data, "<i2", offset=24).reshape(3, -1).tolist()
    assert (east_cm, north_cm) == ([123, -32767, 0], [-200, 0, 300])
    assert residual_mm == [-12, 32767, -32768]
