"""Start of the independent position from heights: the dead-reckoned track of the last kilometre is shifted until the
heights along it fit the road.

The search begins at the pose, which may rest on fixes that are off, so its prior admits what fixes can be off by, and
the result counts only once the heights outweigh it: the prior's share in the position is at most
`MAX_PRIOR_SHARE` in every direction. A pose off by d then moves the result by at most that share of d: 4 % is 40 cm of
10 m, a tenth of the σ of 4 m that the share leaves. A road without relief, or a straight one, starts nothing.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.start_from_fixes import StartPose
from camber.localizer.filter.track import TrackPoint
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.road_ribbon import RibbonPlane, RoadRibbon
from camber.localizer.relief.terrain_contour_matching import HeightWindow, estimate_shift
from camber.localizer.relief.track_errors import track_error_modes
from camber.localizer.relief.white_noise import white_sigma_m

MAX_PRIOR_SHARE: Final = 0.04  # derived: a pose off by 10 m moves the result by a tenth of its σ
PRIOR_SIGMA_M: Final = 20.0  # chosen: a base coordinate, or positions led away, before the heights show it
_PRIOR_YAW_RAD: Final = math.radians(2.0)  # chosen: fixes led away across by 0.3 m/s at 10 m/s
_SPACING_M: Final = 10.0  # chosen: shorter than the road's waves, longer than what a map's error needs
_WINDOW_M: Final = 1000.0  # chosen: dead reckoning errs by 0.5 % of it
_LEAST_M: Final = 200.0  # chosen: on fewer heights the model of errors is not tested
_LEAST_COUNT: Final = 15  # chosen: most of the places of that distance
_EVERY_M: Final = 100.0  # chosen: a tenth of the window is new


class _Height(NamedTuple):
    time_ns: int
    track: TrackPoint
    height_m: float
    sigma_m: float
    map_sigma_m: float


class PlacedPose(NamedTuple):
    """The pose at the time of the last height: its place (m), yaw (rad), and the antenna in its axes (m)."""

    east_m: float
    north_m: float
    yaw_rad: float
    lever_m: tuple[float, float]


class ReliefStart:
    """Collects heights and roads along the way."""

    def __init__(self, model: HeightErrorModel, motion: MotionModel) -> None:
        self._model = model
        scale, bias = motion.speed_scale_sigma, motion.bias_sigma(motion.a_rate_sensor)
        sigmas = (PRIOR_SIGMA_M, PRIOR_SIGMA_M, _PRIOR_YAW_RAD, scale, bias)
        self._prior: Floats = np.diag(np.square(sigmas))
        self._heights: deque[_Height] = deque()
        self._planes: deque[RibbonPlane] = deque()
        self._tried_at_m = -math.inf
        self._stepped = False

    def forget(self) -> None:
        """Forget what was collected: the plane is another one, or a position has started."""
        self.forget_heights()
        self._planes.clear()

    def forget_heights(self, *, stepped: bool = False) -> None:
        """Forget the heights: the next ones have another offset, by a step of the fixes or by a gap."""
        self._stepped |= stepped
        self._heights.clear()
        self._tried_at_m = -math.inf

    def forget_before(self, begin_ns: int | None) -> None:
        """Forget all where the track begins later than the heights: after a gap it is another one."""
        if self._heights and (begin_ns is None or self._heights[-1].time_ns < begin_ns):
            self.forget()

    def add_road(self, plane: RibbonPlane) -> None:
        """Add the road below the pose's antenna, each few metres."""
        last = self._planes[-1] if self._planes else None
        apart_m = math.inf if last is None else math.dist(last[:2], plane[:2])
        if apart_m >= 0.5 * _SPACING_M:
            self._planes.append(plane)
            if len(self._planes) > 3 * _WINDOW_M / _SPACING_M:
                self._planes.popleft()

    def add_height(
        self, time_ns: int, track: TrackPoint, *, height_m: float, sigma_m: float, map_sigma_m: float
    ) -> bool:
        """Add the road's height by a fix at a point of the track; return whether it is time for `solve`."""
        heights = self._heights
        if heights and track.path_m - heights[-1].track.path_m < _SPACING_M:
            return False
        heights.append(
            _Height(time_ns=time_ns, track=track, height_m=height_m, sigma_m=sigma_m, map_sigma_m=map_sigma_m)
        )
        while track.path_m - heights[0].track.path_m > _WINDOW_M:
            heights.popleft()
        long_enough = track.path_m - heights[0].track.path_m >= _LEAST_M and len(heights) >= _LEAST_COUNT
        return long_enough and track.path_m - self._tried_at_m >= _EVERY_M

    def solve(self, pose: PlacedPose) -> StartPose | None:
        """Return the pose of the vehicle at the time of the last height, where the heights determine it."""
        last = self._heights[-1]
        self._tried_at_m = last.track.path_m
        lever = rotated(pose.yaw_rad, *pose.lever_m)
        frame_rad = pose.yaw_rad - last.track.yaw_rad
        places = np.array(
            [self._place(height.track, last.track, frame_rad, pose) for height in self._heights]
        )
        ribbon = RoadRibbon(list(self._planes))
        window = HeightWindow(
            time_s=np.array([(height.time_ns - last.time_ns) * 1e-9 for height in self._heights]),
            east_m=places[:, 0],
            north_m=places[:, 1],
            height_m=np.array([height.height_m for height in self._heights]),
            sigma_m=np.array([height.sigma_m for height in self._heights]),
            map_sigma_m=np.array([height.map_sigma_m for height in self._heights]),
        )
        estimate = estimate_shift(
            window._replace(white_sigma_m=self._white_sigma_m(window, ribbon)),
            ribbon.at,
            self._model,
            prior=self._prior,
            modes=track_error_modes(window.east_m, window.north_m, window.time_s),
            stepped=self._stepped,
            max_prior_share=MAX_PRIOR_SHARE,
        )
        if estimate is None or not estimate.unique or estimate.prior_share > MAX_PRIOR_SHARE:
            return None
        turn_rad = float(estimate.shift[2])
        turned = rotated(turn_rad, *lever)
        to_vehicle = np.eye(3)
        to_vehicle[:2, 2] = turned[1], -turned[0]
        return StartPose(
            time_ns=last.time_ns,
            east_m=float(window.east_m[-1] + estimate.shift[0]) - turned[0],
            north_m=float(window.north_m[-1] + estimate.shift[1]) - turned[1],
            yaw_rad=pose.yaw_rad + turn_rad,
            covariance=to_vehicle @ estimate.covariance[:3, :3] @ to_vehicle.T,
            provenance="given",
        )

    def _white_sigma_m(self, window: HeightWindow, ribbon: RoadRibbon) -> float | None:
        """Return what is measured at the places of the pose, at most what is claimed."""
        residual_m = window.height_m - ribbon.at(window.east_m, window.north_m).elevation_m
        places = np.column_stack((window.east_m, window.north_m))
        measured_m = white_sigma_m(residual_m, places, window.map_sigma_m, self._model)
        return None if measured_m is None else min(measured_m, float(np.median(window.sigma_m)))

    @staticmethod
    def _place(
        track: TrackPoint, last: TrackPoint, frame_rad: float, pose: PlacedPose
    ) -> tuple[float, float]:
        """Return the antenna's place at a point of the track, laid through the pose at the last one."""
        since = rotated(frame_rad, track.east_m - last.east_m, track.north_m - last.north_m)
        lever = rotated(frame_rad + track.yaw_rad, *pose.lever_m)
        return pose.east_m + since[0] + lever[0], pose.north_m + since[1] + lever[1]
