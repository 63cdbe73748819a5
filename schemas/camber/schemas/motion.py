"""From the vehicle's own sensors."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from camber.schemas.base import Angle, Message, Model, Sigma, Speed


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
