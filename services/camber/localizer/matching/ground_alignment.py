"""The local map set down on the map's road (M, step 10), and what follows: heights above it, and the sensor's own."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.se3 import invert, map_from_vehicle, transform_points
from camber.localizer.map_clouds.map_blocks import Block
from camber.localizer.matching.road_plane_fit import RoadFit, fit_road
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.road.road_attitude import REACH_M, GroundPlane, road_line

Array = NDArray[np.float64]
RoadBy: TypeAlias = Literal["surface", "line"]

_ROAD_SEEN_M = 8.0  # a sensor farther than this from the map's road is not above it


class GroundAlignment(NamedTuple):
    """map_from_local (4, 4) in the block's frame, heights (n,) of the local map above the road, and the fit to it,
    None where no road was seen: then it stands as the map's road lies."""

    map_from_local: Array
    heights_m: Array
    road: RoadFit | None


class SensorHeights(NamedTuple):
    """Above the road below the sensor, vertically: by the match and the map's road, and by its own returns, with σ;
    slopes of the map's road under the vehicle, along its heading and to the left. None: not known.

    `map_from_vehicle` (4, 4) is the match, with height, roll and pitch by the newest sweep where that shows the road.
    """

    map_from_vehicle: Array
    matched_m: float | None
    matched_sigma_m: float | None
    ground_m: float | None
    ground_sigma_m: float | None
    slope_forward: float | None
    slope_left: float | None
    misplaced: bool
    """By its own returns the sensor cannot be where its mount says."""


def align_to_road(
    points_m: Array,
    block: Block,
    east_m: float,
    north_m: float,
    yaw_rad: float,
    near_m: float,
    *,
    by: RoadBy = "surface",
) -> GroundAlignment | None:
    """A local map (n, 3) with its origin at a place in the block, on the road that is nearest to a height there.

    By the surface of the ground that it sees itself, or by the document's line through the map's road about the
    vehicle; by the line too where it sees no ground. None where the map has no road there.
    """
    here = block.road.elevation(east_m, north_m, near_m)
    surface = None if here is None else block.road.surface_through(east_m, north_m, here.height_m)
    if here is None or surface is None:
        return None
    forward, left = _along(here.slope_east, here.slope_north, yaw_rad)
    pitch_rad = -math.atan(forward)
    roll_rad = math.atan(left * math.cos(pitch_rad))
    guess = map_from_vehicle(east_m, north_m, here.height_m, roll_rad, pitch_rad, yaw_rad)
    heights_m = surface.height_above(transform_points(guess, points_m))
    fit = fit_road(points_m, heights_m, block.road_target, guess) if by == "surface" else None
    if fit is None or fit.status == "lost":
        placed = _on_line(guess, block)
        return GroundAlignment(placed, surface.height_above(transform_points(placed, points_m)), None)
    return GroundAlignment(
        fit.map_from_local, surface.height_above(transform_points(fit.map_from_local, points_m)), fit
    )


def _on_line(guess: Array, block: Block) -> Array:
    """map_from_local (4, 4) with height and pitch by M (5) and (6); the guess where the map has too little road."""
    near = np.hypot(block.road_m[:, 0] - guess[0, 3], block.road_m[:, 1] - guess[1, 3]) < REACH_M
    line = road_line(transform_points(invert(guess), block.road_m[near]))
    if line is None:
        return guess
    placed: Array = guess @ line.local_from_road
    return placed


def measure_sensor_heights(
    sweep_m: Array, own: GroundPlane | None, mount: SensorMount, map_from_vehicle_: Array, block: Block
) -> SensorHeights:
    """What a sweep (n, 3) in the vehicle frame, its own returns from the road, and where it was matched say.

    Of one sweep alone: what the body and the attitude do from sweep to sweep tilts an overlay against the road.
    """
    road = _road_of_sweep(sweep_m, map_from_vehicle_, block)
    if road is not None:
        map_from_vehicle_ = road.map_from_local
    sensor_m = (map_from_vehicle_ @ mount.vehicle_from_sensor)[:3, 3]
    yaw_rad = math.atan2(map_from_vehicle_[1, 0], map_from_vehicle_[0, 0])
    misplaced = own is not None and own.problem is not None
    here = block.road.elevation(float(sensor_m[0]), float(sensor_m[1]), float(sensor_m[2]) - mount.z_m)
    if here is None or here.distance_m > _ROAD_SEEN_M:
        return SensorHeights(map_from_vehicle_, None, None, None, None, None, None, misplaced)
    forward, left = _along(here.slope_east, here.slope_north, yaw_rad)
    matched_m = matched_sigma_m = None
    if road is not None and road.status == "converged":
        lever_m = np.array([1.0, mount.y_m, -mount.x_m])  # of up, roll, pitch
        matched_m = float(sensor_m[2]) - here.height_m
        matched_sigma_m = math.hypot(math.sqrt(float(lever_m @ road.covariance @ lever_m)), here.sigma_m)
    return SensorHeights(
        map_from_vehicle_,
        matched_m,
        matched_sigma_m,
        None if own is None else own.height_m(math.hypot(forward, left)),
        None if own is None else own.distance_sigma_m,
        forward,
        left,
        misplaced,
    )


def _road_of_sweep(sweep_m: Array, guess: Array, block: Block) -> RoadFit | None:
    """The sweep's road on the map's; None where it shows none."""
    surface = block.road.surface_through(float(guess[0, 3]), float(guess[1, 3]), float(guess[2, 3]))
    if surface is None:
        return None
    fit = fit_road(sweep_m, surface.height_above(transform_points(guess, sweep_m)), block.road_target, guess)
    return None if fit.status == "lost" else fit


def _along(slope_east: float, slope_north: float, yaw_rad: float) -> tuple[float, float]:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return slope_east * cos + slope_north * sin, -slope_east * sin + slope_north * cos
