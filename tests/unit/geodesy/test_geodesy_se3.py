"""Rigid motions: signs of roll, pitch and yaw, inverse, composition and lever arms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.se3 import (
    invert,
    lever_arm_enu,
    map_from_vehicle,
    rigid_motion,
    roll_pitch_yaw_from_rotation,
    rotation_from_roll_pitch_yaw,
    transform_points,
)

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.5, 1.5)
metres = st.floats(-1000.0, 1000.0)
poses = st.builds(map_from_vehicle, metres, metres, metres, angles, pitches, angles)


def test_forward_points_east_at_yaw_zero_and_north_at_ninety_degrees() -> None:
    assert lever_arm_enu(0.0, 0.0, 0.0, (1.0, 0.0, 0.0)) == (1.0, 0.0, 0.0)
    assert lever_arm_enu(0.0, 0.0, math.pi / 2, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    assert lever_arm_enu(0.0, 0.0, 0.0, (0.0, 1.0, 0.0)) == (0.0, 1.0, 0.0)


def test_positive_pitch_is_nose_down_and_positive_roll_is_left_side_up() -> None:
    assert lever_arm_enu(0.0, 0.1, 0.3, (1.0, 0.0, 0.0))[2] < 0.0
    assert lever_arm_enu(0.1, 0.0, 0.3, (0.0, 1.0, 0.0))[2] > 0.0


def test_one_metre_on_a_ten_per_cent_grade_is_ten_centimetres() -> None:
    climbing = -math.atan(0.10)
    assert lever_arm_enu(0.0, climbing, 1.2, (1.0, 0.0, 0.0))[2] == pytest.approx(0.0995, abs=1e-4)


@given(angles, pitches, angles, st.tuples(metres, metres, metres))
def test_lever_arm_is_the_rotation_of_the_offset(
    roll: float, pitch: float, yaw: float, arm: tuple[float, float, float]
) -> None:
    expected = rotation_from_roll_pitch_yaw(roll, pitch, yaw) @ np.array(arm)
    assert lever_arm_enu(roll, pitch, yaw, arm) == pytest.approx(expected, abs=1e-9)


@given(angles, pitches, angles)
def test_attitude_round_trip(roll: float, pitch: float, yaw: float) -> None:
    rotation = rotation_from_roll_pitch_yaw(roll, pitch, yaw)
    assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-14)
    assert roll_pitch_yaw_from_rotation(rotation) == pytest.approx((roll, pitch, yaw), abs=1e-9)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_attitude_with_the_nose_straight_down_or_up_gives_the_same_rotation(pitch: float) -> None:
    rotation = rotation_from_roll_pitch_yaw(0.3, pitch, 0.5)
    again = roll_pitch_yaw_from_rotation(rotation)
    assert again[0] == 0.0
    assert rotation_from_roll_pitch_yaw(*again) == pytest.approx(rotation, abs=1e-9)


@given(poses)
def test_inverse_undoes(pose: np.ndarray) -> None:
    assert invert(pose) @ pose == pytest.approx(np.eye(4), abs=1e-9)
    assert pose @ invert(pose) == pytest.approx(np.eye(4), abs=1e-9)


@given(poses, poses, st.lists(st.tuples(metres, metres, metres), max_size=5))
def test_composition_is_one_after_the_other(
    a_from_b: np.ndarray, b_from_c: np.ndarray, points: list[tuple[float, float, float]]
) -> None:
    points_c = np.array(points).reshape(-1, 3)
    one_by_one = transform_points(a_from_b, transform_points(b_from_c, points_c))
    assert transform_points(a_from_b @ b_from_c, points_c) == pytest.approx(one_by_one, abs=1e-8)


def test_transform_points_moves_and_turns() -> None:
    pose = map_from_vehicle(10.0, 20.0, 3.0, 0.0, 0.0, math.pi / 2)
    moved = transform_points(pose, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert moved == pytest.approx(np.array([[10.0, 21.0, 3.0], [9.0, 20.0, 3.0]]))
    assert roll_pitch_yaw_from_rotation(pose) == pytest.approx((0.0, 0.0, math.pi / 2))


@pytest.mark.parametrize(
    "rotation", [np.eye(3) * 1.1, np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.eye(2)]
)
def test_what_is_no_rotation_is_refused(rotation: np.ndarray) -> None:
    with pytest.raises(ValueError, match="rotation"):
        rigid_motion(rotation, (0.0, 0.0, 0.0))


def test_a_translation_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="translation_m"):
        rigid_motion(np.eye(3), (0.0, math.nan, 0.0))


def test_shape_errors_name_the_argument() -> None:
    with pytest.raises(ValueError, match=r"a_from_b has shape \(3, 3\), expected \(4, 4\)"):
        invert(np.eye(3))
    with pytest.raises(ValueError, match=r"points_b_m has shape \(3,\)"):
        transform_points(np.eye(4), np.zeros(3))
    with pytest.raises(ValueError, match="map_from_vehicle has shape"):
        roll_pitch_yaw_from_rotation(np.zeros(3))
