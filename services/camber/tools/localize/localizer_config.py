"""The localizer's settings for a drive, by what its manifest says of the vehicle."""

from __future__ import annotations

from typing import Any

from camber.schemas.drive import DriveManifest, InitialPose


def localizer_config(manifest: DriveManifest, start: InitialPose | None) -> dict[str, Any]:
    """Where antenna and LiDAR stand, the wheelbase, and where the drive begins if that is known without satellites."""
    antenna, lidar = manifest.lever_arms.antenna, manifest.lever_arms.lidar
    return {
        "antenna_x_m": antenna.x_m,
        "antenna_y_m": antenna.y_m,
        "antenna_z_m": antenna.z_m,
        "lidar_x_m": lidar.x_m,
        "lidar_y_m": lidar.y_m,
        "lidar_z_m": lidar.z_m,
        "wheelbase_m": manifest.surrogates.wheelbase_m,
        **({} if start is None else {"initial_pose": start.model_dump()}),
    }
