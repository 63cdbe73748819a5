"""What the localizer's pose filter takes in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.start_from_fixes import StartPose, StartProvenance
from camber.localizer.links.link_matching import LinkLine, LinkMatch
from camber.schemas.motion import Motion


def sample(
    time_ns: int,
    speed_m_s: float | None,
    yaw_rate_rad_s: float | None = 0.0,
    steering_rad: float | None = None,
) -> Motion:
    """Not validated: times begin anywhere, and readings may be out of range."""
    return Motion.model_construct(
        time_ns=time_ns,
        wheel_speed_m_s=speed_m_s,
        yaw_rate_rad_s=yaw_rate_rad_s,
        steering_angle_rad=steering_rad,
    )


def start_pose(
    time_ns: int,
    place: Floats | tuple[float, float, float | None],
    sigma_m: float = 0.1,
    yaw_deg: float = 0.5,
    provenance: StartProvenance = "given",
) -> StartPose:
    """`place`: east and north in m, yaw in rad or None where it is not known; σ of the position and of the yaw."""
    east_m, north_m, yaw_rad = place
    covariance = np.diag([sigma_m**2, sigma_m**2, math.radians(yaw_deg) ** 2])
    return StartPose(
        time_ns=time_ns,
        east_m=east_m,
        north_m=north_m,
        yaw_rad=yaw_rad,
        covariance=covariance,
        provenance=provenance,
    )


def link_match(line: LinkLine, sigma_m: float = 1.0, **more: Any) -> LinkMatch:
    """Link 1, followed forward, half a kilometre from its next bend."""
    matched = {"status": "matched", "link_id": 1, "forward": True, "level": 0, "candidates": (1,)}
    return LinkMatch(**matched | {"line": line, "sigma_m": sigma_m, "to_sharp_m": 500.0} | more)  # type: ignore[arg-type]


def line_through(start: tuple[float, float], end: tuple[float, float]) -> LinkLine:
    """Return the line from one point (east, north) to another."""
    alpha = math.atan2(end[1] - start[1], end[0] - start[0])
    return LinkLine(alpha, start[0] * math.sin(alpha) - start[1] * math.cos(alpha))
