"""Compile the matching of sweeps before the first one comes, by matching a synthetic street.

Machine code is cached on disk; with a cache this takes a second or two. `python -m camber.localizer.warm_up` fills
the cache for an image.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.given_pose import GivenPose
from camber.localizer.localization import Localization, LocalizationOptions, LocalizationOutput
from camber.localizer.map_queries import MapQueryFailure
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

FUNCTIONS = 23
"""Compiled functions that the warm-up calls from Python."""

# Chosen: any time, a tile at 35° of latitude, a sensor on a roof.
_TIME_NS = 1_400_000_000 * 1_000_000_000
_TILE = (57686, 25920)
# Chosen: any height, and the grid of the points.
_HEIGHT_M = 50.0
_STEP_M = 0.2
_MOUNT = SensorMount(z_m=1.8)
# Ten sweeps a second.
_TURN_NS = 100_000_000


def warm_up(sweeps: int = 3) -> list[LocalizationOutput]:
    """Localize in a synthetic street with walls and posts; return the output of each sweep."""
    road_m, walls_m = synthetic_street()
    frame = tile_frame(*_TILE)
    # Vague enough for the coarse search to be compiled too.
    given = GivenPose(
        latitude_deg=math.degrees(frame.latitude_rad),
        longitude_deg=math.degrees(frame.longitude_rad),
        yaw_deg=0.0,
        horizontal_sigma_m=1.0,
        yaw_sigma_deg=2.0,
    )
    options = LocalizationOptions(given=given, matching=ScanMatchOptions(mount=_MOUNT))
    localization = Localization(options, SyntheticMap(road_m, walls_m), NoDiagnostics())
    outputs = []
    for number in range(sweeps):
        time_ns = _TIME_NS + number * _TURN_NS
        at_rest = Motion(
            time_ns=time_ns, wheel_speed_m_s=0.0, yaw_rate_rad_s=0.0, roll_rad=0.0, pitch_rad=0.0
        )
        localization.on_motion(at_rest)
        localization.on_sweep(synthetic_sweep(time_ns, np.concatenate((road_m, walls_m))))
        outputs.append(localization.advance())
    return outputs


def synthetic_street() -> tuple[Floats, Floats]:
    """Return points (n, 3) of a level road, 140 m long, and of its walls and posts, in metres about its middle."""
    along, across = np.arange(-70.0, 70.0, _STEP_M), np.arange(-4.0, 4.0, _STEP_M)
    up = np.arange(0.1, 5.0, _STEP_M)
    road_m = np.array([(x, y, 0.0) for x in along for y in across])
    # Set-backs of the walls determine the position along the street.
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


def synthetic_sweep(time_ns: int, points_m: Floats) -> Sweep:
    """Return the sweep of a sensor at `_MOUNT` over the origin that sees all points (n, 3)."""
    about = points_m - np.array([_MOUNT.x_m, _MOUNT.y_m, _MOUNT.z_m])
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
    """A map of one tile with a level road and no links."""

    def __init__(self, road_m: Floats, environment_m: Floats) -> None:
        clouds: dict[Layer, Floats] = {"road_cloud": road_m, "environment_cloud": environment_m}
        self._blobs = {layer: encode(synthetic_tile(layer, points_m)) for layer, points_m in clouds.items()}

    def elevation(self, request: ElevationRequest) -> ElevationReply:
        """Return the same road everywhere."""
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

    def links(self, request: LinksRequest) -> MapQueryFailure:
        """Return no links."""
        return MapQueryFailure("refused", "a synthetic map has no links")

    def tile(self, request: TileRequest) -> TileReply:
        """Return the tile, in one part."""
        if (request.x, request.y) != _TILE:
            return TileReply(
                time_ns=request.time_ns, status="unknown", reason="none", payload=np.zeros(0, np.uint8)
            )
        blob = self._blobs[request.layer]
        return TileReply(
            time_ns=request.time_ns,
            status="known",
            sha256=hashlib.sha256(blob).hexdigest(),
            parts=1,
            payload=np.frombuffer(blob, np.uint8),
        )

    def is_available(self) -> bool:
        """Always."""
        return True


class NoDiagnostics:
    """Discards issues and counters."""

    def issue(self, code: str, text: str) -> None:
        """Discard an issue."""

    def count(self, name: str) -> None:
        """Discard a count."""


def synthetic_tile(layer: Layer, points_m: Floats) -> CloudTile:
    """Return points (n, 3) as a tile, about its centre."""
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
