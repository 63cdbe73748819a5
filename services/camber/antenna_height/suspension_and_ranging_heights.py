"""The antenna's height `h_a`, vertically above the road below it, by each method with its σ (JP7707657B2, third
embodiment).

Lever arms are points of the vehicle frame; `BodyAttitude` turns them with the body and puts the road's plane below.
The measured dimensions of the vehicle have one σ, `stored_sigma_m`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from camber.antenna_height.body_attitude import Arm, BodyAttitude
from camber.schemas.motion import Ranging, Suspension

LEAST_BEAM = math.sin(math.radians(15.0))
"""Chosen: a beam that meets the road at a flatter angle determines no height."""
_FAR_ARM_M = 0.5
"""Chosen: distance from the suspension, forward and to the side, of an antenna whose place is not known; JP7707657B2
eq. (1) takes the suspension nearest to it."""


class ImplausibleError(ValueError):
    """A measurement that cannot be of this vehicle on a road; the text says what was expected."""


@dataclass(frozen=True, slots=True)
class FixedHeight:
    """A stored value, measured once on level ground: antennas below the suspension, robots."""

    height_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StrokeGeometry:
    """JP7707657B2 eq. (1): `h_ba` and `h_t`. `suspension`: its position; None: not known."""

    suspension_to_antenna_m: float
    tyre_radius_m: float
    suspension: Arm | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RangingGeometry:
    """JP7707657B2 eq. (6) and (7): the sensor, and its beam's azimuth counter-clockwise from the vehicle's x."""

    sensor: Arm
    beam_azimuth_rad: float
    beam_sigma_rad: float


def stroke_height(
    measured: Suspension, attitude: BodyAttitude, geometry: StrokeGeometry, *, antenna: Arm | None
) -> tuple[float, ...]:
    """Return `h_a = h_ba + h_s + h_t`, JP7707657B2 eq. (1), and its σ by stroke and by attitude [m].

    Stroke and tyre are normal to the road. `h_ba` is that of a body parallel to it: one suspension does not observe
    what pitch and roll do between suspension and antenna, unless both positions are known.
    """
    h_ba_m, suspension = geometry.suspension_to_antenna_m, geometry.suspension
    rise = rise_error = Arm(0.0, 0.0, h_ba_m)
    if antenna is None or suspension is None:
        rise_error = Arm(_FAR_ARM_M, _FAR_ARM_M, h_ba_m)
    else:
        rise = rise_error = antenna.minus(suspension)._replace(z_m=h_ba_m)
    square_m = (measured.stroke_height_m + geometry.tyre_radius_m) * attitude.vertical_per_normal
    return square_m + attitude.rise_m(rise), measured.stroke_sigma_m, attitude.rise_sigma_m(rise_error)


def ranging_height(
    measured: Ranging, attitude: BodyAttitude, geometry: RangingGeometry, *, antenna: Arm
) -> tuple[float, ...]:
    """Return `h_a = h_gs + h_sa`, `h_gs = d sin θ`, JP7707657B2 eq. (6) and (7), for a tilted body on a sloping road.

    With it come its σ by distance, beam angle and attitude [m]. The beam leaves θ below the vehicle's horizontal; the
    road's plane goes through the point where it meets the road. Raises ImplausibleError for a beam that does not.
    """
    cos, sin = math.cos(measured.beam_angle_rad), math.sin(measured.beam_angle_rad)
    cos_az, sin_az = math.cos(geometry.beam_azimuth_rad), math.sin(geometry.beam_azimuth_rad)
    back = Arm(-cos * cos_az, -cos * sin_az, sin)
    by_angle = Arm(sin * cos_az, sin * sin_az, cos)
    by_distance = attitude.rise_m(back)
    if not by_distance >= LEAST_BEAM:
        raise ImplausibleError(
            f"a beam {math.degrees(measured.beam_angle_rad):.1f}° below the vehicle's horizontal, "
            f"expected one that meets the road at {math.degrees(math.asin(LEAST_BEAM)):.0f}° or more"
        )
    sensor_to_antenna = antenna.minus(geometry.sensor)
    arm = Arm(*(a + measured.distance_m * b for a, b in zip(sensor_to_antenna, back, strict=True)))
    return (
        attitude.rise_m(arm),
        by_distance * measured.distance_sigma_m,
        measured.distance_m * attitude.rise_m(by_angle) * geometry.beam_sigma_rad,
        attitude.rise_sigma_m(arm),
    )


def height_from_sensor(
    height_m: float, sigma_m: float, attitude: BodyAttitude, *, sensor_to_antenna: Arm
) -> tuple[float, ...]:
    """Return the antenna's height by a sensor's height, vertically above the road below it, and its σ by both [m].

    The sensor's height is by matching, or by its ground returns (a ranging sensor of many beams).
    """
    rise_m = attitude.rise_m(sensor_to_antenna)
    return height_m + rise_m, sigma_m, attitude.rise_sigma_m(sensor_to_antenna)
