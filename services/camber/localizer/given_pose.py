"""A pose that is given at the start, known without satellites."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from camber.localizer.filter.planar_pose import covariance_at_offset, rotated
from camber.localizer.filter.start_from_fixes import StartPose
from camber.localizer.local_plane import LocalPlane


class GivenPose(BaseModel):
    """Where the antenna is at the start, known without satellites: a parking place, an operator."""

    model_config = ConfigDict(extra="forbid")
    latitude_deg: float = Field(ge=-90.0, le=90.0, description="latitude of the antenna")
    longitude_deg: float = Field(ge=-180.0, le=180.0, description="longitude of the antenna")
    yaw_deg: float = Field(
        ge=-360.0, le=360.0, description="direction of the vehicle's x, counter-clockwise from east"
    )
    horizontal_sigma_m: float = Field(gt=0.0, le=1000.0, description="σ in east and in north")
    yaw_sigma_deg: float = Field(gt=0.0, le=180.0, description="σ of yaw_deg")

    def plane(self) -> LocalPlane:
        """Return a plane around it."""
        return LocalPlane(math.radians(self.latitude_deg), math.radians(self.longitude_deg))

    def start_pose(self, time_ns: int, plane: LocalPlane, antenna_m: tuple[float, float]) -> StartPose:
        """Return it as of the vehicle's reference point in a plane; the antenna is x forward, y left of that."""
        east_m, north_m = plane.east_north(math.radians(self.latitude_deg), math.radians(self.longitude_deg))
        yaw_rad, yaw_sigma_rad = math.radians(self.yaw_deg), math.radians(self.yaw_sigma_deg)
        lever = rotated(yaw_rad, *antenna_m)
        position_var = self.horizontal_sigma_m**2
        at_antenna = np.diag([position_var, position_var, yaw_sigma_rad**2])
        return StartPose(
            time_ns=time_ns,
            east_m=east_m - lever[0],
            north_m=north_m - lever[1],
            yaw_rad=yaw_rad,
            covariance=covariance_at_offset(at_antenna, -lever[0], -lever[1]),
            provenance="given",
        )
