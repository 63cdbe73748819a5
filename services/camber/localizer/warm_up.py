"""Compile the matching of sweeps before the first one comes: a made-up street is matched.

The compiled code is kept on disk; where it is there already this takes a second or two. `python -m
camber.localizer.warm_up` does it ahead, for an image.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from camber.localizer.localization import GivenStart, Localization, LocalizationOptions, Step
from camber.localizer.map_queries import NoAnswer
from camber.localizer.matching.scan_matcher import ScanMatchOptions
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.road_map.tile_grid import tile_frame
from camber.schemas.codec import encode
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.schemas.pose import Road
from camber.schemas.road import (
    CloudTile,
    ElevationReply,
    ElevationRequest,
    Layer,
    LinksRequest,
    TileReply,
    TileRequest,
)

Array = NDArray[np.float64]

_TIME_NS = 1_400_000_000 * 1_000_000_000
_TILE = (57686, 25920)
_HEIGHT_M = 50.0
_STEP_M = 0.2
_MOUNT = SensorMount(0.0, 0.0, 1.8)
_TURN_NS = 100_000_000


def warm_up(sweeps: int = 3) -> list[Step]:
    """Drive through a made-up street with walls and posts; returns what came out."""
    road_m, walls_m = synthetic_street()
    answers, frame = SyntheticMap(road_m, walls_m), tile_frame(*_TILE)
    # Vague enough for the search around to be made ready too.
    given = GivenStart(frame.latitude_rad, frame.longitude_rad, 0.0, 1.0, math.radians(2.0))
    options = LocalizationOptions(given=given, matching=ScanMatchOptions(mount=_MOUNT))
    localization = Localization(options, answers, NoDiagnostics())
    steps = []
    for number in range(sweeps):
        time_ns = _TIME_NS + number * _TURN_NS
        localization.on_motion(
            Motion(
                time_ns=time_ns,
                wheel_speed_m_s=0.0,
                yaw_rate_rad_s=0.0,
                steering_angle_rad=0.0,
                roll_rad=0.0,
                pitch_rad=0.0,
            )
        )
        localization.on_sweep(synthetic_sweep(time_ns, np.concatenate((road_m, walls_m))))
        steps.append(localization.advance())
    return steps


def synthetic_street() -> tuple[Array, Array]:
    """Points (n, 3) of a level road and of what stands beside it, in metres about its middle, 140 m long."""
    along, across = np.arange(-70.0, 70.0, _STEP_M), np.arange(-4.0, 4.0, _STEP_M)
    up = np.arange(0.1, 5.0, _STEP_M)
    road_m = np.array([(x, y, 0.0) for x in along for y in across])
    # Walls with set-backs: what tells the place along the street.
    walls = [
        (x, side * (7.0 + 1.5 * (math.sin(0.13 * x + side) > 0.4)), z)
        for x in along
        for side in (-1, 1)
        for z in up
    ]
    ends = [
        (x, side * y, z)
        for x in (-52.0, -31.0, -12.0, 9.0, 27.0, 55.0)
        for side in (-1, 1)
        for y in np.arange(5.0, 7.0, _STEP_M)
        for z in up
    ]
    return road_m, np.array(walls + ends)


def synthetic_sweep(time_ns: int, seen_m: Array) -> Sweep:
    """What a sensor at the origin, `_MOUNT` above it, gives of points (n, 3), as if nothing hid anything."""
    about = seen_m - np.array([_MOUNT.x_m, _MOUNT.y_m, _MOUNT.z_m])
    about = about[(np.hypot(about[:, 0], about[:, 1]) < 50.0) & (np.hypot(about[:, 0], about[:, 1]) > 2.0)]
    share = (np.arctan2(about[:, 1], about[:, 0]) + math.pi) / (2.0 * math.pi)
    order = np.argsort(share, kind="stable")
    return Sweep(
        time_ns=time_ns,
        sensor="made-up",
        points_m=about[order].astype(np.float32),
        intensity=np.zeros(len(order), np.float32),
        offset_ns=np.rint((share[order] - 1.0) * _TURN_NS).astype(np.int32),
    )


class SyntheticMap:
    """Answers for one tile with a level road; no links."""

    def __init__(self, road_m: Array, standing_m: Array) -> None:
        clouds: dict[Layer, Array] = {"road_cloud": road_m, "environment_cloud": standing_m}
        self._blobs = {layer: encode(synthetic_tile(layer, points_m)) for layer, points_m in clouds.items()}

    def elevation(self, request: ElevationRequest) -> ElevationReply:
        """The same everywhere."""
        road = Road(
            status="known",
            surface_id=1,
            level=0,
            elevation_m=_HEIGHT_M,
            sigma_m=0.02,
            slope_east=0.0,
            slope_north=0.0,
            extent_m=5.0,
            datum="WGS84",
            map_version=1,
        )
        return ElevationReply(time_ns=request.time_ns, road=road)

    def links(self, request: LinksRequest) -> NoAnswer:
        """None."""
        return NoAnswer("refused", "a made-up map has no links")

    def tile(self, request: TileRequest) -> TileReply:
        """The one tile, in one part."""
        blob = self._blobs[request.layer] if (request.x, request.y) == _TILE else None
        if blob is None:
            return TileReply(
                time_ns=request.time_ns, status="unknown", reason="none", payload=np.zeros(0, np.uint8)
            )
        return TileReply(
            time_ns=request.time_ns,
            status="known",
            sha256=hashlib.sha256(blob).hexdigest(),
            parts=1,
            payload=np.frombuffer(blob, np.uint8),
        )

    def is_there(self) -> bool:
        """It is."""
        return True


class NoDiagnostics:
    """Nobody listens."""

    def issue(self, code: str, text: str) -> None:
        """Nothing."""

    def count(self, name: str) -> None:
        """Nothing."""


def synthetic_tile(layer: Layer, points_m: Array) -> CloudTile:
    """Points (n, 3) as a tile about whose centre they are."""
    return CloudTile(
        time_ns=_TIME_NS,
        x=_TILE[0],
        y=_TILE[1],
        layer=layer,
        base_height_m=_HEIGHT_M,
        resolution_m=0.005,
        quanta=np.rint(points_m / 0.005).astype(np.int32),
    )


if __name__ == "__main__":
    warm_up()
