"""The localizer's process: motion, links and confirmed positions become a pose with the road under its antenna."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from camber.localizer.dead_reckoning import MotionSample
from camber.localizer.link_matching import LinkMatch, LinkMatcher, LinkNetwork
from camber.localizer.local_plane import LocalPlane
from camber.localizer.pose_filter import PoseEstimate, PoseFilter
from camber.localizer.road_ahead import RoadAhead, places_ahead
from camber.localizer.settings import GivenPose, LocalizerSettings
from camber.localizer.start import FixTrackStart, StartPose, lever_arm, moved_by_lever
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.service import Service
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose, Road
from camber.schemas.road import ElevationReply, ElevationRequest, LinksRequest

_CONFIRMED = ("confirmed", "confirmed_after_verification")
_REFETCH_SHARE = 0.4  # of the radius: so far may the vehicle go before links are fetched anew
_PATCH_ABOVE_M = 0.3  # a pose of larger σ gets the road around it too
_PATCH_SIGMAS = 3.7  # 99.9 % of the places where it can be
_FETCH_PAUSE_NS = 1_000_000_000  # between two attempts to fetch links


class LocalizerService(Service[LocalizerSettings]):
    """One pose per motion sample; unconfirmed fixes only start a pose, confirmed ones anchor it."""

    NAME = "localizer"
    SETTINGS = LocalizerSettings

    def __init__(self, settings: LocalizerSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._filter = PoseFilter(settings.model())
        self._start = FixTrackStart(settings.antenna_x_m, settings.antenna_y_m)
        self._given = _not_used_before(settings)
        self._plane: LocalPlane | None = None
        self._links = _Links(settings, bus)
        self._road = Road(status="unknown", reason="no_pose")
        self._ahead: RoadAhead | None = None
        self._published_ns = 0

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return {"motion": self._hear_motion, "fix": self._hear_fix, "verdict": self._hear_verdict}

    def _hear_motion(self, motion: Motion) -> None:
        outcome = self._filter.predict(
            MotionSample(
                motion.time_ns, motion.wheel_speed_m_s, motion.yaw_rate_rad_s, motion.steering_angle_rad
            )
        )
        if outcome in ("repeated", "backwards"):
            self.bus.issue(f"motion_{outcome}", f"sample at {motion.time_ns} ns")
            return
        if self._given is not None:
            self._begin_given(self._given, motion.time_ns)
            self._given = None
            self._remember_given()
        self._follow_links(motion.time_ns)

    def _hear_fix(self, fix: Fix) -> None:
        """Unconfirmed: it may only help to start, and only where the filter says that it needs one."""
        if fix.quality != "fixed" or fix.covariance_enu_m2 is None:
            return
        if not self._filter.accepts_fixes:
            self._start.reset()
            return
        covariance = self._horizontal(fix.covariance_enu_m2)
        if covariance is None:
            return
        east_m, north_m = self._plane_for(fix.latitude_rad, fix.longitude_rad).east_north(
            fix.latitude_rad, fix.longitude_rad
        )
        pose = self._start.add(fix.time_ns, east_m, north_m, covariance, self._filter.track)
        if pose is not None and self._filter.start(pose):
            self._links.restart()
            self.bus.count("started_from_fixes")

    def _hear_verdict(self, verdict: Verdict) -> None:
        if verdict.verdict not in _CONFIRMED or verdict.covariance_enu_m2 is None:
            return
        if verdict.latitude_rad is None or verdict.longitude_rad is None:
            return
        covariance = self._horizontal(verdict.covariance_enu_m2)
        if covariance is None:
            return
        plane = self._plane_for(verdict.latitude_rad, verdict.longitude_rad)
        east_m, north_m = plane.east_north(verdict.latitude_rad, verdict.longitude_rad)
        result = self._filter.anchor(verdict.time_ns, east_m, north_m, covariance)
        if result.outcome == "recovered":
            self._links.restart()
        self.bus.count(f"anchor.{result.outcome}")

    def _horizontal(self, covariance_enu_m2: tuple[float, ...]) -> Any:
        """The part for east and north, (2, 2); None where it says that there is no error, or is no covariance."""
        ee, en, _, nn, _, _ = covariance_enu_m2
        if not (ee > 0.0 and ee * nn > en * en):
            self.bus.issue(
                "unusable_covariance", f"ee {ee:g}, en {en:g}, nn {nn:g} m²: not positive definite"
            )
            return None
        return np.array([[ee, en], [en, nn]])

    def advance(self, now_ns: int) -> None:
        """Publish the pose of the newest motion sample, once."""
        time_ns = self._filter.time_ns
        if time_ns is None or time_ns <= self._published_ns:
            return
        self._published_ns = time_ns
        estimate = self._filter.estimate()
        if estimate is not None and self._plane is not None:
            estimate = self._near_origin(estimate, self._plane)
        if estimate is None or self._plane is None:
            road = Road(status="unknown", reason="no_pose")
            reason = "not started: no given pose, and no fixes in a row that agree with the motion"
            self.bus.publish(
                "pose", Pose(time_ns=time_ns, mode="none", provenance="none", reason=reason, road=road)
            )
            return
        self.bus.publish("pose", self._pose(estimate, self._plane))

    def healthy(self) -> bool:
        """Is there a pose?"""
        return self._filter.mode != "none"

    def _pose(self, estimate: PoseEstimate, plane: LocalPlane) -> Pose:
        settings = self.settings
        yaw_rad = estimate.yaw_rad
        east_m, north_m = lever_arm(yaw_rad, settings.antenna_x_m, settings.antenna_y_m)
        covariance = moved_by_lever(estimate.covariance, east_m, north_m)
        latitude_rad, longitude_rad = plane.geodetic(estimate.east_m + east_m, estimate.north_m + north_m)
        self._road = self._road_under(estimate, latitude_rad, longitude_rad, covariance)
        return Pose(
            time_ns=estimate.time_ns,
            mode=estimate.mode,
            provenance=estimate.provenance,
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            yaw_rad=yaw_rad if estimate.yaw_known else None,
            covariance_east_north_yaw=_upper(covariance),
            speed_m_s=estimate.speed_m_s,
            yaw_rate_rad_s=estimate.yaw_rate_rad_s,
            link_id=estimate.link_id if isinstance(estimate.link_id, int) else None,
            anchor_time_ns=_before(estimate.time_ns, estimate.anchor_age_s),
            motion_time_ns=estimate.time_ns,
            road=self._road,
        )

    def _road_under(
        self, estimate: PoseEstimate, latitude_rad: float, longitude_rad: float, covariance: Any
    ) -> Road:
        sigma_m = estimate.horizontal_sigma_m
        if sigma_m > self.settings.road_sigma_limit_m:
            return Road(status="unknown", reason="pose_too_uncertain")
        candidates = estimate.link_candidates or (() if estimate.link_id is None else (estimate.link_id,))
        link_ids = tuple(int(link) for link in candidates)[:16]
        certain = sigma_m <= _PATCH_ABOVE_M
        if certain and self._ahead is not None and self.bus.is_alive("map_server"):
            place = latitude_rad, longitude_rad
            known = self._ahead.under(estimate.time_ns, *place, link_ids, _PATCH_SIGMAS * sigma_m)
            if known is not None:
                return known
        self._ahead = None
        ahead = places_ahead(estimate.yaw_rad, estimate.speed_m_s or 0.0, estimate.yaw_rate_rad_s or 0.0)
        request = ElevationRequest(
            time_ns=estimate.time_ns,
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            link_ids=link_ids,
            last_surface_id=self._road.surface_id,
            radius_m=0.0 if certain else _PATCH_SIGMAS * sigma_m,
            ahead=ahead if certain else None,
        )
        try:
            reply: ElevationReply = self.bus.ask("elevation", request)
        except QueryFailed as error:
            self.bus.issue("no_elevation", str(error))
            absent = error.reason in ("absent", "timeout")
            return Road(status="unknown", reason="map_server_absent" if absent else "map_missing")
        self._links.seen_version(reply.road.map_version)
        self._ahead = RoadAhead.of(request, reply)
        return reply.road

    def _follow_links(self, now_ns: int) -> None:
        estimate = self._filter.estimate()
        if estimate is None or self._plane is None:
            return
        matcher = self._links.around(self._plane, estimate, now_ns)
        match = LinkMatch("none")
        if matcher is not None:
            match = matcher.step(
                estimate.east_m,
                estimate.north_m,
                estimate.yaw_rad,
                estimate.covariance,
                self._filter.travelled_m,
            )
        result = self._filter.couple_link(match)
        self.bus.count(f"link.{result.outcome}")

    def _plane_for(self, latitude_rad: float, longitude_rad: float) -> LocalPlane:
        """The plane; laid anew where there is no pose in it yet: a first fix may have been anywhere."""
        if self._plane is None or (
            self._filter.mode == "none" and not self._plane.reaches(latitude_rad, longitude_rad)
        ):
            self._lay_plane(LocalPlane(latitude_rad, longitude_rad))
        assert self._plane is not None
        return self._plane

    def _lay_plane(self, plane: LocalPlane) -> None:
        self._plane = plane
        self._start.reset()
        self._links.forget()

    def _near_origin(self, estimate: PoseEstimate, plane: LocalPlane) -> PoseEstimate | None:
        """The estimate; in another plane, laid about it, where it is too far from the origin of this one."""
        if not plane.too_far(estimate.east_m, estimate.north_m):
            return estimate
        self._plane = LocalPlane(*plane.geodetic(estimate.east_m, estimate.north_m))
        self._filter.shifted(estimate.east_m, estimate.north_m)
        self._start.shift(estimate.east_m, estimate.north_m)
        self._links.forget()
        return self._filter.estimate()

    def _remember_given(self) -> None:
        """A given pose is believed once: the vehicle has moved since when this service is started again."""
        path = _given_path(self.settings)
        if path is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(_text_of(self.settings.initial_pose), "utf-8")
        except OSError as error:
            self.bus.issue("given_pose_not_kept", f"{path}: {error.strerror}")

    def _begin_given(self, given: GivenPose, time_ns: int) -> None:
        latitude_rad, longitude_rad = math.radians(given.latitude_deg), math.radians(given.longitude_deg)
        plane = LocalPlane(
            latitude_rad, longitude_rad
        )  # about the given place, whatever fixes have said before
        self._lay_plane(plane)
        east_m, north_m = plane.east_north(latitude_rad, longitude_rad)
        yaw_rad = math.radians(given.yaw_deg)
        lever = lever_arm(yaw_rad, self.settings.antenna_x_m, self.settings.antenna_y_m)
        position, yaw = given.horizontal_sigma_m**2, math.radians(given.yaw_sigma_deg) ** 2
        covariance = moved_by_lever(np.diag([position, position, yaw]), -lever[0], -lever[1])
        self._filter.start(
            StartPose(time_ns, east_m - lever[0], north_m - lever[1], yaw_rad, covariance, "given")
        )


def _given_path(settings: LocalizerSettings) -> Path | None:
    return settings.state_dir / "given_pose.json" if settings.state_dir else None


def _text_of(given: GivenPose | None) -> str:
    return "" if given is None else given.model_dump_json()


def _not_used_before(settings: LocalizerSettings) -> GivenPose | None:
    """The given pose, unless an earlier run of this service has started from the same one."""
    path = _given_path(settings)
    try:
        used = path.read_text("utf-8") if path is not None else ""
    except (OSError, UnicodeDecodeError):
        used = ""
    return None if used and used == _text_of(settings.initial_pose) else settings.initial_pose


class _Links:
    """The links around the vehicle: fetched when it has moved, when the map has changed, when there are none."""

    def __init__(self, settings: LocalizerSettings, bus: Bus) -> None:
        self._radius_m = settings.links_radius_m
        self._bus = bus
        self._matcher: LinkMatcher | None = None
        self._centre: tuple[float, float] | None = None
        self._version: int | None = None
        self._tried_ns = 0

    def forget(self) -> None:
        """The plane has changed: fetch anew."""
        self._centre, self._tried_ns = None, 0

    def restart(self) -> None:
        """The pose has jumped: what was known of the links driven says nothing any more."""
        if self._matcher is not None:
            self._matcher.reset()

    def seen_version(self, map_version: int | None) -> None:
        """The elevations come from this version; links of another one are fetched anew."""
        if map_version is not None and self._version is not None and map_version != self._version:
            self._centre = None

    def around(self, plane: LocalPlane, estimate: PoseEstimate, now_ns: int) -> LinkMatcher | None:
        """The matcher over the links around the estimate; None where none could be had."""
        here = (estimate.east_m, estimate.north_m)
        if self._centre is None or math.dist(self._centre, here) > _REFETCH_SHARE * self._radius_m:
            self._fetch(plane, here, now_ns)
        return self._matcher if self._centre is not None else None

    def _fetch(self, plane: LocalPlane, here: tuple[float, float], now_ns: int) -> None:
        if 0 <= now_ns - self._tried_ns < _FETCH_PAUSE_NS:
            return
        self._tried_ns = now_ns
        latitude_rad, longitude_rad = plane.geodetic(*here)
        request = LinksRequest(
            time_ns=now_ns, latitude_rad=latitude_rad, longitude_rad=longitude_rad, radius_m=self._radius_m
        )
        try:
            reply = self._bus.ask("links", request)
        except QueryFailed as error:
            self._bus.issue("no_links", str(error))
            return
        if reply.status != "known":
            self._bus.issue("no_links", reply.reason or "unknown")
            return
        try:
            network = LinkNetwork(plane.links(reply))
        except ValueError as error:
            self._bus.issue("unusable_links", str(error))
            return
        if self._matcher is None:
            self._matcher = LinkMatcher(network)
        else:
            self._matcher.replace_network(network)
        self._centre, self._version = here, reply.map_version


def _upper(covariance: Any) -> tuple[float, float, float, float, float, float]:
    """(ee, en, eψ, nn, nψ, ψψ)."""
    c = covariance
    return float(c[0, 0]), float(c[0, 1]), float(c[0, 2]), float(c[1, 1]), float(c[1, 2]), float(c[2, 2])


def _before(time_ns: int, age_s: float | None) -> int | None:
    return None if age_s is None else time_ns - round(age_s * 1e9)


SERVICE = LocalizerService
