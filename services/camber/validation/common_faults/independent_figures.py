"""How good a drive's independent positions are: where there is one, its σ, its error, and whether the two agree."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from camber.replay.single_process_replay import DriveOutput
from camber.schemas.base import Float64
from camber.validation.common_faults.drive import FaultDrive
from camber.validation.reference_trajectory import truth_of

CHI2_99 = -2.0 * math.log(0.01)
"""Of two degrees of freedom."""


def independent_figures(drive: FaultDrive, output: DriveOutput, *, least_driven_m: float) -> dict[str, Any]:
    """Shares and metres over the poses that are so far from the drive's beginning; None without an independent one."""
    poses = [item.message for item in output.recorded["pose"]]
    driven_m = np.interp([pose.time_ns for pose in poses], drive.truth.time_ns, drive.truth.more["driven_m"])
    poses = [pose for pose, at_m in zip(poses, driven_m.tolist(), strict=True) if at_m >= least_driven_m]
    there = [(pose.time_ns, pose.independent) for pose in poses if pose.independent is not None]
    if not there:
        return {"independent_share": 0.0 if poses else None}
    columns: Float64 = np.array(
        [(i.latitude_rad, i.longitude_rad, *i.covariance_east_north) for _, i in there]
    )
    latitude, longitude, ee, en, nn = columns.T
    error_m = truth_of(drive.truth).error_enu_m(
        np.array([time_ns for time_ns, _ in there], np.int64),
        latitude,
        longitude,
        np.zeros(len(there)),
        offset_enu_m=(0.0, 0.0, 0.0),
    )
    east, north = error_m[:, 0], error_m[:, 1]
    squared = (nn * east**2 - 2.0 * en * east * north + ee * north**2) / (ee * nn - en**2)
    widest = np.sqrt(0.5 * (ee + nn) + np.hypot(0.5 * (ee - nn), en))
    return {
        "independent_share": len(there) / len(poses),
        "independent_sigma_m": float(np.median(widest)),
        "independent_error_m": float(np.median(np.hypot(east, north))),
        "independent_error_95_m": float(np.quantile(np.hypot(east, north), 0.95)),
        "independent_inside_99": float((squared <= CHI2_99).mean()),
        "independent_worst_ratio": float(np.sqrt(squared.max())),
    }
