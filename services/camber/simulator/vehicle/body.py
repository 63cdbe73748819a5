"""What a simulated vehicle is: where things are on it, and how its body rests on its wheels.

Points are in the vehicle frame (x forward, y left, z up, origin on the road below the middle of the rear axle) of
the vehicle at rest on flat road, with its nominal tyres and no load.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Mode:
    """One degree of freedom of the body on its springs: q'' + 2 ζ ω q' + ω² q = what drives it."""

    natural_frequency_hz: float
    damping_ratio: float

    @property
    def natural_frequency_rad_s(self) -> float:
        """ω, without damping."""
        return 2.0 * math.pi * self.natural_frequency_hz


@dataclass(frozen=True, slots=True, kw_only=True)
class Springs:
    """How the body moves on its springs, and what a load does to it.

    `dive_rad_s2_m`: pitch (nose down positive) for each m/s² of specific force *backwards*, so braking
    dives and a climb squats. `lean_rad_s2_m`: roll (left side up positive) for each m/s² to the left: a
    curve to the left lifts the left side. The load effects are for each kilogram in the boot: down at the middle of
    the wheelbase, nose up, and smaller tyres.
    """

    heave: Mode
    pitch: Mode
    roll: Mode
    dive_rad_s2_m: float
    lean_rad_s2_m: float
    sinking_m_kg: float
    nose_up_rad_kg: float
    tyre_shrinking_m_kg: float
    stroke_m: float
    """Stroke height `h_s` of JP7707657B2 eq. (1) at rest: the top of the suspension above the wheel's centre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleBody:
    """One vehicle. `suspension` None: the body is rigid on its wheels, and there is no stroke.

    `lidar` and `ranging` are those sensors' origins, axes parallel to the vehicle's; `wheel` is the point whose
    forward speed the wheel sensors give. The ranging beam leaves at `ranging_azimuth_rad` (counter-clockwise from x)
    and `ranging_angle_rad` below the vehicle's horizontal, θ of JP7707657B2 eq. (6).
    """

    name: str
    wheelbase_m: float
    track_m: float
    tyre_radius_m: float
    antenna: Point
    lidar: Point
    wheel: Point
    ranging: Point
    ranging_azimuth_rad: float
    ranging_angle_rad: float
    suspension: Springs | None

    @property
    def stroke_point(self) -> tuple[float, float]:
        """x, y of the wheel whose suspension is nearest to the antenna; of two alike the left one."""
        corners = [(x, y) for x in (0.0, self.wheelbase_m) for y in (0.5 * self.track_m, -0.5 * self.track_m)]
        return min(corners, key=lambda c: math.hypot(c[0] - self.antenna[0], c[1] - self.antenna[1]))

    @property
    def suspension_to_antenna_m(self) -> float | None:
        """`h_ba` of JP7707657B2 eq. (1), as measured at rest: h_a − h_s − h_t. None for a rigid body."""
        if self.suspension is None:
            return None
        return self.antenna[2] - self.suspension.stroke_m - self.tyre_radius_m


CAR = VehicleBody(
    name="car",
    wheelbase_m=2.70,
    track_m=1.55,
    tyre_radius_m=0.317,
    antenna=(0.30, 0.45, 1.58),
    lidar=(1.10, 0.0, 1.95),
    wheel=(0.0, 0.0, 0.0),
    ranging=(-0.90, 0.45, 0.95),
    ranging_azimuth_rad=math.pi,
    ranging_angle_rad=math.radians(70.0),
    # 1.3 Hz and 0.3 are common for passenger cars; 1.5° of pitch and 4° of roll at 1 g; 100 kg sink it by 10 mm.
    suspension=Springs(
        heave=Mode(1.3, 0.30),
        pitch=Mode(1.5, 0.30),
        roll=Mode(1.7, 0.25),
        dive_rad_s2_m=math.radians(1.5) / STANDARD_GRAVITY_M_S2,
        lean_rad_s2_m=math.radians(4.0) / STANDARD_GRAVITY_M_S2,
        sinking_m_kg=1.0e-4,
        nose_up_rad_kg=6.0e-5,
        tyre_shrinking_m_kg=1.0e-5,
        stroke_m=0.42,
    ),
)
"""A compact car with its antenna on the roof, near the left rear suspension."""

ROBOT = VehicleBody(
    name="robot",
    wheelbase_m=0.55,
    track_m=0.48,
    tyre_radius_m=0.125,
    antenna=(0.10, 0.0, 0.62),
    lidar=(0.35, 0.0, 0.75),
    wheel=(0.0, 0.0, 0.0),
    ranging=(-0.12, 0.0, 0.30),
    ranging_azimuth_rad=math.pi,
    ranging_angle_rad=math.radians(75.0),
    suspension=None,
)
"""A delivery robot without springs: its antenna's height is fixed."""
