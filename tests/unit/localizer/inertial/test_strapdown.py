"""Strap-down integration against a motion whose readings are differences of positions and rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.localizer.inertial.imu_noise import IMU_NOISE
from camber.localizer.inertial.strapdown import ForwardSpeed, InertialStep, StrapdownIntegration
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.motion import Imu
from support.imu_truth import BEGIN_NS, AnalyticMotion

RATE_HZ = 200
MOUNT = SensorMount(x_m=1.4, y_m=-0.3, z_m=0.8, roll_rad=math.pi, pitch_rad=0.1, yaw_rad=0.4)


def angles(t: float) -> tuple[float, float, float]:
    """A winding road up and down a hill, in a body that sways."""
    return 0.03 * math.sin(1.1 * t), -0.06 * math.sin(0.2 * t), 0.8 * math.sin(0.25 * t) + 0.1 * t


def speed(t: float) -> float:
    return 8.0 + 4.0 * math.sin(0.3 * t)


def motion(mount: SensorMount = MOUNT) -> AnalyticMotion:
    return AnalyticMotion(
        angles=angles,
        speed=speed,
        lever_m=(mount.x_m, mount.y_m, mount.z_m),
        vehicle_from_imu=mount.vehicle_from_sensor[:3, :3],
    )


def after_s(step: InertialStep) -> float:
    return (step.time_ns - BEGIN_NS) * 1e-9


def steps(duration_s: float, *, by_wheels: bool = True, imu: str = "tactical") -> list[InertialStep]:
    truth, integration = motion(), StrapdownIntegration(IMU_NOISE[imu], MOUNT)  # type: ignore[index]
    result = []
    for k in range(round(duration_s * RATE_HZ)):
        t = k / RATE_HZ
        known = ForwardSpeed(speed(t), 0.02) if by_wheels else None
        step = integration.add(truth.imu(t), lambda known=known: known)  # type: ignore[misc]
        if step is not None:
            result.append(step)
    return result


def test_turns_speed_changes_and_tilt_are_those_of_the_motion() -> None:
    result = steps(60.0)
    begin, end = after_s(result[100]), after_s(result[-1])
    turned = sum(step.yaw_rate_rad_s for step in result[101:]) * 0.02
    assert turned == pytest.approx(angles(end)[2] - angles(begin)[2], abs=math.radians(0.05))
    tilt = np.array([(step.reading.roll_rad, step.reading.pitch_rad) for step in result[500:]])
    true = np.array([angles(after_s(step))[:2] for step in result[500:]])
    assert np.abs(tilt - true).max() < math.radians(0.5)
    late = [step for step in result if after_s(step) > 20.0]
    changed = sum(step.reading.acceleration_m_s2 for step in late) * 0.02
    # 0.1° of tilt for 40 s.
    assert changed == pytest.approx(speed(end) - speed(20.0), abs=0.7)


def test_the_lever_arm_is_not_taken_for_an_acceleration() -> None:
    """A robot that turns on the spot: the unit 1.4 m ahead feels 1.4 m · (2 rad/s)² towards the middle."""
    mount = SensorMount(x_m=1.4)
    truth = AnalyticMotion(angles=lambda t: (0.0, 0.0, 2.0 * t), speed=lambda t: 0.0, lever_m=(1.4, 0.0, 0.0))
    integration = StrapdownIntegration(IMU_NOISE["mems"], mount)
    added = [
        integration.add(truth.imu(k / RATE_HZ), lambda: ForwardSpeed(0.0, 0.05)) for k in range(5 * RATE_HZ)
    ]
    result = [step for step in added if step is not None]
    assert truth.imu(1.0).specific_force_m_s2[0] == pytest.approx(-5.6, abs=0.01)
    assert max(abs(step.reading.acceleration_m_s2) for step in result[50:]) < 0.02
    assert all(step.yaw_rate_rad_s == pytest.approx(2.0, abs=0.01) for step in result)


def test_a_unit_is_quiet_only_where_neither_force_nor_rate_changes() -> None:
    rng = np.random.default_rng(3)
    noise, integration = IMU_NOISE["phone"], StrapdownIntegration(IMU_NOISE["phone"], SensorMount())
    still = AnalyticMotion(angles=lambda t: (0.0, 0.02, 0.0), speed=lambda t: 0.0)
    moving = AnalyticMotion(angles=lambda t: (0.01 * math.sin(9.0 * t), 0.02, 0.1 * t), speed=speed)
    quiet = []
    for k in range(4 * RATE_HZ):
        t = k / RATE_HZ
        sample = (still if t < 2.0 else moving).imu(t)
        white = rng.standard_normal(6) * math.sqrt(RATE_HZ)
        rate = np.array(sample.angular_rate_rad_s) + noise.angle_random_walk_rad_sqrt_s * white[:3]
        force = np.array(sample.specific_force_m_s2) + noise.velocity_random_walk_m_s_sqrt_s * white[3:]
        noisy = sample.model_copy(
            update={
                "angular_rate_rad_s": tuple(rate.tolist()),
                "specific_force_m_s2": tuple(force.tolist()),
            }
        )
        step = integration.add(noisy, lambda: None)
        if step is not None:
            quiet.append((t, step.reading.quiet_s > 0.0))
    assert all(value for t, value in quiet if 1.2 < t < 1.9)
    assert not any(value for t, value in quiet if t > 2.4)


def test_after_a_gap_the_tilt_is_doubted() -> None:
    truth, integration = motion(), StrapdownIntegration(IMU_NOISE["mems"], MOUNT)
    before = [integration.add(truth.imu(k / RATE_HZ), lambda: ForwardSpeed(8.0, 0.05)) for k in range(400)]
    after = [integration.add(truth.imu(10.0 + k / RATE_HZ), lambda: None) for k in range(40)]
    known = [step for step in before if step is not None][-1]
    doubted = next(step for step in after if step is not None)
    assert doubted.tilt_sigma_rad > 5.0 * known.tilt_sigma_rad
    assert doubted.time_ns - BEGIN_NS < 10.1e9


def test_a_unit_that_does_not_change_at_all_is_broken_and_not_at_rest() -> None:
    frozen = motion().imu(0.0)
    integration = StrapdownIntegration(IMU_NOISE["mems"], SensorMount())
    for k in range(600):
        step = integration.add(frozen.model_copy(update={"time_ns": BEGIN_NS + k * 5_000_000}), lambda: None)
        assert step is None or step.reading.quiet_s == 0.0


@pytest.mark.parametrize("force", [(0.0, 0.0, -9.8), (9.8, 0.0, 0.1), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
def test_a_force_that_does_not_point_up_gives_no_motion(force: tuple[float, float, float]) -> None:
    """Upside down, on its side, in units of g, or dead."""
    integration = StrapdownIntegration(IMU_NOISE["mems"], SensorMount())
    steps = []
    for k in range(600):
        sample = Imu(
            time_ns=BEGIN_NS + k * 5_000_000, angular_rate_rad_s=(0.0, 0.0, 0.1), specific_force_m_s2=force
        )
        steps.append(integration.add(sample, lambda: ForwardSpeed(5.0, 0.05)))
    assert steps == [None] * 600
    assert not integration.is_upright


def test_locked_wheels_do_not_tilt_the_vehicle() -> None:
    """From 20 m/s to rest within 0.1 s by the wheels, while the body slides on at 7 m/s²."""
    sliding = AnalyticMotion(
        angles=lambda t: (0.0, 0.0, 0.0), speed=lambda t: 20.0 - 7.0 * max(0.0, t - 5.0) * (t < 7.0)
    )
    integration = StrapdownIntegration(IMU_NOISE["mems"], SensorMount())
    pitch = []
    for k in range(round(7.0 * RATE_HZ)):
        t = k / RATE_HZ
        step = integration.add(sliding.imu(t), lambda t=t: ForwardSpeed(20.0 if t < 5.0 else 0.0, 0.05))  # type: ignore[misc]
        if step is not None:
            pitch.append(step.reading.pitch_rad)
    assert max(np.abs(pitch)) < math.radians(0.5)


@pytest.mark.parametrize("imu", ["phone", "mems", "tactical"])
def test_without_wheels_the_tilt_stays_within_its_stated_sigma(imu: str) -> None:
    result = steps(60.0, by_wheels=False, imu=imu)
    errors = [
        max(abs(step.reading.roll_rad - angles(t)[0]), abs(step.reading.pitch_rad - angles(t)[1]))
        / step.tilt_sigma_rad
        for step in result[200:]
        for t in (after_s(step),)
    ]
    assert max(errors) < 3.0
