"""Readings of a vehicle's sensors as the messages that services receive."""

from __future__ import annotations

import math

import numpy as np

from camber.schemas.motion import Motion, Ranging, Suspension
from camber.simulator.scene import Integers
from camber.simulator.vehicle.body import VehicleBody
from camber.simulator.vehicle.sensor_clock import Readings
from camber.simulator.vehicle.sensors import SensorSet, VehicleReadings

OLDEST_NS = 100_000_000  # chosen: the period of the sensors


def motion_messages(readings: VehicleReadings) -> list[Motion]:
    """One message a reading of the yaw rate, by its stamp, with the newest readings of the others by then.

    So a vehicle's gateway puts together what comes from several units. What is older than `OLDEST_NS` is None.
    """
    time_ns = readings.yaw_rate.time_ns
    units = (readings.wheel_speed, readings.steering, readings.pitch, readings.roll)
    others = [_newest(one, time_ns) for one in units]
    columns = zip(time_ns.tolist(), readings.yaw_rate.value.tolist(), *others, strict=True)
    names = ("time_ns", "yaw_rate_rad_s", "wheel_speed_m_s", "steering_angle_rad", "pitch_rad", "roll_rad")
    return [Motion(**dict(zip(names, row, strict=True))) for row in columns]


def suspension_messages(readings: VehicleReadings, sensors: SensorSet) -> list[Suspension]:
    """One a reading of the stroke sensor; none for a rigid body."""
    if readings.stroke is None:
        return []
    sigma_m = sensors.stroke_stated_sigma_m
    return [
        Suspension(time_ns=t, stroke_height_m=height_m, stroke_sigma_m=sigma_m)
        for t, height_m in _known(readings.stroke)
    ]


def ranging_messages(readings: VehicleReadings, sensors: SensorSet, body: VehicleBody) -> list[Ranging]:
    """One a distance that was measured; what was lost is left out. The angle is the nominal one."""
    sigma_m, angle_rad = sensors.ranging.stated_sigma_m, body.ranging_angle_rad
    return [
        Ranging(time_ns=t, distance_m=distance_m, beam_angle_rad=angle_rad, distance_sigma_m=sigma_m)
        for t, distance_m in _known(readings.ranging)
    ]


def _known(readings: Readings) -> list[tuple[int, float]]:
    pairs = zip(readings.time_ns.tolist(), readings.value.tolist(), strict=True)
    return [(t, value) for t, value in pairs if not math.isnan(value)]


def _newest(readings: Readings, time_ns: Integers) -> list[float | None]:
    k = np.searchsorted(readings.time_ns, time_ns, side="right") - 1
    fresh = (k >= 0) & (time_ns - readings.time_ns[k] <= OLDEST_NS)
    values = readings.value[k].tolist()
    return [value if new else None for value, new in zip(values, fresh.tolist(), strict=True)]
