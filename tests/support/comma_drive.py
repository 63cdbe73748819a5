"""One minute of a real car's wheels, steering and yaw rate: the recording comma-2018-08-02, as `Motion` with its truth.

PYTHONPATH=tests python -m support.comma_drive

Sources: comma2k19's page (axes forward, right, down; wheels front left, front right, rear left, rear right) and the
recording's row in the README of CAMBER_DATA. The car is a RAV4, steering ratio and wheelbase by its specification. The
command prints errors of dead reckoning over windows that begin every second: before a window the pose is anchored by
the recording's true positions once a second, in it nothing but motion is used.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.geodesy.ellipsoid import geodetic_from_ecef_scalar
from camber.geodesy.local_frame import LocalFrame
from camber.localizer.arrays import Floats
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.schemas.motion import Motion
from support.pose_inputs import start_pose

FOLDER: Final = "comma-2018-08-02"
WHEELBASE_M: Final = 2.66  # Toyota's specification of the RAV4
STEERING_RATIO: Final = 16.88  # openpilot's parameters of this car
TRUTH_SIGMA_M: Final = 0.3  # "below a metre" at 95 %, per axis, of consecutive positions
ELLIPSE_99: Final = 9.2103  # χ² with two degrees of freedom
RELATIVE_SIGMA_M: Final = (
    0.15  # the truth's own, of a displacement over half a minute: its residual against the wheels
)
YAW_SIGMA_RAD: Final = math.radians(
    0.2
)  # of the truth: its yaw scatters by 0.12° about the integrated yaw rate
BEGIN_NS: Final = (2012 * 604_800 + 404_106) * 1_000_000_000  # GPS time of the first frame, whole seconds


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CommaDrive:
    """Motion, and the truth at times (n,): east, north (n, 2) [m], yaw (n,) [rad], distance driven (n,) [m]."""

    motion: list[Motion]
    time_ns: Floats
    position_m: Floats
    yaw_rad: Floats
    driven_m: Floats

    def truth(self, time_ns: int) -> tuple[float, float, float, float]:
        """East, north, yaw, distance at a time."""
        east, north = (float(np.interp(time_ns, self.time_ns, c)) for c in self.position_m.T)
        yaw, driven = (float(np.interp(time_ns, self.time_ns, c)) for c in (self.yaw_rad, self.driven_m))
        return east, north, yaw, driven


def folder() -> Path | None:
    """Where the recording is; None without it."""
    path = Path(os.environ.get("CAMBER_DATA", "")) / FOLDER
    return path if os.environ.get("CAMBER_DATA") and path.is_dir() else None


def read_drive(path: Path) -> CommaDrive:
    """The recording in `path`; yaw rate about the mean specific force, which on a minute's average points up."""

    def read(name: str) -> Floats:
        return np.asarray(np.load(path / name), dtype=np.float64)

    can, imu = "processed_log/CAN", "processed_log/IMU"
    frame_s, ecef_m = read("global_pose/frame_times"), read("global_pose/frame_positions")
    begin_s = float(frame_s[0])
    gyro_s, wheel_s, steering_s = (
        read(f"{imu}/gyro/t"),
        read(f"{can}/wheel_speed/t"),
        read(f"{can}/steering_angle/t"),
    )
    force = read(f"{imu}/accelerometer/value").mean(axis=0)
    rate = read(f"{imu}/gyro/value") @ (force / np.linalg.norm(force))
    wheels = read(f"{can}/wheel_speed/value")[:, 2:].mean(axis=1)  # rear: they do not drive
    steering = np.radians(read(f"{can}/steering_angle/value").reshape(-1)) / STEERING_RATIO
    rows = (
        np.searchsorted(gyro_s, wheel_s, side="right") - 1,
        np.searchsorted(steering_s, wheel_s, side="right") - 1,
    )
    motion = [
        Motion(
            time_ns=_ns(t - begin_s),
            wheel_speed_m_s=float(wheels[k]),
            yaw_rate_rad_s=float(rate[i]),
            steering_angle_rad=float(steering[j]),
        )
        for k, (t, i, j) in enumerate(zip(wheel_s.tolist(), *rows, strict=True))
        if i >= 0 and j >= 0 and frame_s[0] <= t <= frame_s[-1]
    ]
    to_enu = LocalFrame(*geodetic_from_ecef_scalar(*ecef_m[0].tolist())).enu_from_ecef_rotation().T
    position = (ecef_m - ecef_m[0]) @ to_enu
    velocity = read("global_pose/frame_velocities") @ to_enu
    forward = _forward(read("global_pose/frame_orientations")) @ to_enu
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    mounted = float(
        np.mean((yaw - course + math.pi) % math.tau - math.pi)
    )  # the camera against the direction of travel
    return CommaDrive(
        motion=motion,
        time_ns=np.array([_ns(t - begin_s) for t in frame_s.tolist()], dtype=np.float64),
        position_m=position[:, :2],
        yaw_rad=yaw - mounted,
        driven_m=np.append(0.0, np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T))),
    )


class Window(NamedTuple):
    """Error of dead reckoning at a window's end, along and across [m] and in yaw [rad]; the distance driven in it; the
    position's error squared by its covariance."""

    begin_s: float
    along_m: float
    across_m: float
    yaw_rad: float
    driven_m: float
    squared: float

    @property
    def share(self) -> float:
        """Error of the position by the distance driven."""
        return math.hypot(self.along_m, self.across_m) / self.driven_m


