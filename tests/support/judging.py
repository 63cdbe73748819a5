"""Inputs of the judge: a vehicle that drives east on a level road at 10 m/s, five epochs a second, all right."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from camber.geodesy.local_frame import LocalFrame
from camber.integrity.judge import Judge
from camber.integrity.judgement import FixJudgement
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Candidate, Fix
from camber.schemas.pose import IndependentPosition, Pose, Road

START_NS = 1_373_090_000 * 1_000_000_000
EPOCH_NS = 200_000_000
SPEED_M_S = 10.0
LATITUDE_RAD, LONGITUDE_RAD = 0.6137, 2.389
ROAD_M, ANTENNA_M = 40.0, 1.8
FRAME = LocalFrame(LATITUDE_RAD, LONGITUDE_RAD, ROAD_M + ANTENNA_M)
ALL = frozenset({"gnss", "localizer", "antenna_height", "map_server"})


def at(epoch: float) -> int:
    """Time of an epoch."""
    return START_NS + round(epoch * EPOCH_NS)


def place(epoch: float, east_m: float = 0.0, north_m: float = 0.0) -> tuple[float, float]:
    """Where the antenna is at an epoch, and metres beside it."""
    driven_m = SPEED_M_S * epoch * EPOCH_NS / 1e9
    return FRAME.geodetic_from_east_north(driven_m + east_m, north_m, ROAD_M + ANTENNA_M)[:2]


def fix(
    epoch: float = 0, *, up_m: float = 0.0, east_m: float = 0.0, north_m: float = 0.0, **changes: Any
) -> Fix:
    """A fix of an epoch, right but for the metres given."""
    latitude_rad, longitude_rad = place(epoch, east_m, north_m)
    fields: dict[str, Any] = {
        "time_ns": at(epoch),
        "fix_id": at(epoch) // 1_000_000,
        "origin": "receiver",
        "quality": "fixed",
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "height_m": ROAD_M + ANTENNA_M + up_m,
        "covariance_enu_m2": (2.5e-5, 0.0, 0.0, 2.5e-5, 0.0, 1e-4),
    }
    return Fix(**fields | changes)


def road(**changes: Any) -> Road:
    """The level road."""
    fields: dict[str, Any] = {
        "status": "known",
        "surface_id": 7,
        "elevation_m": ROAD_M,
        "sigma_m": 0.03,
        "slope_east": 0.0,
        "slope_north": 0.0,
        "extent_m": 20.0,
        "datum": "WGS84",
        "map_version": 3,
    }
    return Road(**fields | changes)


def pose(epoch: float = 0, *, sigma_m: float = 0.1, east_m: float = 0.0, **changes: Any) -> Pose:
    """The pose of an epoch, anchored by confirmed fixes."""
    latitude_rad, longitude_rad = place(epoch, east_m)
    fields: dict[str, Any] = {
        "time_ns": at(epoch),
        "mode": "anchored",
        "provenance": "confirmed",
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "yaw_rad": 0.0,
        "covariance_east_north_yaw": (sigma_m**2, 0.0, 0.0, sigma_m**2, 0.0, 1e-4),
        "speed_m_s": SPEED_M_S,
        "road": road(),
    }
    return Pose(**fields | changes)


def provisional(epoch: float = 0, **changes: Any) -> Pose:
    """The pose of an epoch that rests on unconfirmed fixes alone."""
    return pose(epoch, **{"mode": "provisional", "provenance": "fixes", **changes})


def independent(
    epoch: float = 0, *, sigma_m: float = 0.1, east_m: float = 0.0, north_m: float = 0.0, **changes: Any
) -> IndependentPosition:
    """The independent position of an epoch, by a scan match just now."""
    latitude_rad, longitude_rad = place(epoch, east_m, north_m)
    fields: dict[str, Any] = {
        "basis": "scan_match",
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "covariance_east_north": (sigma_m**2, 0.0, sigma_m**2),
        "evidence_time_ns": at(epoch),
        "distance_m": 0.0,
    }
    return IndependentPosition(**fields | changes)


def antenna(epoch: float = 0, **changes: Any) -> AntennaHeight:
    """The antenna's height at an epoch."""
    fields: dict[str, Any] = {
        "time_ns": at(epoch),
        "status": "known",
        "way": "fixed",
        "height_m": ANTENNA_M,
        "sigma_m": 0.02,
    }
    return AntennaHeight(**fields | changes)


def candidate(
    epoch: float = 0,
    *,
    up_m: float = 0.0,
    east_m: float = 0.0,
    north_m: float = 0.0,
    excluded: tuple[str, ...] = ("G05",),
    **changes: Any,
) -> Candidate:
    """Another estimate of an epoch's fix, right but for the metres given."""
    latitude_rad, longitude_rad = place(epoch, east_m, north_m)
    fields: dict[str, Any] = {
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "height_m": ROAD_M + ANTENNA_M + up_m,
        "covariance_enu_m2": (2.5e-5, 0.0, 0.0, 2.5e-5, 0.0, 1e-4),
        "excluded_satellites": excluded,
        "ambiguities": 10,
        "ratio": 5.0,
        "success_rate": 0.9,
        "agreeing_subsets": 2,
    }
    return Candidate(**fields | changes)


class SettlingJudge(Judge):
    """A judge that settles each judgement at once, or the one that `others` puts in its place."""

    def judge(
        self,
        fix: Fix,
        now_ns: int,
        alive: frozenset[str],
        others: Callable[[FixJudgement], FixJudgement] = lambda judgement: judgement,
    ) -> FixJudgement | None:
        """Return the judgement that was settled."""
        judgement = super().judge(fix, now_ns, alive)
        if judgement is None:
            return None
        judgement = others(judgement)
        self.settle(judgement)
        return judgement
