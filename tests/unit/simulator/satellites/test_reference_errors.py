"""Errors of reference points: constant in the vehicle or in the frame, and none unless they are asked for."""

import math

import numpy as np
import pytest

from camber.simulator.satellites.reference_errors import frame_offset_m, with_reference_error
from camber.simulator.satellites.track import AntennaTrack

YAW_RAD = np.linspace(0.0, 1.5 * math.pi, 151)
TRACK = AntennaTrack(
    time_ns=np.arange(151) * 100_000_000,
    antenna_m=np.zeros((151, 3)),
    antenna_velocity_m_s=np.zeros((151, 3)),
)


def test_the_error_is_constant_in_the_vehicle_and_turns_with_it():
    moved = with_reference_error(TRACK, YAW_RAD, 0.06, seed=3)
    east_m, north_m, up_m = moved.antenna_m.T
    assert np.hypot(east_m, north_m) == pytest.approx(0.06)
    assert not up_m.any()
    direction_rad = np.unwrap(np.arctan2(north_m, east_m)) - YAW_RAD
    assert np.ptp(direction_rad) < 1e-9
    rate_rad_s = 1.5 * math.pi / 15.0
    assert np.linalg.norm(moved.antenna_velocity_m_s, axis=1)[1:-1] == pytest.approx(
        0.06 * rate_rad_s, rel=1e-3
    )


def test_each_seed_has_a_direction():
    first, other = (with_reference_error(TRACK, YAW_RAD, 0.06, seed=seed).antenna_m for seed in (1, 2))
    assert np.abs(first - other).max() > 0.01


def test_without_a_length_nothing_changes():
    assert with_reference_error(TRACK, YAW_RAD, 0.0, seed=3) is TRACK
    assert not frame_offset_m(0.0, 3).any()


def test_a_vehicle_of_one_epoch_does_not_turn():
    one = AntennaTrack(
        time_ns=np.zeros(1, np.int64), antenna_m=np.zeros((1, 3)), antenna_velocity_m_s=np.zeros((1, 3))
    )
    assert not with_reference_error(one, np.zeros(1), 0.06, seed=3).antenna_velocity_m_s.any()


def test_frames_differ_by_their_sigma_and_not_in_height():
    offsets = np.array([frame_offset_m(0.02, seed) for seed in range(400)])
    assert offsets[:, :2].std() == pytest.approx(0.02, rel=0.1)
    assert not offsets[:, 2].any()