def windows(
    drive: CommaDrive, lasts_s: float, *, model: PoseModel | None = None, anchored: bool = True, seed: int = 1
) -> list[Window]:
    """Dead reckoning over all windows of a length that begin every second; the pose at their begin is the truth.

    `anchored`: before the window, true positions once a second, with an error of `TRUTH_SIGMA_M`, have been confirmed
    since the recording's begin. Otherwise the window is all that the filter knows.
    """
    first_ns = drive.motion[0].time_ns
    begins_s = np.arange(0.0, (drive.motion[-1].time_ns - first_ns) * 1e-9 - lasts_s, 1.0)
    begins_ns = [first_ns + round(begin_s * 1e9) for begin_s in begins_s.tolist()]
    rows = np.searchsorted([motion.time_ns for motion in drive.motion], begins_ns).tolist()
    rng = np.random.default_rng(seed)
    pose_filter = PoseFilter(model or model_of_car())
    anchor_ns, row, result = 0, 0, []
    for begin_ns, begin_row in zip(begins_ns, rows, strict=True):
        if anchored:
            for motion in drive.motion[row:begin_row]:
                anchor_ns = _anchor(pose_filter, drive, motion, anchor_ns, rng)
            row = begin_row
        until_ns = begin_ns + round(lasts_s * 1e9)
        motions = (motion for motion in drive.motion[begin_row:] if motion.time_ns <= until_ns)
        result.append(
            _window(copy.deepcopy(pose_filter), drive, motions, begin_s=(begin_ns - first_ns) * 1e-9)
        )
    return result


def model_of_car(**motion: float) -> PoseModel:
    """The filter's parameters for the recording's car."""
    return PoseModel(motion=MotionModel(wheelbase_m=WHEELBASE_M, **motion))


def _anchor(
    pose_filter: PoseFilter, drive: CommaDrive, motion: Motion, anchor_ns: int, rng: np.random.Generator
) -> int:
    """Take one motion before a window; return when a true position was given last."""
    _predict(pose_filter, motion)
    now = motion.time_ns
    if pose_filter.mode == "none":
        _set_pose(pose_filter, now, drive.truth(now))
    elif now - anchor_ns >= 1_000_000_000:
        east, north = np.array(drive.truth(now)[:2]) + rng.normal(0.0, TRUTH_SIGMA_M, 2)
        pose_filter.anchor(now, float(east), float(north), np.eye(2) * TRUTH_SIGMA_M**2)
        return now
    return anchor_ns


def _predict(pose_filter: PoseFilter, motion: Motion) -> None:
    pose_filter.predict(motion)
    pose_filter.couple_rotation()


def _window(
    pose_filter: PoseFilter, drive: CommaDrive, motions: Iterable[Motion], *, begin_s: float
) -> Window:
    """Dead reckoning from the true pose at the first motion to the last."""
    begun = None
    for motion in motions:
        _predict(pose_filter, motion)
        if begun is None:
            begun = drive.truth(motion.time_ns)
            _set_pose(pose_filter, motion.time_ns, begun)
    assert begun is not None
    e = pose_filter.estimate()
    assert e is not None
    east, north, yaw, driven = drive.truth(e.time_ns)
    off = np.array([e.east_m - east, e.north_m - north])
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    squared = float(off @ np.linalg.solve(e.covariance[:2, :2] + np.eye(2) * RELATIVE_SIGMA_M**2, off))
    across = float(ahead[0] * off[1] - ahead[1] * off[0])
    return Window(begin_s, float(ahead @ off), across, wrap_pi(e.yaw_rad - yaw), driven - begun[3], squared)


def _set_pose(pose_filter: PoseFilter, time_ns: int, pose: tuple[float, float, float, float]) -> None:
    """Set the true pose, with what it may be off by; what the sensors have learnt stays."""
    given = start_pose(time_ns, pose[:3], sigma_m=0.01, yaw_deg=math.degrees(YAW_SIGMA_RAD))
    assert pose_filter.start(given)


def _forward(quaternions: Floats) -> Floats:
    """The camera's forward axis (n, 3) in ECEF, by quaternions (n, 4) w, x, y, z."""
    w, x, y, z = quaternions.T
    return np.column_stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)))


def _ns(seconds: float) -> int:
    return BEGIN_NS + round(seconds * 1e9)


def figures(
    drive: CommaDrive, lasts_s: float, *, anchored: bool = True, model: PoseModel | None = None
) -> str:
    """One line of figures of all windows of a length."""
    each = windows(drive, lasts_s, anchored=anchored, model=model)
    shares, squared = np.array([w.share for w in each]), np.array([w.squared for w in each])
    along, across, yaw = (
        float(np.quantile(np.abs(column), 0.95))
        for column in np.array([(w.along_m, w.across_m, math.degrees(w.yaw_rad)) for w in each]).T
    )
    p50, p95, largest = (100.0 * float(np.quantile(shares, share)) for share in (0.5, 0.95, 1.0))
    return (
        f"{lasts_s:.0f} s, {'anchored' if anchored else 'nothing'} before, {len(each)} windows: error by distance "
        f"p50 {p50:.2f} % p95 {p95:.2f} % max {largest:.2f} %; p95 along {along:.2f} m, across {across:.2f} m, "
        f"yaw {yaw:.2f} deg; in the 99 % ellipse {100.0 * np.mean(squared <= ELLIPSE_99):.1f} %"
    )


def main() -> None:
    path = folder()
    if path is None:
        print(f"CAMBER_DATA names no folder with {FOLDER}: nothing to do")
        return
    drive = read_drive(path)
    for anchored in (True, False):
        for lasts_s in (10.0, 20.0, 30.0):
            print(figures(drive, lasts_s, anchored=anchored))


if __name__ == "__main__":
    main()
