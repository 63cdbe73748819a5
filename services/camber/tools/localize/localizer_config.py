"""The localizer's settings for a drive, by what its manifest says of the vehicle."""

from __future__ import annotations

from typing import Any

from camber.schemas.drive import DriveManifest, InitialPose


def localizer_config(manifest: DriveManifest, start: InitialPose | None) -> dict[str, Any]:
    """Where antenna and LiDAR stand, the wheelbase, and where the drive begins if that is known without satellites."""
    arms = {"antenna": manifest.lever_arms.antenna, "lidar": manifest.lever_arms.lidar}
    places = {f"{name}_{axis}_m": getattr(arm, f"{axis}_m") for name, arm in arms.items() for axis in "xyz"}
    start_pose = {} if start is None else {"initial_pose": start.model_dump()}
    return {**places, "wheelbase_m": manifest.surrogates.wheelbase_m, **start_pose}
