"""Initialization of the pose: at a known position and heading, or at a position whose heading is searched for."""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.consistent_match_sequence import MatchedPose
from camber.localizer.filter.dead_reckoning_time_update import EAST, NORTH
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.heading_search import HeadingSearch, TrackedPosition
from camber.localizer.filter.planar_pose import covariance_at_offset, largest_variance, rotated
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.track import TrackPoint
from camber.localizer.filter.yaw_rate_coupling import YawRateCoupling


class PoseInitialization:
    """Sets the pose; while the heading is unknown, searches for it."""

    def __init__(self, state: FilterState, coupling: YawRateCoupling, model: PoseModel) -> None:
        self._state, self._coupling = state, coupling
        self._antenna_m = (model.antenna_x_m, model.antenna_y_m)
        self._search: HeadingSearch | None = None

    @property
    def heading_known(self) -> bool:
        """Whether no heading is being searched for."""
        return self._search is None

    def at_pose(self, east_m: float, north_m: float, yaw_rad: float, covariance: Floats) -> None:
        """Set the present pose, covariance (3, 3); the sensors' states stay, uncorrelated with it."""
        self._search = None
        self._state.set_pose(east_m, north_m, yaw_rad, covariance)
        self._coupling.forget()

    def at_past_pose(self, pose: MatchedPose, here: TrackPoint) -> None:
        """Set a past pose, carried to the track's point `here`."""
        self.at_pose(*pose.carried(here))

    def at_position(self, position: TrackedPosition, here: TrackPoint | None) -> None:
        """Set a known position with an unknown heading: displacements from there spread over a circle."""
        self._search = HeadingSearch(position, self._antenna_m)
        self.spread(here)

    def add_position(self, position: TrackedPosition, here: TrackPoint) -> None:
        """Add a position of the antenna; with an earlier one it may determine the heading."""
        if self._search is None:
            self.at_position(position, here)
            return
        heading = self._search.add(position)
        if heading is None:
            self.spread(here)
            return
        turned, covariance = heading
        then = position.track
        lever = rotated(then.yaw_rad + turned, *self._antenna_m)
        since = rotated(turned, here.east_m - then.east_m, here.north_m - then.north_m)
        move = (since[0] - lever[0], since[1] - lever[1])
        self.at_pose(
            position.east_m + move[0],
            position.north_m + move[1],
            here.yaw_rad + turned,
            covariance_at_offset(covariance, *move),
        )

    def spread(self, here: TrackPoint | None) -> None:
        """Where the heading is unknown, set position and covariance by the distance driven."""
        search = self._search
        if search is None or here is None:
            return
        east, north, variance = search.spread(here)
        self.at_pose(east, north, here.yaw_rad, np.diag([variance, variance, math.pi**2]))
        self._search = search

    def lose_heading(self, here: TrackPoint | None) -> None:
        """Search for the heading from the present position."""
        if here is not None:
            x, variance = self._state.x, largest_variance(self._state.p)
            self.at_position(TrackedPosition(float(x[EAST]), float(x[NORTH]), variance, here), here)

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        if self._search is not None:
            self._search.shift(east_m, north_m)
