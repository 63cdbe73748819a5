"""The truth between its rows, and errors against it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.schemas.base import Float64, Int64
from camber.validation.reference_trajectory import ReferenceTrajectory

SECOND = 1_000_000_000


def at_seconds(*seconds: float) -> Int64:
    return np.array([round(s * SECOND) for s in seconds], dtype=np.int64)


def track(*, longitude_rad: tuple[float, ...] = (2.0, 2.0, 2.0)) -> ReferenceTrajectory:
    """Rows at 0, 1 and 10 s."""
    latitude = np.array([0.6, 0.6 + 2e-6, 0.6 + 4e-6])
    return ReferenceTrajectory(
        time_ns=at_seconds(0, 1, 10),
        latitude_rad=latitude,
        longitude_rad=np.array(longitude_rad),
        height_m=np.array([40.0, 41.0, 42.0]),
    )


def test_between_two_near_rows_it_is_linear() -> None:
    known, latitude, longitude, height = track().at(at_seconds(0.25))
    assert known.tolist() == [True]
    assert latitude[0] == pytest.approx(0.6 + 0.5e-6, abs=1e-15)
    assert (longitude[0], height[0]) == (2.0, 40.25)


def test_at_the_rows_it_has_their_values() -> None:
    _, latitude, _, height = track().at(at_seconds(0, 1, 10))
    assert latitude.tolist() == track().latitude_rad.tolist()
    assert height.tolist() == [40.0, 41.0, 42.0]


def test_in_a_gap_before_and_after_the_track_it_is_not_known() -> None:
    known, latitude, longitude, height = track().at(at_seconds(-0.1, 1.1, 5, 9.9, 10.1))
    assert not known.any()
    assert np.isnan([latitude, longitude, height]).all()


def test_a_single_row_is_known_at_exactly_its_time() -> None:
    one = ReferenceTrajectory(
        time_ns=at_seconds(5),
        latitude_rad=np.array([0.6]),
        longitude_rad=np.array([2.0]),
        height_m=np.array([40.0]),
    )
    assert one.at(at_seconds(4.9, 5, 5.1))[0].tolist() == [False, True, False]


def test_interpolation_across_the_antimeridian_takes_the_short_arc() -> None:
    longitude = track(longitude_rad=(math.pi - 1e-6, -math.pi + 1e-6, 0.0)).at(at_seconds(0.5))[2]
    assert abs(abs(longitude[0]) - math.pi) < 1e-12


def test_an_error_is_east_north_up_at_the_true_place_after_the_offset() -> None:
    truth = track()
    frame = LocalFrame(0.6, 2.0, 40.0)
    latitude, longitude, height = frame.geodetic_from_enu(3.0, -4.0, 1.5)
    point = (np.array([latitude]), np.array([longitude]), np.array([height]))
    plain = truth.error_enu_m(at_seconds(0), *point, offset_enu_m=(0.0, 0.0, 0.0))
    assert plain[0] == pytest.approx([3.0, -4.0, 1.5], abs=1e-8)
    corrected = truth.error_enu_m(at_seconds(0), *point, offset_enu_m=(0.055, -0.008, -0.045))
    assert corrected[0] == pytest.approx([2.945, -3.992, 1.545], abs=1e-8)


def test_the_error_is_unknown_where_position_or_truth_is() -> None:
    nan = math.nan
    points: list[Float64] = [np.array([nan, 0.6]), np.array([2.0, 2.0]), np.array([40.0, 40.0])]
    error = track().error_enu_m(at_seconds(0, 5), *points, offset_enu_m=(0.0, 0.0, 0.0))
    assert error.shape == (2, 3)
    assert np.isnan(error).all()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"time_ns": at_seconds(0, 0, 1)}, "time_ns"),
        ({"time_ns": np.array([0.0, 1.0, 2.0])}, "time_ns"),
        ({"latitude_rad": np.array([0.6, 0.6])}, "latitude_rad"),
        ({"latitude_rad": np.array([35.0, 35.0, 35.0])}, "latitude_rad"),
        ({"longitude_rad": np.array([2.0, math.nan, 2.0])}, "longitude_rad"),
        ({"height_m": np.array([40, 41, 42])}, "height_m"),
    ],
)
def test_arrays_that_are_no_track_are_refused_by_name(change: dict[str, Float64], named: str) -> None:
    good = track()
    arrays = {n: getattr(good, n) for n in ("time_ns", "latitude_rad", "longitude_rad", "height_m")}
    with pytest.raises(ValueError, match=f"^{named}: expected"):
        ReferenceTrajectory(**(arrays | change))
