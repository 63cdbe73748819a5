"""The message of a scan match."""

from __future__ import annotations

from typing import Any

import numpy as np

from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.ground_alignment import SensorHeights
from camber.localizer.matching.layered_matching import LayeredMatch, MatchStatus
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.pose import ScanMatch


def scan_match_message(
    time_ns: int,
    verdict: tuple[MatchStatus, str],
    match: LayeredMatch,
    *,
    heights: SensorHeights,
    mount: SensorMount,
    block: MapBlock,
) -> ScanMatch:
    """Return the message of a match with its status and reason."""
    status, reason = verdict
    if status == "lost":
        return ScanMatch(time_ns=time_ns, status="lost", reason=reason, **_layer_distances(match))
    sensor_m = (heights.map_from_vehicle @ mount.vehicle_from_sensor)[:3, 3]
    latitude_rad, longitude_rad = block.geodetic(float(sensor_m[0]), float(sensor_m[1]))
    c = match.covariance
    overlaps = [layer.fit.overlap for layer in match.layers if layer.outcome == "used"]
    return ScanMatch(
        time_ns=time_ns,
        status=status,
        reason=reason,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=float(sensor_m[2]) + block.base_height_m,
        sensor_height_m=heights.matched_m,
        sensor_height_sigma_m=heights.matched_sigma_m,
        ground_height_m=heights.ground_m,
        ground_height_sigma_m=heights.ground_sigma_m,
        road_slope_forward=heights.slope_forward,
        road_slope_left=heights.slope_left,
        roll_pitch_yaw_rad=roll_pitch_yaw_from_rotation(heights.map_from_vehicle),
        covariance_east_north=(float(c[0, 0]), float(c[0, 1]), float(c[1, 1])),
        overlap=float(np.mean(overlaps)) if overlaps else None,
        **_layer_distances(match),
    )


def _layer_distances(match: LayeredMatch) -> dict[str, Any]:
    """Return the layers that had correspondences, and their mean distances."""
    distances = np.array([layer.mean_distance_m for layer in match.layers])
    layer = np.flatnonzero(np.isfinite(distances))
    return {"layer": layer.astype(np.int32), "layer_mean_distance_m": distances[layer]}
