"""A PointCloud2 of any layout becomes the sweep that it was made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.errors import FormatError
from camber.formats.ros.point_cloud2 import (
    TIME_FIELDS,
    point_cloud2,
    point_layout,
    sweep_from_point_cloud2,
)
from camber.schemas.lidar import Sweep
from support.ros_bags import LIVOX, LIVOX_ROS1, MAKERS, BagWriter, cloud_message

TIME_NS = 1_400_000_000_123_456_789
TOLERANCE_NS = {"ouster": 0, "velodyne": 8, "hesai": 240, "robosense": 240, "livox": 256}
"""What the types of the fields hold: float32 of 0.1 s, doubles of Unix time in s and in ns."""


def sweep_of(points: int, seed: int, *, duration_ns: int = 100_000_000) -> Sweep:
    rng = np.random.default_rng(seed)
    offset_ns = np.sort(rng.integers(-duration_ns, 0, points, endpoint=True))
    offset_ns -= offset_ns[-1]
    return Sweep(
        time_ns=TIME_NS,
        sensor="lidar",
        points_m=rng.normal(0.0, 30.0, (points, 3)).astype(np.float32),
        intensity=rng.uniform(0.0, 255.0, points).astype(np.float32),
        offset_ns=offset_ns.astype(np.int32),
    )


def read(message: Any) -> Sweep:
    return sweep_from_point_cloud2(message, point_layout(message, "/points"), "/points", "lidar")


def by_coordinates(sweep: Sweep) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    order = np.lexsort(sweep.points_m.T)
    return (
        sweep.points_m[order],
        sweep.intensity[order],
        sweep.time_ns + sweep.offset_ns[order].astype(np.int64),
    )


@settings(max_examples=100, derandomize=True)
@given(
    maker=st.sampled_from(MAKERS),
    points=st.integers(1, 300),
    seed=st.integers(0, 2**32 - 1),
    big_endian=st.booleans(),
)
def test_the_layout_of_each_maker_gives_the_same_points(
    maker: str, points: int, seed: int, big_endian: bool
) -> None:
    sweep = sweep_of(points, seed)
    again = read(cloud_message(sweep, maker, big_endian=big_endian))
    (points_m, intensity, at_ns), expected = by_coordinates(again), by_coordinates(sweep)
    assert np.array_equal(points_m, expected[0])
    assert np.array_equal(intensity, expected[1])
    assert np.abs(at_ns - expected[2]).max() <= TOLERANCE_NS[maker]
    assert abs(again.time_ns - sweep.time_ns) <= TOLERANCE_NS[maker]
    assert (np.diff(again.offset_ns) >= 0).all()
    assert again.offset_ns[-1] == 0


@settings(max_examples=30, derandomize=True)
@given(points=st.integers(1, 300), seed=st.integers(0, 2**32 - 1), kind=st.sampled_from((LIVOX, LIVOX_ROS1)))
def test_a_custom_message_of_livox_gives_the_same_points(points: int, seed: int, kind: str) -> None:
    sweep = sweep_of(points, seed)
    cloud = point_cloud2(BagWriter("mcap", None).livox_message(sweep, kind), kind)
    (points_m, intensity, at_ns), expected = by_coordinates(read(cloud)), by_coordinates(sweep)
    assert np.array_equal(points_m, expected[0])
    assert np.array_equal(intensity, np.floor(expected[1]))
    assert np.array_equal(at_ns, expected[2])


def test_a_custom_message_without_points_is_one_line() -> None:
    message = BagWriter("mcap", None).livox_message(sweep_of(3, 1))
    message.points = []
    with pytest.raises(FormatError, match=r"/points: height × width is '0', expected 1 to"):
        read(point_cloud2(message, LIVOX))


def test_each_maker_of_the_table_is_tried() -> None:
    tried = {point_layout(cloud_message(sweep_of(3, 1), maker), "/points").time for maker in MAKERS}
    assert {field.name for field in tried if field} == {"t", "time", "timestamp"}
    assert {field.name for field in TIME_FIELDS} == {"t", "time", "timestamp", "offset_time", "time_stamp"}


@pytest.mark.parametrize("name", ["offset_time", "time_stamp"])
def test_other_fields_after_the_stamp_are_nanoseconds_too(name: str) -> None:
    sweep = sweep_of(20, 2)
    message = cloud_message(sweep, "ouster")
    renamed(message, "t", name)
    assert np.array_equal(np.sort(read(message).offset_ns), np.sort(sweep.offset_ns))


def renamed(message: Any, old: str, new: str) -> None:
    (field,) = [field for field in message.fields if field.name == old]
    field.name = new


def test_without_times_of_points_the_stamp_is_that_of_all_and_the_layout_says_why() -> None:
    sweep = sweep_of(20, 3)
    message = cloud_message(sweep, "velodyne")  # stamped at its end
    renamed(message, "time", "azimuth")
    layout = point_layout(message, "/points")
    assert layout.time is None
    assert layout.no_time == "none of the fields t, time, timestamp, offset_time, time_stamp"
    again = read(message)
    assert again.time_ns == sweep.time_ns
    assert not again.offset_ns.any()


def test_a_field_of_another_type_than_the_makers_is_not_taken_for_times() -> None:
    message = cloud_message(sweep_of(20, 3), "velodyne")
    renamed(message, "time", "t")
    layout = point_layout(message, "/points")
    assert (layout.time, layout.no_time) == (None, "field t is float32, expected uint32 as of Ouster")


def test_what_was_not_measured_is_left_out() -> None:
    sweep = sweep_of(6, 4)
    points_m = sweep.points_m.copy()
    points_m[1], points_m[2, 1], points_m[3, 0], points_m[4, 2] = 0.0, np.nan, np.inf, 1e38
    message = cloud_message(sweep.model_copy(update={"points_m": points_m}), "velodyne")
    assert np.array_equal(read(message).points_m, points_m[[0, 5]])


def test_intensities_are_zero_where_there_are_none_or_no_numbers() -> None:
    sweep = sweep_of(3, 5)
    intensity = np.array([1.0, np.nan, np.inf], np.float32)
    message = cloud_message(sweep.model_copy(update={"intensity": intensity}), "velodyne")
    assert read(message).intensity.tolist() == [1.0, 0.0, 0.0]
    renamed(message, "intensity", "reflectivity")
    assert not read(message).intensity.any()


DAMAGES: dict[str, tuple[dict[str, Any], str]] = {
    "cut": ({"data": np.zeros(100, np.uint8)}, "data is '100 bytes', expected row_step"),
    "no points": ({"height": 0}, r"height × width is '0', expected 1 to"),
    "too many": ({"height": 2**31, "width": 2**31}, "expected 1 to 20000000 points"),
    "rows overlap": ({"height": 2, "width": 10, "row_step": 22}, "row_step 22 of at least 10 points"),
    "narrow": ({"point_step": 10}, r"fields.'z', expected an offset within point_step 10"),
    "no fields": ({"fields": []}, "expected x, y and z, but there is no x, y, z"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_one_line(damage: str) -> None:
    message = cloud_message(sweep_of(20, 6), "velodyne")
    changes, expected = DAMAGES[damage]
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(FormatError, match=expected) as caught:
        read(message)
    assert str(caught.value).startswith("/points: ")
    assert "\n" not in str(caught.value)


def test_times_of_another_clock_than_the_stamp_are_refused() -> None:
    message = cloud_message(sweep_of(20, 7), "hesai")
    message.header.stamp.sec -= 37  # the LiDAR gives TAI
    with pytest.raises(
        FormatError, match=r"timestamp is '37\.\d{3} s off', expected times of points within 1 s"
    ):
        read(message)


def test_a_sweep_without_a_measured_point_is_refused() -> None:
    sweep = sweep_of(4, 8)
    message = cloud_message(sweep.model_copy(update={"points_m": 0.0 * sweep.points_m}), "livox")
    with pytest.raises(FormatError, match="expected at least one measured point"):
        read(message)
