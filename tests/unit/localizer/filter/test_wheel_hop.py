"""Wheels that hop on a bump: their speed swings about the vehicle's, which is no slip."""

import math

import pytest

from support.pose_vehicle import PoseVehicle

SPEED_M_S, HOP_HZ = 16.0, 11.0


def driving(step_s):
    vehicle = PoseVehicle(at=(0.0, 0.0, 0.3), step_s=step_s, agile=True, noise=0.2)
    assert vehicle.filter.start(vehicle.given())
    for _ in range(round(3.0 / step_s)):
        vehicle.step(SPEED_M_S)
    return vehicle


@pytest.mark.parametrize("swing_m_s", [0.4, 0.8])
def test_a_hop_of_the_wheels_raises_no_suspicion_of_slip(swing_m_s):
    """As in comma-2018-08-02: 0.2 s of swings after a bump, readings at 83 Hz; dead reckoning follows their mean."""
    vehicle, step_s = driving(0.012), 0.012
    before = vehicle.distance()
    for k in range(17):
        hop = swing_m_s * math.sin(math.tau * HOP_HZ * k * step_s)
        vehicle.step(SPEED_M_S, slip=1.0 + hop / SPEED_M_S)
        assert not vehicle.filter.estimate().wheel_slip_suspected
    assert vehicle.distance() == pytest.approx(before, abs=0.1)


@pytest.mark.parametrize("step_s", [0.012, 0.05, 0.1])
def test_slip_is_suspected_within_a_quarter_of_a_second_however_often_the_wheels_are_read(step_s):
    vehicle = driving(step_s)
    steps = 0
    while not vehicle.filter.estimate().wheel_slip_suspected:
        vehicle.step(SPEED_M_S, slip=1.25)
        steps += 1
        assert steps * step_s <= 0.25
