"""IMU packets of Ouster's sensors: one sample each, with accelerations in g and angular rates in °/s.

Source: "IMU data packet format" of Ouster's firmware manual (profile LEGACY): times of the sensor's diagnosis, of
reading the accelerometer and of reading the gyro, then both along and about x, y, z.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from camber.formats.lidar_can.firings import Float64
from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2

_PACKET: Final = struct.Struct("<3Q6f")

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class OusterImuSample:
    """In the axes of the sensor frame; `stamp_ns` is the time of reading the gyro, by the sensor's clock."""

    stamp_ns: int
    angular_rate_rad_s: Vector
    specific_force_m_s2: Vector


def read_imu_packet(payload: bytes, sensor_from_imu: Float64) -> OusterImuSample | str:
    """Return the sample of a packet, or why it is refused; `sensor_from_imu` (3, 3) is of the metadata."""
    if len(payload) != _PACKET.size:
        return f"a packet of {len(payload)} bytes, expected {_PACKET.size}"
    _, _, stamp_ns, *values = _PACKET.unpack(payload)
    if not np.isfinite(values).all():
        return "a packet with numbers that are not finite"
    force = sensor_from_imu @ np.array(values[:3]) * STANDARD_GRAVITY_M_S2
    rate = sensor_from_imu @ np.array(values[3:]) * math.radians(1.0)
    return OusterImuSample(
        stamp_ns=stamp_ns,
        angular_rate_rad_s=(float(rate[0]), float(rate[1]), float(rate[2])),
        specific_force_m_s2=(float(force[0]), float(force[1]), float(force[2])),
    )
