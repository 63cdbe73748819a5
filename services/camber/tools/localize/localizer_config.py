"""The localizer's settings for a drive, by what its manifest says of the vehicle."""

from __future__ import annotations

from typing import Any

from camber.schemas.drive import DriveManifest, InitialPose


def localizer_config(manifest: DriveManifest, start: InitialPose | None) -> dict[str, Any]:
    """Places of antenna, LiDAR and IMU, the wheelbase, and the start of the drive if it is known without satellites."""
    arms = {"antenna": manifest.lever_arms.antenna, "lidar": manifest.lever_arms.lidar}
    places = {f"{name}_{axis}_m": getattr(arm, f"{axis}_m") for name, arm in arms.items() for axis in "xyz"}
    start_pose = {} if start is None else {"initial_pose": start.model_dump()}
    imu = _imu_settings(manifest)
    return {**places, **imu, "wheelbase_m": manifest.surrogates.wheelbase_m, **start_pose}


def _imu_settings(manifest: DriveManifest) -> dict[str, Any]:
    if manifest.imu is None:
        return {}
    fields = manifest.imu.model_dump(exclude={"file", "imu_class"})
    return {f"imu_{name}": value for name, value in fields.items()} | {"imu_class": manifest.imu.imu_class}
