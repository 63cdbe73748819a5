"""Errors of dead reckoning over windows of a drive whose truth is known.

Before a window the pose is anchored by true positions once a second, in it nothing but motion is used: wheels, yaw rate
and steering, or an inertial unit with or without them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.inertial.imu_motion import ImuMotion, ImuOptions, InertialSample
from camber.schemas.motion import Imu, Motion
from support.pose_inputs import start_pose

ELLIPSE_99: Final = 9.2103  # χ² with two degrees of freedom


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DriveTruth:
    """Truth at times (n,): east, north (n, 2) [m], yaw (n,) [rad], distance driven (n,) [m].

    σ of a position, of a displacement in a window [m] and of the yaw [rad].
    """

    time_ns: Floats
    position_m: Floats
    yaw_rad: Floats
    driven_m: Floats
    sigma_m: float = 0.05
    relative_sigma_m: float = 0.01
    yaw_sigma_rad: float = math.radians(0.05)

    def at(self, time_ns: int) -> tuple[float, float, float, float]:
        """East, north, yaw, distance at a time."""
        east, north = (float(np.interp(time_ns, self.time_ns, c)) for c in self.position_m.T)
        yaw, driven = (float(np.interp(time_ns, self.time_ns, c)) for c in (self.yaw_rad, self.driven_m))
        return east, north, yaw, driven


def by_imu(motion: Sequence[Motion], imu: Sequence[Imu], options: ImuOptions) -> list[InertialSample]:
    """Samples of an inertial unit with the vehicle's wheels, as the localizer makes them."""
    inertial, samples = ImuMotion(options), []
    for one in sorted([*motion, *imu], key=lambda sample: sample.time_ns):
        if isinstance(one, Motion):
            inertial.on_vehicle(one)
        elif (sample := inertial.on_imu(one, lambda: None)) is not None:
            samples.append(sample)
    return samples


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
    samples: Sequence[InertialSample],
    truth: DriveTruth,
    lasts_s: float,
    *,
    model: PoseModel,
    anchored: bool = True,
    every_s: float = 1.0,
    begins_after_s: float = 0.0,
    seed: int = 1,
) -> list[Window]:
    """Dead reckoning over all windows of a length that begin every so often; the pose at their begin is the truth.

    `anchored`: before the window, true positions once a second, with an error of the truth's σ, have been confirmed
    since the drive's begin. Otherwise the window is all that the filter knows.
    """
    times_ns = [sample.motion.time_ns for sample in samples]
    first_ns = times_ns[0]
    begins_s = np.arange(begins_after_s, (times_ns[-1] - first_ns) * 1e-9 - lasts_s, every_s)
    begins_ns = [first_ns + round(begin_s * 1e9) for begin_s in begins_s.tolist()]
    rng = np.random.default_rng(seed)
    pose_filter = PoseFilter(model)
    anchor_ns, row, result = 0, 0, []
    for begin_ns, begin_row in zip(begins_ns, np.searchsorted(times_ns, begins_ns).tolist(), strict=True):
        if anchored:
            for sample in samples[row:begin_row]:
                anchor_ns = _anchor(pose_filter, truth, sample, anchor_ns, rng)
            row = begin_row
        end_row = int(np.searchsorted(times_ns, begin_ns + round(lasts_s * 1e9), side="right"))
        begin_s = (begin_ns - first_ns) * 1e-9
        result.append(_window(copy.deepcopy(pose_filter), truth, samples[begin_row:end_row], begin_s=begin_s))
    return result


def _anchor(
    pose_filter: PoseFilter,
    truth: DriveTruth,
    sample: InertialSample,
    anchor_ns: int,
    rng: np.random.Generator,
) -> int:
    """Take one sample before a window; return when a true position was given last."""
    _predict(pose_filter, sample)
    now = sample.motion.time_ns
    if pose_filter.mode == "none":
        _set_pose(pose_filter, now, truth)
    elif now - anchor_ns >= 1_000_000_000:
        east, north = np.array(truth.at(now)[:2]) + rng.normal(0.0, truth.sigma_m, 2)
        pose_filter.anchor(now, float(east), float(north), np.eye(2) * truth.sigma_m**2)
        return now
    return anchor_ns


def _predict(pose_filter: PoseFilter, sample: InertialSample) -> None:
    pose_filter.predict(sample.motion, sample.reading)
    pose_filter.couple_rotation()


def _window(
    pose_filter: PoseFilter, truth: DriveTruth, samples: Iterable[InertialSample], *, begin_s: float
) -> Window:
    """Dead reckoning from the true pose at the first sample to the last."""
    begun = None
    for sample in samples:
        _predict(pose_filter, sample)
        if begun is None:
            begun = truth.at(sample.motion.time_ns)
            _set_pose(pose_filter, sample.motion.time_ns, truth)
    assert begun is not None
    e = pose_filter.estimate()
    assert e is not None
    east, north, yaw, driven = truth.at(e.time_ns)
    off = np.array([e.east_m - east, e.north_m - north])
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    squared = float(off @ np.linalg.solve(e.covariance[:2, :2] + np.eye(2) * truth.relative_sigma_m**2, off))
    across = float(ahead[0] * off[1] - ahead[1] * off[0])
    return Window(begin_s, float(ahead @ off), across, wrap_pi(e.yaw_rad - yaw), driven - begun[3], squared)


def _set_pose(pose_filter: PoseFilter, time_ns: int, truth: DriveTruth) -> None:
    """Set the true pose, with what it may be off by; what the sensors have learnt stays."""
    sigma_deg = math.degrees(truth.yaw_sigma_rad)
    given = start_pose(time_ns, truth.at(time_ns)[:3], sigma_m=0.01, yaw_deg=sigma_deg)
    assert pose_filter.start(given)


def figures(each: Sequence[Window], lasts_s: float) -> str:
    """One line of figures of windows of a length."""
    shares, squared = np.array([w.share for w in each]), np.array([w.squared for w in each])
    along, across, yaw = (
        float(np.quantile(np.abs(column), 0.95))
        for column in np.array([(w.along_m, w.across_m, math.degrees(w.yaw_rad)) for w in each]).T
    )
    p50, p95, largest = (100.0 * float(np.quantile(shares, share)) for share in (0.5, 0.95, 1.0))
    return (
        f"{lasts_s:.0f} s, {len(each)} windows: error by distance p50 {p50:.2f} % p95 {p95:.2f} % "
        f"max {largest:.2f} %; p95 along {along:.2f} m, across {across:.2f} m, yaw {yaw:.2f} deg; "
        f"in the 99 % ellipse {100.0 * np.mean(squared <= ELLIPSE_99):.1f} %"
    )
