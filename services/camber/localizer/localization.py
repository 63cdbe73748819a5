"""The whole localizer without a bus: what it hears goes in, poses and scan matches come out.

Independence is a law: unconfirmed fixes only help to start, and what they start is provisional until scan matches or a
given pose stand for it. What is asked of the map goes through `MapAnswers`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.se3 import lever_arm_enu
from camber.localizer.filter.dead_reckoning import MotionSample, Outcome
from camber.localizer.filter.pose_filter import PoseEstimate, PoseFilter, PoseModel
from camber.localizer.filter.start import StartFromFixes, StartPose, lever_arm, moved_by_lever
from camber.localizer.links.link_cache import LinkCache
from camber.localizer.links.link_matching import LinkMatch
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_queries import Diagnostics, MapAnswers
from camber.localizer.matching.scan_matcher import ScanMatcher, ScanMatchOptions
from camber.localizer.road.road_below_antenna import RoadBelowAntenna, attitude_on
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose, Road, ScanMatch

Array = NDArray[np.float64]

_CONFIRMED = ("confirmed", "confirmed_after_verification")


@dataclass(frozen=True, slots=True)
class GivenStart:
    """Where the antenna is at the start, known without satellites. Yaw counter-clockwise from east."""

    latitude_rad: float
    longitude_rad: float
    yaw_rad: float
    horizontal_sigma_m: float
    yaw_sigma_rad: float


@dataclass(frozen=True, slots=True)
class LocalizationOptions:
    """Everything the localizer assumes. `antenna_z_m`: above the road at rest. `matching` None: sweeps are not used."""

    model: PoseModel = field(default_factory=PoseModel)
    antenna_z_m: float = 0.0
    links_radius_m: float = 600.0
    road_sigma_limit_m: float = 15.0
    given: GivenStart | None = None
    matching: ScanMatchOptions | None = None


class Step(NamedTuple):
    """What has come out since the last step: at most one pose."""

    pose: Pose | None
    matches: tuple[ScanMatch, ...] = ()


class Localization:
    """One vehicle. Call `advance` after what was heard of one time."""

    def __init__(self, options: LocalizationOptions, answers: MapAnswers, reports: Diagnostics) -> None:
        model = options.model
        self._options, self._reports = options, reports
        self._lever_m = (model.antenna_x_m, model.antenna_y_m, options.antenna_z_m)
        self._filter = PoseFilter(model)
        self._start = StartFromFixes(model.antenna_x_m, model.antenna_y_m)
        self._given = options.given
        self._plane: LocalPlane | None = None
        self._links = LinkCache(options.links_radius_m, answers, reports)
        self._road = RoadBelowAntenna(options.road_sigma_limit_m, answers, reports)
        self._matcher = (
            None
            if options.matching is None
            else ScanMatcher(options.matching, self._filter, answers, reports)
        )
        self._published_ns = 0

    @property
    def matcher(self) -> ScanMatcher | None:
        """The part that matches sweeps, for pictures of what it does; None where sweeps are not used."""
        return self._matcher

    @property
    def has_pose(self) -> bool:
        """Is there a pose?"""
        return self._filter.mode != "none"

    # What is heard

    def on_motion(self, motion: Motion) -> bool:
        """Move on; whether the given pose was used up by this sample."""
        outcome: Outcome = self._filter.predict(
            MotionSample(
                motion.time_ns, motion.wheel_speed_m_s, motion.yaw_rate_rad_s, motion.steering_angle_rad
            )
        )
        if outcome in ("repeated", "backwards"):
            self._reports.issue(f"motion_{outcome}", f"sample at {motion.time_ns} ns")
            return False
        if self._matcher is not None:
            self._matcher.set_attitude(motion.roll_rad, motion.pitch_rad)
        began = self._given is not None
        if self._given is not None:
            self._begin_given(self._given, motion.time_ns)
            self._given = None
        self._follow_links(motion.time_ns)
        return began

    def on_fix(self, fix: Fix) -> None:
        """Unconfirmed: it may only help to start, and only where the filter says that it needs one."""
        if fix.quality != "fixed" or fix.covariance_enu_m2 is None:
            return
        if not self._filter.accepts_fixes:
            self._start.reset()
            return
        covariance = self._horizontal(fix.covariance_enu_m2)
        if covariance is None:
            return
        plane = self._plane_for(fix.latitude_rad, fix.longitude_rad)
        east_m, north_m = plane.east_north(fix.latitude_rad, fix.longitude_rad)
        pose = self._start.add(fix.time_ns, east_m, north_m, covariance, self._filter.track)
        if pose is not None and self._filter.start(pose):
            self._jumped()
            self._reports.count("started_from_fixes")

    def on_verdict(self, verdict: Verdict) -> None:
        """A confirmed position anchors the pose."""
        if verdict.verdict not in _CONFIRMED or verdict.covariance_enu_m2 is None:
            return
        if verdict.latitude_rad is None or verdict.longitude_rad is None:
            return
        covariance = self._horizontal(verdict.covariance_enu_m2)
        if covariance is None:
            return
        plane = self._plane_for(verdict.latitude_rad, verdict.longitude_rad)
        east_m, north_m = plane.east_north(verdict.latitude_rad, verdict.longitude_rad)
        leans_east, leans_north = self._leaning(verdict.time_ns)
        result = self._filter.anchor(verdict.time_ns, east_m - leans_east, north_m - leans_north, covariance)
        if result.outcome == "recovered":
            self._jumped()
        self._reports.count(f"anchor.{result.outcome}")

    def on_sweep(self, sweep: Sweep) -> None:
        """Taken in when the motion up to its end is known."""
        if self._matcher is not None:
            self._matcher.add_sweep(sweep)

    # What comes out

    def advance(self) -> Step:
        """Match what can be matched, and the pose of the newest motion sample, once."""
        matches: tuple[ScanMatch, ...] = ()
        if self._matcher is not None and self._filter.time_ns is not None:
            done = self._matcher.work(self._plane, self._road.last)
            matches = done.matches
            if done.jumped:
                self._jumped()
        time_ns = self._filter.time_ns
        if time_ns is None or time_ns <= self._published_ns:
            return Step(None, matches)
        self._published_ns = time_ns
        return Step(self._pose(time_ns), matches)

    def _pose(self, time_ns: int) -> Pose:
        estimate = self._filter.estimate()
        if estimate is not None and self._plane is not None:
            estimate = self._near_origin(estimate, self._plane)
        if estimate is None or self._plane is None:
            road = Road(status="unknown", reason="no_pose")
            reason = "not started: no given pose, and no fixes in a row that agree with the motion"
            return Pose(time_ns=time_ns, mode="none", provenance="none", reason=reason, road=road)
        plane, yaw_rad = self._plane, estimate.yaw_rad
        roll_rad, pitch_rad = self._attitude(estimate.time_ns, yaw_rad)
        east_m, north_m, _ = lever_arm_enu(roll_rad, pitch_rad, yaw_rad, self._lever_m)
        covariance = moved_by_lever(estimate.covariance, east_m, north_m)
        latitude_rad, longitude_rad = plane.geodetic(estimate.east_m + east_m, estimate.north_m + north_m)
        road = self._road.under(estimate, latitude_rad, longitude_rad)
        self._links.note_map_version(road.map_version)
        if self._matcher is not None:
            self._matcher.note_map_version(road.map_version)
        return Pose(
            time_ns=estimate.time_ns,
            mode=estimate.mode,
            provenance=estimate.provenance,
            reason="; ".join(self._reasons(estimate)),
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            yaw_rad=yaw_rad if estimate.yaw_known else None,
            covariance_east_north_yaw=_upper(covariance),
            roll_rad=roll_rad,
            pitch_rad=pitch_rad,
            speed_m_s=estimate.speed_m_s,
            yaw_rate_rad_s=estimate.yaw_rate_rad_s,
            link_id=estimate.link_id if isinstance(estimate.link_id, int) else None,
            anchor_time_ns=_before(estimate.time_ns, estimate.anchor_age_s),
            motion_time_ns=estimate.time_ns,
            match_time_ns=_before(estimate.time_ns, estimate.match_age_s),
            road=road,
        )

    # Parts

    def _reasons(self, estimate: PoseEstimate) -> Iterator[str]:
        """What an operator would want to know of a pose that is not all it could be."""
        if estimate.mode == "provisional":
            yield "nothing but unconfirmed fixes stands for it"
        if estimate.disputed_by is not None:
            yield f"{estimate.disputed_by} say another place"
        if estimate.wheel_slip_suspected:
            yield "the wheels do not say how fast the vehicle goes"
        if estimate.speed_age_s is None or estimate.speed_age_s > 0.0:
            yield "no speed"
        if estimate.rotation_age_s is None or estimate.rotation_age_s > 0.0:
            yield "no rotation"
        if self._matcher is not None and self._matcher.reason:
            yield self._matcher.reason

    def _attitude(self, time_ns: int, yaw_rad: float) -> tuple[float, float]:
        """Roll and pitch: as matched just now, or else as the road lies."""
        matched = None if self._matcher is None else self._matcher.attitude(time_ns)
        return attitude_on(self._road.last, yaw_rad) if matched is None else matched

    def _leaning(self, time_ns: int) -> tuple[float, float]:
        """How far east and north the antenna is from where it would be on a level road: the filter knows no slope."""
        estimate = self._filter.estimate()
        if estimate is None:
            return 0.0, 0.0
        roll_rad, pitch_rad = self._attitude(time_ns, estimate.yaw_rad)
        east_m, north_m, _ = lever_arm_enu(roll_rad, pitch_rad, estimate.yaw_rad, self._lever_m)
        level = lever_arm(estimate.yaw_rad, self._lever_m[0], self._lever_m[1])
        return east_m - level[0], north_m - level[1]

    def _horizontal(self, covariance_enu_m2: tuple[float, ...]) -> Array | None:
        """The part for east and north, (2, 2); None where it says that there is no error, or is no covariance."""
        ee, en, _, nn, _, _ = covariance_enu_m2
        if not (ee > 0.0 and ee * nn > en * en):
            self._reports.issue(
                "unusable_covariance", f"ee {ee:g}, en {en:g}, nn {nn:g} m²: not positive definite"
            )
            return None
        return np.array([[ee, en], [en, nn]])

    def _follow_links(self, now_ns: int) -> None:
        estimate = self._filter.estimate()
        if estimate is None or self._plane is None:
            return
        matcher = self._links.around(self._plane, estimate.east_m, estimate.north_m, now_ns)
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
        self._reports.count(f"link.{result.outcome}")

    def _jumped(self) -> None:
        self._links.restart()
        self._road.forget()
        if self._matcher is not None:
            self._matcher.reset_road_height()

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

    def _begin_given(self, given: GivenStart, time_ns: int) -> None:
        plane = LocalPlane(given.latitude_rad, given.longitude_rad)  # whatever fixes have said before
        self._lay_plane(plane)
        east_m, north_m = plane.east_north(given.latitude_rad, given.longitude_rad)
        lever = lever_arm(given.yaw_rad, self._lever_m[0], self._lever_m[1])
        position = given.horizontal_sigma_m**2
        covariance = moved_by_lever(
            np.diag([position, position, given.yaw_sigma_rad**2]), -lever[0], -lever[1]
        )
        self._filter.start(
            StartPose(time_ns, east_m - lever[0], north_m - lever[1], given.yaw_rad, covariance, "given")
        )


def _upper(covariance: Array) -> tuple[float, float, float, float, float, float]:
    """(ee, en, eψ, nn, nψ, ψψ)."""
    c = covariance
    return float(c[0, 0]), float(c[0, 1]), float(c[0, 2]), float(c[1, 1]), float(c[1, 2]), float(c[2, 2])


def _before(time_ns: int, age_s: float | None) -> int | None:
    return None if age_s is None else time_ns - round(age_s * 1e9)
