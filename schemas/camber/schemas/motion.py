"""From the vehicle's own sensors."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from camber.schemas.base import Angle, Message, Model, Sigma, Speed

ImuClass = Literal["phone", "mems", "tactical"]
"""How accurate an inertial measurement unit is: that of a phone, of a vehicle or machine, of an aircraft or better."""
_AngularRate = Annotated[float, Field(ge=-35.0, le=35.0)]
_SpecificForce = Annotated[float, Field(ge=-400.0, le=400.0)]
_Turn = Annotated[float, Field(ge=-180.0, le=180.0)]


class Motion(Message):
    """One sample of the vehicle's motion; a sensor that gave nothing is None."""

    wheel_speed_m_s: Speed | None = Field(None, description="along the vehicle's x, backwards negative")
    yaw_rate_rad_s: Annotated[float, Field(ge=-20.0, le=20.0)] | None = Field(
        None, description="counter-clockwise positive, seen from above"
    )
    steering_angle_rad: Angle | None = Field(
        None, description="of the equivalent front wheel, to the left positive"
    )
    pitch_rad: Angle | None = Field(None, description="of the body against the vertical, nose down positive")
    roll_rad: Angle | None = Field(
        None, description="of the body against the vertical, left side up positive"
    )


class Imu(Message):
    """One sample of an inertial measurement unit, in the sensor's axes."""

    angular_rate_rad_s: tuple[_AngularRate, _AngularRate, _AngularRate] = Field(
        description="about x, y and z, by the right-hand rule"
    )
    specific_force_m_s2: tuple[_SpecificForce, _SpecificForce, _SpecificForce] = Field(
        description="along x, y and z; at rest on level ground with z up: 0, 0, 9.8"
    )
    temperature_c: Annotated[float, Field(ge=-100.0, le=200.0)] | None = Field(
        None, description="of the sensor"
    )


class Suspension(Message):
    """Stroke height `h_s` of JP7707657B2 eq. (1), at the suspension nearest to the antenna."""

    stroke_height_m: Annotated[float, Field(ge=-2.0, le=5.0)]
    stroke_sigma_m: Sigma


class Ranging(Message):
    """Distance `d` and beam angle `θ` of JP7707657B2 eq. (6)."""

    distance_m: Annotated[float, Field(ge=0.0, le=100.0)]
    beam_angle_rad: Angle = Field(description="below the horizontal of the vehicle, positive downwards")
    distance_sigma_m: Sigma


class LeverArm(Model):
    """A point in the vehicle frame: x forward, y left, z up, metres from the vehicle's origin (on the road, below the
    middle of the rear axle)."""

    x_m: Annotated[float, Field(ge=-50.0, le=50.0)] = 0.0
    y_m: Annotated[float, Field(ge=-50.0, le=50.0)] = 0.0
    z_m: Annotated[float, Field(ge=-50.0, le=50.0)] = 0.0


class MountedImu(LeverArm):
    """Where an inertial measurement unit is, how it is turned against the vehicle, and how accurate it is."""

    imu_class: ImuClass = Field(alias="class", description="noise class: phone, mems or tactical")
    roll_deg: _Turn = Field(0.0, description="against the vehicle, left side up")
    pitch_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = Field(
        0.0, description="against the vehicle, nose down"
    )
    yaw_deg: _Turn = Field(0.0, description="against the vehicle, counter-clockwise")
