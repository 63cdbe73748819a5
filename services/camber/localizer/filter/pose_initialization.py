"""How a pose begins: at a known place and heading, or at a place whose heading the motion has yet to show."""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.filter.dead_reckoning import EAST, NORTH, RelativeTrack, TrackPoint
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.start import HeadingSearch, Place, largest_variance, lever_arm, moved_by_lever
from camber.localizer.filter.yaw_rate_coupling import RotationCoupling
from camber.localizer.links.link_filter import Array


class PoseInitialization:
    """Places the pose; while the heading is unknown, keeps the search for it."""

    def __init__(
        self, state: FilterState, track: RelativeTrack, rotation: RotationCoupling, model: PoseModel
    ) -> None:
        self._state, self._track, self._rotation, self._model = state, track, rotation, model
        self._search: HeadingSearch | None = None

    @property
    def heading_known(self) -> bool:
        """Whether no heading is being searched for."""
        return self._search is None

    def at_pose(self, east_m: float, north_m: float, yaw_rad: float, covariance: Array) -> None:
        """A pose of now, covariance (3, 3); what is known of the sensors stays, uncorrelated with it."""
        self._search = None
        self._state.place(east_m, north_m, yaw_rad, covariance)
        self._rotation.forget()

    def at_past_pose(
        self,
        east_m: float,
        north_m: float,
        yaw_rad: float,
        covariance: Array,
        then: TrackPoint,
        here: TrackPoint,
    ) -> None:
        """A pose, covariance (3, 3), where the track was `then`, brought to `here`."""
        turned = yaw_rad - then.yaw_rad
        since = lever_arm(turned, here.east_m - then.east_m, here.north_m - then.north_m)
        covariance = moved_by_lever(covariance, *since)
        self.at_pose(east_m + since[0], north_m + since[1], here.yaw_rad + turned, covariance)

    def at_place(self, place: Place, here: TrackPoint | None) -> None:
        """Known place, unknown heading: what is driven from there spreads over a circle."""
        model = self._model
        self._search = HeadingSearch(place, model.antenna_x_m, model.antenna_y_m, model.heading)
        self.spread(here)

    def add_place(
        self, east_m: float, north_m: float, variance_m2: float, then: TrackPoint, here: TrackPoint
    ) -> None:
        """The antenna's place where the track was `then`; with an earlier one it may show the heading."""
        place = Place(east_m, north_m, variance_m2, then)
        if self._search is None:
            self.at_place(place, here)
            return
        found = self._search.add(place)
        if found is None:
            self.spread(here)
            return
        turned, covariance = found
        model = self._model
        lever = lever_arm(then.yaw_rad + turned, model.antenna_x_m, model.antenna_y_m)
        since = lever_arm(turned, here.east_m - then.east_m, here.north_m - then.north_m)
        move = (since[0] - lever[0], since[1] - lever[1])
        covariance = moved_by_lever(covariance, *move)
        self.at_pose(east_m + move[0], north_m + move[1], here.yaw_rad + turned, covariance)

    def spread(self, here: TrackPoint | None) -> None:
        """Where the heading is unknown: the place and its covariance after what was driven."""
        search = self._search
        if search is None or here is None:
            return
        east, north, variance = search.spread(here)
        self.at_pose(east, north, here.yaw_rad, np.diag([variance, variance, math.pi**2]))
        self._search = search

    def lose_heading(self, here: TrackPoint | None) -> None:
        """The heading has become worthless: search for it from the place of now."""
        if here is not None:
            x = self._state.x
            variance = largest_variance(self._state.p)
            self.at_place(Place(float(x[EAST]), float(x[NORTH]), variance, here), here)

    def shift(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north)."""
        if self._search is not None:
            self._search.shift(east_m, north_m)
