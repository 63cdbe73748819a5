"""The independent position in the world: its plane, its links, and its part of the `Pose` message.

Plane and links are not those of the pose, which lie where fixes have led it. Nothing here depends on a verdict or a
fix, see `IndependentPoseFilter`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.se3 import lever_arm_enu
from camber.localizer.arrays import Floats
from camber.localizer.filter.independent_position import IndependentPoseFilter
from camber.localizer.filter.odometry import InertialReading
from camber.localizer.filter.planar_pose import covariance_at_offset
from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.scan_match_update import MatchUpdate
from camber.localizer.filter.start_from_fixes import StartPose
from camber.localizer.filter.track import OverlayLag
from camber.localizer.inertial.strapdown import ForwardSpeed
from camber.localizer.links.link_cache import LinkCache
from camber.localizer.links.link_matching import LinkMatch
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_queries import MapQueries, MapQueryFailure
from camber.localizer.relief.height_states import HEIGHT_STATES
from camber.schemas import pose as schema
from camber.schemas.motion import Motion
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)

_LEVEL_SIGMA: Final = (
    0.05  # chosen: σ of a road's slope where no match shows roll and pitch; few roads exceed 10 %
)

_SPEED_SIGMA_M_S: Final = 0.1  # chosen: it is a filtered one, and its errors last
_LINKS_EVERY_M: Final = (
    2.5  # chosen: half of `PoseModel.couple_every_m`; matching costs as much as the filter
)


class AntennaPosition(NamedTuple):
    """The antenna in the plane [m], covariance (2, 2), and the pose of the vehicle that it belongs to."""

    east_m: float
    north_m: float
    covariance: Floats
    estimate: PoseEstimate


class IndependentLocalization:
    """Carries the independent position of one vehicle. `lever_m`: the antenna, x forward, y left, z above the road."""

    def __init__(
        self,
        model: PoseModel,
        lever_m: tuple[float, float, float],
        map_queries: MapQueries,
        *,
        links_radius_m: float,
    ) -> None:
        self.position = IndependentPoseFilter(model, extra_states=HEIGHT_STATES)
        self.plane: LocalPlane | None = None
        """The plane of the position; None before the first start."""
        self.active = False
        """Whether motion is followed: nothing is computed before evidence can come."""
        self._lever_m = lever_m
        self._links_at_m = -_LINKS_EVERY_M  # path driven at the last link matching
        self._links = LinkCache(links_radius_m, map_queries, _UnreportedQueries())

    @property
    def knows_motion(self) -> bool:
        """Whether its track may deskew sweeps: it is followed, and its speed is not a vague integral."""
        pose_filter = self.position.filter
        return self.active and (not pose_filter.speed_is_integrated or pose_filter.measures_distance)

    def speed(self) -> ForwardSpeed | None:
        """Return the speed where matches hold it, for levelling an inertial unit."""
        estimate = self.position.estimate() if self.knows_motion else None
        if estimate is None or estimate.speed_m_s is None:
            return None
        return ForwardSpeed(estimate.speed_m_s, max(_SPEED_SIGMA_M_S, self.position.filter.speed_sigma_m_s))

    def predict(self, motion: Motion, inertial: InertialReading | None = None) -> None:
        """Propagate the position."""
        if self.active:
            self.position.predict(motion, inertial)

    def couple_links(self, now_ns: int) -> None:
        """Couple the position with the link that its own history has led to."""
        if not self.active or self.plane is None or self.position.evidence is None:
            return
        pose_filter = self.position.filter
        east_m, north_m = pose_filter.state.x[:2].tolist()
        if self.plane.is_too_far(east_m, north_m):
            self._move_plane(self.plane, east_m, north_m)
            east_m = north_m = 0.0
        matcher = self._links.matcher_at(self.plane, east_m, north_m, now_ns)
        if abs(pose_filter.travelled_m - self._links_at_m) < _LINKS_EVERY_M:
            pose_filter.couple_rotation()
            return
        self._links_at_m = pose_filter.travelled_m
        estimate, match = self.position.estimate(), LinkMatch(status="none")
        if matcher is not None and estimate is not None:
            pose = (estimate.east_m, estimate.north_m, estimate.yaw_rad)
            match = matcher.step(pose, estimate.covariance, travelled_m=pose_filter.travelled_m)
        pose_filter.couple_link(match)

    def start(self, pose: StartPose, plane: LocalPlane, motion: Motion) -> None:
        """Start from a given pose in a plane, at a motion sample."""
        if not self.active:
            self.active = True
            self.position.predict(motion)
        if self.position.start(pose, "given"):
            self.plane = plane
            self._restart()

    def start_by_relief(self, pose: StartPose, plane: LocalPlane) -> bool:
        """Start from a pose by heights in a plane; return whether it was used."""
        if not self.position.start(pose, "relief"):
            return False
        self.plane = plane
        self._restart()
        return True

    def plane_for(self, latitude_rad: float, longitude_rad: float) -> LocalPlane:
        """Return the plane; a new one where there is no position in it and it is far away."""
        plane = self.plane
        if plane is None or (
            self.position.evidence is None and not plane.covers(latitude_rad, longitude_rad)
        ):
            plane = self.plane = LocalPlane(latitude_rad, longitude_rad)
            self._restart()
        return plane

    def match(
        self,
        time_ns: int,
        pose: tuple[float, float, float],
        covariance: Floats,
        *,
        unique: bool,
        overlay_lag: OverlayLag,
        predicted_here: bool,
    ) -> MatchUpdate:
        """Update by a match in the plane, see `IndependentPoseFilter.match`."""
        result = self.position.match(
            time_ns,
            pose,
            covariance,
            unique=unique,
            overlay_lag=overlay_lag,
            predicted_here=predicted_here,
        )
        if result.outcome in ("recovered", "supported"):
            self._restart()
        return result

    def _restart(self) -> None:
        """Fetch and match links anew: plane or position is another one."""
        self._links_at_m = -_LINKS_EVERY_M
        self._links.forget()
        self._links.restart()

    def note_map_version(self, map_version: int | None) -> None:
        """Note the version of the map's other replies."""
        self._links.note_map_version(map_version)

    def antenna(self, attitude_rad: tuple[float, float] | None) -> AntennaPosition | None:
        """Return the antenna's position now; `attitude_rad`: roll and pitch by a match of this position, if any."""
        estimate = self.position.estimate() if self.active else None
        if estimate is None:
            return None
        roll_rad, pitch_rad = attitude_rad or (0.0, 0.0)
        east_m, north_m, _ = lever_arm_enu(roll_rad, pitch_rad, estimate.yaw_rad, self._lever_m)
        covariance = covariance_at_offset(estimate.covariance, east_m, north_m)[:2, :2]
        if attitude_rad is None:
            covariance = covariance + np.eye(2) * (_LEVEL_SIGMA * self._lever_m[2]) ** 2
        return AntennaPosition(estimate.east_m + east_m, estimate.north_m + north_m, covariance, estimate)

    def message(self, attitude_rad: tuple[float, float] | None) -> schema.IndependentPosition | None:
        """Return the position for the pose of the last motion sample."""
        antenna, evidence, plane = self.antenna(attitude_rad), self.position.evidence, self.plane
        if antenna is None or evidence is None or plane is None:
            return None
        latitude_rad, longitude_rad = plane.geodetic(antenna.east_m, antenna.north_m)
        (ee, en), (_, nn) = antenna.covariance.tolist()
        return schema.IndependentPosition(
            basis=evidence.basis,
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            covariance_east_north=(ee, en, nn),
            evidence_time_ns=evidence.time_ns,
            distance_m=max(0.0, self.position.distance_m),
        )

    def _move_plane(self, plane: LocalPlane, east_m: float, north_m: float) -> None:
        """Move the plane's origin to the position."""
        self.plane = LocalPlane(*plane.geodetic(east_m, north_m))
        self.position.filter.shift_origin(east_m, north_m)
        self._links.forget()


class RepeatedLinksQuery:
    """Queries in which a request for links that was just answered is not sent again: pose and independent position are
    the same while no fix is in the pose."""

    def __init__(self, map_queries: MapQueries) -> None:
        self._map_queries = map_queries
        self._last: tuple[LinksRequest, LinksReply | MapQueryFailure] | None = None

    def links(self, request: LinksRequest) -> LinksReply | MapQueryFailure:
        """Return the links around a position."""
        if self._last is None or self._last[0] != request:
            self._last = request, self._map_queries.links(request)
        return self._last[1]

    def elevation(self, request: ElevationRequest) -> ElevationReply | MapQueryFailure:
        """Return the road at a position."""
        return self._map_queries.elevation(request)

    def tile(self, request: TileRequest) -> TileReply | MapQueryFailure:
        """Return a part of a tile."""
        return self._map_queries.tile(request)

    def is_available(self) -> bool:
        """Whether the map can be queried."""
        return self._map_queries.is_available()


class _UnreportedQueries:
    """The pose's cache reports the same queries."""

    def issue(self, code: str, text: str) -> None:
        """Report nothing."""

    def count(self, name: str) -> None:
        """Count nothing."""
