"""The ways to know the antenna's height `h_a`, vertically above the road below it, each with its σ (H, embodiment 3).

Lever arms are points of the vehicle frame; `Stance` turns them with the body and lays the road below. What was stored
of the vehicle has one σ for a way, `stored_sigma_m`.
"""

from __future__ import annotations

import math

from camber.antenna_height.body_attitude import Arm, Stance
from camber.schemas.antenna import HeightByMethod, HeightMethod

LEAST_BEAM = math.sin(math.radians(15.0))
"""A beam that meets the road flatter than this says nothing of a height."""
_FAR_ARM_M = 0.5
"""So far from the suspension, forward and to the side, may an antenna be whose place is not known: H (1) takes the
suspension nearest to it."""


class ImplausibleError(ValueError):
    """A measurement that cannot be of this vehicle on a road; the words say what was expected."""


def fixed_height(height_m: float, sigma_m: float, stance: Stance | None = None) -> HeightByMethod:
    """A stored value, measured once on level ground: antennas below the suspension, robots."""
    upright = 1.0 if stance is None else stance.upright
    return HeightByMethod(way="fixed", height_m=height_m * upright, sigma_m=sigma_m)


def stroke_height(
    stroke_m: float,
    stroke_sigma_m: float,
    stance: Stance,
    *,
    suspension_to_antenna_m: float,
    tyre_radius_m: float,
    arm: Arm | None,
    stored_sigma_m: float,
) -> HeightByMethod:
    """`h_a = h_ba + h_s + h_t`, H (1), all metres.

    Stroke and tyre are square to the road. `arm` goes from the suspension to the antenna, level (its z is `h_ba`): what
    the body's pitch and roll do there, one suspension does not see. None: not known.
    """
    far = Arm(_FAR_ARM_M, _FAR_ARM_M, suspension_to_antenna_m)
    body = Arm(*(arm[:2] if arm is not None else (0.0, 0.0)), suspension_to_antenna_m)
    return _height(
        "stroke",
        (stroke_m + tyre_radius_m) * stance.upright + stance.rise_m(body),
        stroke_sigma_m,
        stance.rise_sigma_m(body if arm is not None else far),
        stored_sigma_m,
    )


def ranging_height(
    distance_m: float,
    distance_sigma_m: float,
    beam_angle_rad: float,
    stance: Stance,
    *,
    sensor_to_antenna: Arm,
    beam_azimuth_rad: float,
    beam_sigma_rad: float,
    stored_sigma_m: float,
) -> HeightByMethod:
    """`h_gs = d sin θ`, `h_a = h_gs + h_sa`, H (6) (7), for a body that is tilted on a road that slopes.

    The beam leaves at `beam_azimuth_rad` (counter-clockwise from the vehicle's x), θ below the vehicle's horizontal.
    From where it meets the road the antenna is `sensor_to_antenna` less the beam away; the road's plane goes through
    there. Raises ImplausibleError for a beam that does not meet the road.
    """
    cos, sin = math.cos(beam_angle_rad), math.sin(beam_angle_rad)
    cos_az, sin_az = math.cos(beam_azimuth_rad), math.sin(beam_azimuth_rad)
    back = Arm(-cos * cos_az, -cos * sin_az, sin)
    sideways = Arm(sin * cos_az, sin * sin_az, cos)
    by_distance = stance.rise_m(back)
    if not by_distance >= LEAST_BEAM:
        raise ImplausibleError(
            f"a beam {math.degrees(beam_angle_rad):.1f}° below the vehicle's horizontal, "
            f"expected one that meets the road at {math.degrees(math.asin(LEAST_BEAM)):.0f}° or more"
        )
    arm = Arm(*(a + distance_m * b for a, b in zip(sensor_to_antenna, back, strict=True)))
    return _height(
        "ranging",
        stance.rise_m(arm),
        by_distance * distance_sigma_m,
        distance_m * stance.rise_m(sideways) * beam_sigma_rad,
        stance.rise_sigma_m(arm),
        stored_sigma_m,
    )


def height_from_sensor(
    way: HeightMethod,
    sensor_height_m: float,
    sensor_sigma_m: float,
    stance: Stance,
    *,
    sensor_to_antenna: Arm,
    stored_sigma_m: float,
) -> HeightByMethod:
    """From a surround sensor's own height, vertically above the road below it: by matching, or by its ground returns
    (a ranging sensor of many beams)."""
    return _height(
        way,
        sensor_height_m + stance.rise_m(sensor_to_antenna),
        sensor_sigma_m,
        stance.rise_sigma_m(sensor_to_antenna),
        stored_sigma_m,
    )


def _height(way: HeightMethod, height_m: float, *sigmas_m: float) -> HeightByMethod:
    if not -1.0 <= height_m <= 100.0:
        raise ImplausibleError(f"the antenna {height_m:.3f} m above the road, expected -1 m to 100 m")
    return HeightByMethod(way=way, height_m=height_m, sigma_m=math.hypot(*sigmas_m))
