"""The localizer without a bus: motion, sweeps, fixes and verdicts in, poses and scan matches out.

Independence: unconfirmed fixes are used to start only, and the pose that they start is provisional until scan matches
support it. The map is queried through `MapQueries`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from camber.geodesy.se3 import lever_arm_enu
from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import covariance_at_offset, rotated
from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.start_from_fixes import StartFromFixes
from camber.localizer.fix_track import FixTrack
from camber.localizer.given_pose import GivenPose
from camber.localizer.horizontal_basis import horizontal_basis
from camber.localizer.independent_localization import IndependentLocalization, RepeatedLinksQuery
from camber.localizer.inertial.imu_motion import ImuMotion, ImuOptions, InertialSample, with_imu
from camber.localizer.links.link_cache import LinkCache
from camber.localizer.links.link_matching import LinkMatch
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_queries import Diagnostics, MapQueries
from camber.localizer.matching.scan_matcher import ScanMatcher, ScanMatchOptions
from camber.localizer.relief.fix_step_detection import FixStepDetection
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief_localization import ReliefLocalization
from camber.localizer.road.road_below_antenna import RoadBelowAntenna, attitude_on_road
from camber.schemas.gnss import Fix
from camber.schemas.integrity import CONFIRMED_VERDICTS, Verdict
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion
from camber.schemas.pose import IndependentPosition, Pose, Road, ScanMatch

_UPPER = np.triu_indices(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationOptions:
    """Parameters of the localizer. `antenna_z_m`: above the road at rest.

    `imu` None: there is no inertial unit; `matching` None: sweeps are not used; `relief` None: neither are heights of
    fixes.
    """

    model: PoseModel = field(default_factory=PoseModel)
    antenna_z_m: float = 0.0
    links_radius_m: float = 600.0
    road_sigma_limit_m: float = 15.0
    given: GivenPose | None = None
    imu: ImuOptions | None = None
    matching: ScanMatchOptions | None = None
    relief: HeightErrorModel | None = field(default_factory=HeightErrorModel)


class LocalizationOutput(NamedTuple):
    """The output since the last step: at most one pose."""

    pose: Pose | None
    matches: tuple[ScanMatch, ...] = ()


class Localization:
    """Localizes one vehicle. Call `advance` after all inputs of one time."""

    def __init__(
        self, options: LocalizationOptions, map_queries: MapQueries, diagnostics: Diagnostics
    ) -> None:
        model, map_queries = options.model, RepeatedLinksQuery(map_queries)
        self._inertial = None if options.imu is None else ImuMotion(options.imu)
        if options.imu is not None:
            model = with_imu(model, options.imu)
        self._diagnostics = diagnostics
        self._lever_m = (model.antenna_x_m, model.antenna_y_m, options.antenna_z_m)
        self._filter = PoseFilter(model)
        self._start = StartFromFixes(model.antenna_x_m, model.antenna_y_m)
        self._given = options.given
        self._plane: LocalPlane | None = None
        self._links = LinkCache(options.links_radius_m, map_queries, diagnostics)
        self.independent = IndependentLocalization(
            model, self._lever_m, map_queries, links_radius_m=options.links_radius_m
        )
        """The position in which no fix's east and north has a part."""
        self._filter.use_sensors_of(self.independent.position.filter)
        self._relief: ReliefLocalization | None = None
        self._fix_track: FixTrack | None = None
        self._fix_steps = FixStepDetection(self._lever_m[:2])
        if options.relief is not None:
            self._relief = ReliefLocalization(
                options.relief,
                self._lever_m,
                self.independent,
                map_queries=map_queries,
                diagnostics=diagnostics,
            )
            self._fix_track = FixTrack(options.relief, antenna_z_m=options.antenna_z_m)
        self._road = RoadBelowAntenna(options.road_sigma_limit_m, map_queries, diagnostics)
        self.matcher: ScanMatcher | None = None
        """The scan matcher, for pictures of its matches; None where sweeps are not used."""
        if options.matching is not None:
            self.matcher = ScanMatcher(
                options.matching, self._filter, map_queries, diagnostics, independent=self.independent
            )
        self._given_at_m = 0.0  # path driven when the given pose was used
        self._published_ns = 0
        self._odometry_faults: set[str] = set()

    @property
    def has_pose(self) -> bool:
        """Whether there is a pose."""
        return self._filter.mode != "none"

    def on_motion(self, motion: Motion) -> bool:
        """Propagate the pose; return whether this sample started the given pose.

        With an inertial unit the pose follows the unit's samples, and this is what its wheels add to them.
        """
        if self._inertial is None:
            return self._predict(InertialSample(motion, None))
        order = self._inertial.outcome(motion)
        if order != "newer":
            self._diagnostics.issue(f"motion_{order}", f"sample at {motion.time_ns} ns")
            return False
        alone = self._inertial.on_vehicle(motion)
        return alone is not None and self._predict(InertialSample(alone, None))

    def on_imu(self, imu: Imu) -> bool:
        """Propagate the pose by an inertial unit; return whether this sample started the given pose."""
        if self._inertial is None:
            return False
        order = self._inertial.outcome(imu)
        if order != "newer":
            self._diagnostics.issue(f"imu_{order}", f"sample at {imu.time_ns} ns")
            return False
        was_upright, independent = self._inertial.is_upright, self.independent
        source = independent.position.filter if independent.active else self._filter
        sample = self._inertial.on_imu(imu, independent.speed, wheels_slip=source.wheel_slip_suspected)
        if was_upright and not self._inertial.is_upright:
            self._diagnostics.issue(
                "imu_mounting", f"z of the force is {imu.specific_force_m_s2[2]:.2f} m/s²"
            )
        return sample is not None and self._predict(sample)

    def _predict(self, sample: InertialSample) -> bool:
        motion, reading = sample
        outcome = self._filter.predict(motion, reading)
        if outcome in ("repeated", "backwards"):
            self._diagnostics.issue(f"motion_{outcome}", f"sample at {motion.time_ns} ns")
            return False
        self.independent.predict(motion, reading)
        if self.matcher is not None:
            self.matcher.set_attitude(motion.roll_rad, motion.pitch_rad)
        given, self._given = self._given, None
        if given is not None:
            self._start_from_given(given, motion)
        self._couple_links(motion.time_ns)
        self.independent.couple_links(motion.time_ns)
        return given is not None

    def on_fix(self, fix: Fix) -> None:
        """Use an unconfirmed fix to start, where the filter accepts one, and its height for the relief."""
        if fix.quality != "fixed":
            return
        self._use_height(fix)
        if not self._filter.accepts_fixes or self._filter.speed_is_unknown:
            self._start.reset()
            return
        placed = self._in_plane(fix)
        if placed is None:
            return
        pose = self._start.add(fix.time_ns, *placed, self._filter.track)
        if pose is not None and self._filter.start(pose):
            self._on_jump()
            self._diagnostics.count("started_from_fixes")

    def _use_height(self, fix: Fix) -> None:
        """Use the height of a fix for the relief, and for the track of the fixes."""
        if self._relief is None or self._fix_track is None:
            return
        track, road = self._filter.track, self._road.last
        step = self._fix_steps.step(fix, track.at(fix.time_ns), road)
        if step is not None:
            self._diagnostics.count("relief.fix_steps")
            self._relief.forget_offset()
            self._fix_track.on_step(step, fix.time_ns)
        self._relief.on_fix(fix, self._filter)
        if (
            self._filter.speed_is_integrated
        ):  # a track that the wheels have not measured has no shape to compare
            self._fix_track.forget()
        else:
            self._fix_track.on_fix(fix, track, road)

    def on_verdict(self, verdict: Verdict) -> None:
        """Anchor the pose to a confirmed position."""
        placed = self._in_plane(verdict) if verdict.verdict in CONFIRMED_VERDICTS else None
        if placed is None:
            return
        (east_m, north_m), covariance = placed
        tilt_m = self._antenna_shift_by_tilt(verdict.time_ns)
        result = self._filter.anchor(verdict.time_ns, east_m - tilt_m[0], north_m - tilt_m[1], covariance)
        if result.outcome == "recovered":
            self._on_jump()
        self._diagnostics.count(f"anchor.{result.outcome}")

    def on_sweep(self, sweep: Sweep) -> None:
        """Queue a sweep; it is matched once the motion up to its end is known."""
        if self.matcher is not None:
            self.independent.active = True
            self.matcher.add_sweep(sweep)

    def advance(self) -> LocalizationOutput:
        """Match the sweeps that are ready; return the matches, and the pose of the newest motion sample, once."""
        matches: tuple[ScanMatch, ...] = ()
        if self.matcher is not None and self._filter.time_ns is not None:
            output = self.matcher.process(self._plane, self._road.last)
            matches = output.matches
            if output.jumped:
                self._on_jump()
        time_ns = self._filter.time_ns
        if time_ns is None or time_ns <= self._published_ns:
            return LocalizationOutput(None, matches)
        self._published_ns = time_ns
        self._report_odometry_faults()
        return LocalizationOutput(self._pose(time_ns), matches)

    def _pose(self, time_ns: int) -> Pose:
        estimate = self._filter.estimate()
        if estimate is not None and self._plane is not None:
            estimate = self._move_plane_if_far(estimate, self._plane)
        if estimate is None or self._plane is None:
            road = Road(status="unknown", reason="no_pose")
            return Pose(
                time_ns=time_ns,
                mode="none",
                provenance="none",
                reason="not started: no given pose, and no fixes in a row that agree with the motion",
                independent=self._independent_position(time_ns),
                road=road,
            )
        plane, yaw_rad, link_id = self._plane, estimate.yaw_rad, estimate.link.link_id
        roll_rad, pitch_rad = self._attitude(estimate.time_ns, yaw_rad)
        east_m, north_m, _ = lever_arm_enu(roll_rad, pitch_rad, yaw_rad, self._lever_m)
        covariance = covariance_at_offset(estimate.covariance, east_m, north_m)
        latitude_rad, longitude_rad = plane.geodetic(estimate.east_m + east_m, estimate.north_m + north_m)
        road = self._road.update(estimate, latitude_rad, longitude_rad)
        if self._relief is not None:
            antenna_m = estimate.east_m + east_m, estimate.north_m + north_m
            self._relief.note_road(plane, antenna_m, road)
        if self._fix_track is not None:
            self._fix_track.note_road(latitude_rad, longitude_rad, road)
        self._links.note_map_version(road.map_version)
        self.independent.note_map_version(road.map_version)
        if self.matcher is not None:
            self.matcher.note_map_version(road.map_version)
        return Pose(
            time_ns=estimate.time_ns,
            mode=estimate.mode,
            provenance=estimate.provenance,
            reason="; ".join(self._reasons(estimate)),
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            yaw_rad=yaw_rad if estimate.yaw_known else None,
            covariance_east_north_yaw=tuple(covariance[_UPPER].tolist()),
            roll_rad=roll_rad,
            pitch_rad=pitch_rad,
            speed_m_s=estimate.speed_m_s,
            yaw_rate_rad_s=estimate.yaw_rate_rad_s,
            link_id=link_id if isinstance(link_id, int) else None,
            anchor_time_ns=estimate.anchor_time_ns,
            motion_time_ns=estimate.time_ns,
            match_time_ns=estimate.match_time_ns,
            horizontal_basis=horizontal_basis(
                estimate, since_given_m=self._filter.travelled_m - self._given_at_m
            ),
            independent=self._independent_position(time_ns),
            road=road,
            fixes_offset=None if self._fix_track is None else self._fix_track.offset,
            fix_run_begin_time_ns=self._fix_steps.run_begin_ns,
        )

    def _independent_position(self, time_ns: int) -> IndependentPosition | None:
        attitude = None if self.matcher is None else self.matcher.independent_attitude(time_ns)
        return self.independent.message(attitude)

    def _reasons(self, estimate: PoseEstimate) -> Iterator[str]:
        """Yield what degrades the pose, for an operator."""
        if estimate.mode == "provisional":
            yield "nothing but unconfirmed fixes stands for it"
        if estimate.conflict is not None:
            verb = "says" if estimate.conflict == "odometry" else "say"
            yield f"{estimate.conflict} {verb} another place"
        if estimate.wheel_slip_suspected:
            yield "the wheels do not say how fast the vehicle goes"
        if estimate.speed_m_s is None:
            yield "no speed"
        if not estimate.rotation_read:
            yield "no rotation"
        if self.matcher is not None and self.matcher.reason:
            yield self.matcher.reason

    def _report_odometry_faults(self) -> None:
        """Report a contradiction between odometry and confirmed positions, once while it lasts."""
        sensor, path = self._filter.sensor_fault, self._filter.path_fault
        if sensor is not None and "sensor" not in self._odometry_faults:
            text = f"{sensor.error} {sensor.estimate:.3g}, at most {sensor.bound:.3g}: a sensor, or positions led away"
            self._diagnostics.issue("sensor_out_of_bounds", text)
        if path is not None and "path" not in self._odometry_faults:
            text = (
                f"along {path.along_m_s:.2f} m/s, left {path.across_m_s:.2f} m/s, over {path.window_s:.0f} s"
            )
            self._diagnostics.issue("positions_leave_odometry", text)
        lasting = {"sensor": sensor, "path": path}
        self._odometry_faults = {name for name, fault in lasting.items() if fault is not None}

    def _attitude(self, time_ns: int, yaw_rad: float) -> tuple[float, float]:
        """Return roll and pitch by a recent match, else by the road's slope."""
        matched = None if self.matcher is None else self.matcher.attitude(time_ns)
        return attitude_on_road(self._road.last, yaw_rad) if matched is None else matched

    def _antenna_shift_by_tilt(self, time_ns: int) -> tuple[float, float]:
        """Return east and north of the antenna less where it is on a level road: the filter has no slope."""
        estimate = self._filter.estimate()
        if estimate is None:
            return 0.0, 0.0
        roll_rad, pitch_rad = self._attitude(time_ns, estimate.yaw_rad)
        east_m, north_m, _ = lever_arm_enu(roll_rad, pitch_rad, estimate.yaw_rad, self._lever_m)
        level = rotated(estimate.yaw_rad, self._lever_m[0], self._lever_m[1])
        return east_m - level[0], north_m - level[1]

    def _in_plane(self, message: Fix | Verdict) -> tuple[tuple[float, float], Floats] | None:
        """Return east and north of the antenna and their covariance (2, 2); None without a whole position."""
        latitude_rad, longitude_rad = message.latitude_rad, message.longitude_rad
        if latitude_rad is None or longitude_rad is None or message.covariance_enu_m2 is None:
            return None
        ee, en, _, nn, _, _ = message.covariance_enu_m2
        if not (ee > 0.0 and ee * nn > en * en):
            text = f"ee {ee:g}, en {en:g}, nn {nn:g} m²: not positive definite"
            self._diagnostics.issue("unusable_covariance", text)
            return None
        plane = self._plane_for(latitude_rad, longitude_rad)
        return plane.east_north(latitude_rad, longitude_rad), np.array([[ee, en], [en, nn]])

    def _couple_links(self, now_ns: int) -> None:
        estimate = self._filter.estimate()
        if estimate is None or self._plane is None:
            return
        matcher = self._links.matcher_at(self._plane, estimate.east_m, estimate.north_m, now_ns)
        match = LinkMatch(status="none")
        if matcher is not None:
            pose = (estimate.east_m, estimate.north_m, estimate.yaw_rad)
            match = matcher.step(pose, estimate.covariance, travelled_m=self._filter.travelled_m)
        self._diagnostics.count(f"link.{self._filter.couple_link(match)}")

    def _on_jump(self) -> None:
        self._links.restart()
        self._road.forget()
        if self.matcher is not None:
            self.matcher.reset_road_height()

    def _plane_for(self, latitude_rad: float, longitude_rad: float) -> LocalPlane:
        """Return the plane; a new one where there is no pose in it yet: a first fix may have been anywhere."""
        plane = self._plane
        if plane is not None and (self._filter.mode != "none" or plane.covers(latitude_rad, longitude_rad)):
            return plane
        return self._set_plane(LocalPlane(latitude_rad, longitude_rad))

    def _set_plane(self, plane: LocalPlane) -> LocalPlane:
        self._plane = plane
        self._start.reset()
        self._links.forget()
        return plane

    def _move_plane_if_far(self, estimate: PoseEstimate, plane: LocalPlane) -> PoseEstimate | None:
        """Return the estimate, in a new plane around it where it is too far from the origin of this one."""
        if not plane.is_too_far(estimate.east_m, estimate.north_m):
            return estimate
        self._plane = LocalPlane(*plane.geodetic(estimate.east_m, estimate.north_m))
        self._filter.shift_origin(estimate.east_m, estimate.north_m)
        self._start.shift(estimate.east_m, estimate.north_m)
        self._links.forget()
        return self._filter.estimate()

    def _start_from_given(self, given: GivenPose, motion: Motion) -> None:
        """Start from the given pose, in a plane around it, whatever plane earlier fixes have led to."""
        plane = self._set_plane(given.plane())
        start = given.start_pose(motion.time_ns, plane, self._lever_m[:2])
        self._filter.start(start)
        self._given_at_m = self._filter.travelled_m
        self.independent.start(start, given.plane(), motion)
