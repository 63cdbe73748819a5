"""Ground alignment of the local map to the map's road (JP2016-109650A, step 10), and the sensor's height above
the road."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.geodesy.se3 import invert, map_from_vehicle, transform_points
from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.road_registration import RoadFit, fit_road
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.road.ground_plane_fit import REACH_M, GroundPlane, road_line

RoadBy: TypeAlias = Literal["surface", "line"]

_ABOVE_ROAD_M: Final = 8.0  # chosen: a sensor farther than this from the map's road is not above it


class PlanarPose(NamedTuple):
    """East, north [m] and yaw [rad] in the frame of a block."""

    east_m: float
    north_m: float
    yaw_rad: float


class GroundAlignment(NamedTuple):
    """map_from_local (4, 4) in the block's frame, heights (n,) of the local map above the road, and the fit to the
    road; None where the local map has no ground: then it lies on the map's road."""

    map_from_local: Floats
    heights_m: Floats
    road: RoadFit | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensorHeights:
    """Height of the sensor above the road below it, vertically: by the match and the map's road, and by the sweep's
    ground, each with σ; slopes of the map's road forward and to the left. None: not known.

    `map_from_vehicle` (4, 4) is the match, with height, roll and pitch by the newest sweep where that has ground.
    `misplaced`: by the sweep's ground the sensor is not where its mount puts it.
    """

    map_from_vehicle: Floats
    misplaced: bool
    matched_m: float | None = None
    matched_sigma_m: float | None = None
    ground_m: float | None = None
    ground_sigma_m: float | None = None
    slope_forward: float | None = None
    slope_left: float | None = None


def align_to_road(
    points_m: Floats, block: MapBlock, pose: PlanarPose, *, near_m: float, by: RoadBy = "surface"
) -> GroundAlignment | None:
    """Align a local map (n, 3) at a pose to the road nearest to a height; None where the map has no road there.

    By the ground in the local map, or by the document's line through the map's road about the vehicle; by the line too
    where the local map has no ground.
    """
    here = block.road.elevation(pose.east_m, pose.north_m, near_m)
    surface = None if here is None else block.road.surface_through(pose.east_m, pose.north_m, here.height_m)
    if here is None or surface is None:
        return None
    forward, left = rotated(-pose.yaw_rad, here.slope_east, here.slope_north)
    pitch_rad = -math.atan(forward)
    roll_rad = math.atan(left * math.cos(pitch_rad))
    guess = map_from_vehicle(
        pose.east_m, pose.north_m, here.height_m, roll_rad=roll_rad, pitch_rad=pitch_rad, yaw_rad=pose.yaw_rad
    )
    heights_m = surface.height_above(transform_points(guess, points_m))
    fit = fit_road(points_m, heights_m, block.road_target, guess) if by == "surface" else None
    if fit is not None and fit.status == "lost":
        fit = None
    aligned = _on_line(guess, block) if fit is None else fit.map_from_local
    return GroundAlignment(aligned, surface.height_above(transform_points(aligned, points_m)), fit)


def _on_line(guess: Floats, block: MapBlock) -> Floats:
    """Return map_from_local (4, 4) with height and pitch by JP2016-109650A eq. (5) and (6); the guess with too little
    road in the map."""
    near = np.hypot(block.road_m[:, 0] - guess[0, 3], block.road_m[:, 1] - guess[1, 3]) < REACH_M
    line = road_line(transform_points(invert(guess), block.road_m[near]))
    if line is None:
        return guess
    aligned: Floats = guess @ line.local_from_road
    return aligned


def measure_sensor_heights(
    sweep_m: Floats, ground: GroundPlane | None, mount: SensorMount, *, matched: Floats, block: MapBlock
) -> SensorHeights:
    """Return the sensor's heights by a sweep (n, 3) in the vehicle frame, its ground, and its match (4, 4).

    By one sweep alone: motion of the body between sweeps tilts an overlay against the road.
    """
    road = _fit_sweep_to_road(sweep_m, matched, block)
    if road is not None:
        matched = road.map_from_local
    sensor_m = (matched @ mount.vehicle_from_sensor)[:3, 3]
    misplaced = ground is not None and ground.problem is not None
    here = block.road.elevation(float(sensor_m[0]), float(sensor_m[1]), float(sensor_m[2]) - mount.z_m)
    if here is None or here.distance_m > _ABOVE_ROAD_M:
        return SensorHeights(map_from_vehicle=matched, misplaced=misplaced)
    forward, left = rotated(-math.atan2(matched[1, 0], matched[0, 0]), here.slope_east, here.slope_north)
    matched_m = matched_sigma_m = None
    if road is not None and road.status == "converged":
        lever_m = np.array([1.0, mount.y_m, -mount.x_m])  # of up, roll, pitch
        matched_m = float(sensor_m[2]) - here.height_m
        matched_sigma_m = math.hypot(math.sqrt(float(lever_m @ road.covariance @ lever_m)), here.sigma_m)
    return SensorHeights(
        map_from_vehicle=matched,
        misplaced=misplaced,
        matched_m=matched_m,
        matched_sigma_m=matched_sigma_m,
        ground_m=None if ground is None else ground.height_m(math.hypot(forward, left)),
        ground_sigma_m=None if ground is None else ground.distance_sigma_m,
        slope_forward=forward,
        slope_left=left,
    )


def _fit_sweep_to_road(sweep_m: Floats, guess: Floats, block: MapBlock) -> RoadFit | None:
    """Fit the sweep's ground to the map's road; None where it has none."""
    surface = block.road.surface_through(float(guess[0, 3]), float(guess[1, 3]), float(guess[2, 3]))
    if surface is None:
        return None
    fit = fit_road(sweep_m, surface.height_above(transform_points(guess, sweep_m)), block.road_target, guess)
    return None if fit.status == "lost" else fit
