"""Scan matching of sweeps: deskew → overlay → align to the road → split into layers → register → select → update
the pose.

A sweep waits until the motion up to its end is known. A match updates the pose through the filter's gate only.
Where the prediction is too uncertain, after several matches that were lost or rejected, and while the pose rests on
fixes alone, a coarse search looks for the position and for rivals of it.

The track of the independent position deskews and overlays, and while that position is certain it also predicts:
then no fix has a part in a match. Otherwise sweeps are matched around the pose, for the pose alone, and now and then a
search looks for the independent position, around it or, where it is lost, around the pose.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.scan_match_update import MatchUpdate
from camber.localizer.independent_localization import IndependentLocalization
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_clouds.map_blocks import MapBlock, MapBlockOptions
from camber.localizer.map_clouds.tile_scheduling import CloudTileLoader
from camber.localizer.map_queries import Diagnostics, MapQueries
from camber.localizer.matching.coarse_search import (
    FULL_RANGE,
    SearchRange,
    search,
    seems_mirrored,
)
from camber.localizer.matching.deskewing import SweepOptions
from camber.localizer.matching.ground_alignment import (
    RoadBy,
    SensorHeights,
    align_to_road,
    measure_sensor_heights,
)
from camber.localizer.matching.layered_matching import (
    LayeredMatch,
    MatchInput,
    MatchOptions,
    MatchStatus,
    match_layers,
)
from camber.localizer.matching.local_map import LEVEL, LocalMap
from camber.localizer.matching.match_candidate import MatchCandidate, MatchPlace
from camber.localizer.matching.match_guide import SEARCH_PAUSE_NS, CertaintyLimits, MatchGuide
from camber.localizer.matching.match_points import match_points
from camber.localizer.matching.match_view import MatchView, match_view
from camber.localizer.matching.scan_match_message import scan_match_message
from camber.localizer.matching.structure_likelihood import outweighs_rivals, with_shift_variance
from camber.localizer.matching.sweep_preparation import (
    PreparedSweep,
    SensorMount,
    prepare_sweep,
)
from camber.localizer.road.ground_plane_fit import GroundPlane, ground_plane
from camber.schemas.lidar import Sweep
from camber.schemas.pose import Road, ScanMatch, ScanMatchPoints

_MAX_QUEUED: Final = 3  # chosen: of sweeps; a later one replaces the oldest
_MOTION_WAIT_NS: Final = 300_000_000  # chosen: how long a sweep waits for the motion of its end
_LONGEST_PAUSE_NS: Final = (
    8 * SEARCH_PAUSE_NS
)  # chosen: 20 to 100 m of street between searches that find nothing
_MIRRORED_AFTER: Final = 50  # chosen: consecutive failures between two tests for a mirrored sensor
_MISPLACED_AFTER: Final = 10  # chosen: consecutive sweeps; a crest or a kerb makes one look misplaced
_AHEAD_S: Final = 3.0  # chosen: a block is built in less time
# Chosen: σ added where only objects fit that may have moved.
_MOVABLE_SIGMA_M: Final = 0.3
_MOVABLE_SIGMA_RAD: Final = math.radians(0.5)
_USED: Final = ("accepted", "recovered", "supported")
"""Outcomes of a match that has updated the pose."""
_USABLE_IF_AMBIGUOUS: Final = ("direction_unseen", "layers_disagree", "not_unique", "low_things")
"""Ambiguous for reasons that the covariance covers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanMatchOptions:
    """Parameters of scan matching."""

    mount: SensorMount = field(default_factory=SensorMount)
    sweep: SweepOptions = field(default_factory=SweepOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    blocks: MapBlockOptions = field(default_factory=MapBlockOptions)
    sweeps: int = 10
    road_by: RoadBy = "surface"
    limits: CertaintyLimits = field(default_factory=CertaintyLimits)


class ScanMatcherOutput(NamedTuple):
    """The matches of the sweeps that were processed, and whether the pose has jumped."""

    matches: tuple[ScanMatch, ...]
    jumped: bool


class ScanMatcher:
    """Matches one sensor's sweeps. Call `process` after all inputs of one time."""

    def __init__(
        self,
        options: ScanMatchOptions,
        pose: PoseFilter,
        map_queries: MapQueries,
        diagnostics: Diagnostics,
        *,
        independent: IndependentLocalization | None = None,
    ) -> None:
        self._options, self._filter, self._diagnostics = options, pose, diagnostics
        self._pose_guide = MatchGuide(pose=pose, limits=options.limits)
        self._independent = independent
        self._independent_guide: MatchGuide | None = None
        if independent is not None:
            self._independent_guide = MatchGuide(pose=independent.position.filter, limits=options.limits)
        self._pause_ns = SEARCH_PAUSE_NS  # until the next search for the independent position
        self._tiles = CloudTileLoader(options.blocks, map_queries, diagnostics)
        self._local_map = LocalMap(options.sweeps)
        self._queue: deque[Sweep] = deque()
        self._measured_tilt: tuple[float, float] | None = None  # roll and pitch by a sensor
        self._last_sweep_ns: int | None = None
        self._consecutive_misplaced = 0
        self._last: MatchCandidate | None = None
        self._overlaid_by: PoseFilter | None = None  # whose track places the overlaid sweeps
        self.reason = ""

    def add_sweep(self, sweep: Sweep) -> None:
        """Queue a sweep; it is processed when the motion up to its end is known."""
        if len(self._queue) == _MAX_QUEUED:
            self._queue.popleft()
            self._diagnostics.count("sweep.dropped")
        self._queue.append(sweep)

    def set_attitude(self, roll_rad: float | None, pitch_rad: float | None) -> None:
        """Set roll and pitch against gravity by a sensor; None where it gave none."""
        self._measured_tilt = None if roll_rad is None or pitch_rad is None else (roll_rad, pitch_rad)

    def note_map_version(self, map_version: int | None) -> None:
        """Note the version of the map's other replies."""
        self._tiles.note_map_version(map_version)

    def reset_road_height(self) -> None:
        """Forget the road's height: the pose has jumped, the deck may be another one."""
        self._pose_guide.forget_road_height()

    def attitude(self, time_ns: int) -> tuple[float, float] | None:
        """Return roll and pitch of a recent match that the pose follows."""
        return self._pose_guide.attitude(time_ns)

    def independent_attitude(self, time_ns: int) -> tuple[float, float] | None:
        """Return roll and pitch of a recent match that the independent position follows."""
        return None if self._independent_guide is None else self._independent_guide.attitude(time_ns)

    @property
    def last_view(self) -> MatchView | None:
        """The last match, for a picture of it."""
        last = self._last
        if last is None:
            return None
        return match_view(last.time_ns, last.scan, last.place.block, last.match, options=self._options.match)

    def last_points(self) -> ScanMatchPoints | None:
        """The points of the last match and their residuals, for viewers; None without one."""
        return None if self._last is None else match_points(self._last, self._options.match)

    def process(self, plane: LocalPlane | None, road: Road) -> ScanMatcherOutput:
        """Match the sweeps whose motion is known; `road` is the one below the last pose."""
        matches: list[ScanMatch] = []
        jumped = False
        now_ns = self._filter.time_ns
        while now_ns is not None and self._queue:
            if 0 < self._queue[0].time_ns - now_ns < _MOTION_WAIT_NS:
                break
            match, has_jumped = self._process_sweep(self._queue.popleft(), now_ns, plane, road)
            matches.append(match)
            jumped |= has_jumped
        return ScanMatcherOutput(tuple(matches), jumped)

    def _process_sweep(
        self, raw: Sweep, now_ns: int, plane: LocalPlane | None, road: Road
    ) -> tuple[ScanMatch, bool]:
        """Deskew, overlay, align to the road, register the layers, and update the pose."""
        sweep = self._deskew(raw, now_ns)
        if not sweep.usable or sweep.at is None:
            return self._lost(raw.time_ns, f"sweep: {sweep.problem or 'no_motion'}")
        ground = self._overlay(sweep)
        guide, guides_plane = self._guide(raw.time_ns, plane)
        place = self._locate(guide, guides_plane, raw.time_ns, now_ns)
        if isinstance(place, str):
            self._seek_independent(sweep, None, plane, road)
            return self._lost(raw.time_ns, place)
        candidate = self._match(sweep.time_ns, place, road)
        if not isinstance(candidate, str):
            self._last = candidate
        self._build_ahead(place)
        if guide is self._pose_guide:
            self._seek_independent(sweep, None if isinstance(candidate, str) else candidate, plane, road)
        if isinstance(candidate, str):
            return self._lost(raw.time_ns, candidate)
        return self._apply_match(sweep, ground, candidate, plane)

    def _guide(self, time_ns: int, plane: LocalPlane | None) -> tuple[MatchGuide, LocalPlane | None]:
        """Return the pose that predicts a sweep, and its plane: the independent one where it is certain."""
        independent, guide = self._independent, self._independent_guide
        if independent is None or guide is None or not independent.knows_motion:
            return self._pose_guide, plane
        if not guide.is_certain(time_ns):
            return self._pose_guide, plane
        return guide, independent.plane

    def _deskew(self, raw: Sweep, now_ns: int) -> PreparedSweep:
        sweep = prepare_sweep(
            raw,
            self._options.mount,
            self._motion.track,
            now_ns=now_ns,
            last_time_ns=self._last_sweep_ns,
            options=self._options.sweep,
        )
        if sweep.problem is not None:
            self._diagnostics.issue(f"sweep_{sweep.problem}", f"sweep of {raw.sensor} at {raw.time_ns} ns")
        if sweep.usable and sweep.at is not None:
            self._last_sweep_ns = raw.time_ns
        return sweep

    def _overlay(self, sweep: PreparedSweep) -> GroundPlane | None:
        """Add a sweep to the local map; return its ground.

        Sweeps are not accumulated while the speed is not known, nor over a change of the track that places them.
        """
        assert sweep.at is not None
        if not self._motion.measures_distance or self._motion is not self._overlaid_by:
            self._local_map.reset()
        self._overlaid_by = self._motion
        ground = ground_plane(sweep.points_m, self._options.mount)
        tilt = ground.tilt if ground is not None else LEVEL
        self._local_map.add(sweep, sweep.at, self._measured_tilt, road_tilt=tilt)
        return ground

    @property
    def _motion(self) -> PoseFilter:
        """Whose track deskews and overlays: one that no fix has calibrated, where there is one that knows its speed."""
        independent = self._independent
        if independent is None or not independent.knows_motion:
            return self._filter
        return independent.position.filter

    def _locate(
        self, guide: MatchGuide, plane: LocalPlane | None, time_ns: int, now_ns: int
    ) -> MatchPlace | str:
        """Return where to match, or the reason why not."""
        prediction = guide.prediction(time_ns)
        if isinstance(prediction, str):
            return prediction
        if plane is None:
            return "no pose to begin from"
        block = self._tiles.block_at(*plane.geodetic(prediction.east_m, prediction.north_m), now_ns)
        if block is None:
            return f"map: {self._tiles.reason}"
        return MatchPlace(guide=guide, prediction=prediction, plane=plane, block=block)

    def _build_ahead(self, place: MatchPlace) -> None:
        """Do a step of building the block ahead, so that no border costs half a second."""
        estimate, prediction = place.guide.pose.estimate(), place.prediction
        if estimate is None or not estimate.speed_m_s:
            return
        ahead_m = _AHEAD_S * estimate.speed_m_s
        ahead = place.plane.geodetic(
            prediction.east_m + ahead_m * math.cos(prediction.yaw_rad),
            prediction.north_m + ahead_m * math.sin(prediction.yaw_rad),
        )
        self._tiles.build_ahead(*ahead, self._options.match.bounds_m)

    def _match(
        self, time_ns: int, place: MatchPlace, road: Road, *, reach: SearchRange | None = None
    ) -> MatchCandidate | str:
        """Align the local map to the road and match its layers, with a search within `reach` or where one is due;
        return the reason where the road is not known."""
        local, block, options = self._local_map.overlay(), place.block, self._options.match
        assert local is not None, "a sweep has just been added"
        road_m = place.guide.road_height_m(road)
        if road_m is None:
            return "which road it is, is not known"
        near_m = road_m - block.base_height_m
        alignment = align_to_road(local.points_m, block, place.pose, near_m=near_m, by=self._options.road_by)
        if alignment is None:
            return "map: no road here"
        scan = MatchInput(
            points_m=local.points_m,
            heights_m=alignment.heights_m,
            targets=block.layers(options.bounds_m),
            guess=alignment.map_from_local,
        )
        reach = reach or place.guide.search_range(place.prediction, time_ns)
        match, unique = self._register(scan, place, reach)
        if match.status == "lost":
            match, unique = self._match_movable(scan, block, reach)
        else:
            match = with_shift_variance(match, scan, block)
        if reach is not None:
            place.guide.searched_ns = time_ns
        return MatchCandidate(
            time_ns=time_ns,
            match=match,
            scan=scan,
            alignment=alignment,
            unique=unique,
            lag=local.lag,
            place=place,
        )

    def _register(
        self, scan: MatchInput, place: MatchPlace, reach: SearchRange | None
    ) -> tuple[LayeredMatch, bool]:
        """Match the layers, by a search where one is due; return whether the match is unique too."""
        options = self._options.match
        if reach is None:
            match = match_layers(scan, options)
            if match.status != "lost" and place.guide.is_uncertain(place.prediction):
                # Between two searches rivals are not known.
                match = replace(match, status="ambiguous", reason="not_searched")
            return match, False
        result = search(scan, options, reach)
        match, unique = result.match, result.unique and result.match.status != "lost"
        if result.rivals and outweighs_rivals(result, scan, place.block):
            match, unique = result.best, True
        failures = place.guide.consecutive_failures
        if failures and failures % _MIRRORED_AFTER == 0 and seems_mirrored(scan, options):
            self._diagnostics.issue("sensor_mirrored", "sweeps fit the map with left and right exchanged")
        return match, unique

    def _match_movable(
        self, scan: MatchInput, block: MapBlock, reach: SearchRange | None
    ) -> tuple[LayeredMatch, bool]:
        """Match with fences, hedges and cars too, which may have moved: ambiguous, with a larger covariance."""
        options = self._options.match
        scan = replace(scan, targets=block.layers(options.bounds_m, static_only=False))
        result = None if reach is None else search(scan, options, reach)
        match = match_layers(scan, options) if result is None else result.match
        if match.status != "converged":
            return replace(match, status="lost"), False
        added = np.diag([_MOVABLE_SIGMA_M**2, _MOVABLE_SIGMA_M**2, _MOVABLE_SIGMA_RAD**2])
        match = replace(match, status="ambiguous", reason="low_things", covariance=match.covariance + added)
        return match, result is not None and result.unique

    def _apply_match(
        self,
        sweep: PreparedSweep,
        ground: GroundPlane | None,
        candidate: MatchCandidate,
        plane: LocalPlane | None,
    ) -> tuple[ScanMatch, bool]:
        """Update the pose by a match; return its message, and whether the pose has jumped."""
        match, block, mount = candidate.match, candidate.place.block, self._options.mount
        heights = measure_sensor_heights(
            sweep.points_m, ground, mount, matched=match.map_from_local, block=block
        )
        self._consecutive_misplaced = self._consecutive_misplaced + 1 if heights.misplaced else 0
        status: MatchStatus = match.status
        reason: str = "" if status == "converged" else match.reason
        outcome = ""
        if self._consecutive_misplaced >= _MISPLACED_AFTER:
            status, reason = "ambiguous", "the sensor is not where its mount says"
            self._diagnostics.issue("sensor_mounting", "the road in its sweeps contradicts its mounting")
        elif match.status == "converged" or match.reason in _USABLE_IF_AMBIGUOUS:
            outcome = self._update_pose(candidate, plane)
            self._diagnostics.count(f"match.{outcome}")
            if outcome == "outside_gate":
                status, reason = "ambiguous", "contradicts the pose"
        used = status != "lost" and outcome in _USED
        self._pose_guide.note_outcome(used=used)
        if used:
            self._keep_road(self._pose_guide, candidate, heights)
        if candidate.place.guide is self._independent_guide:
            used = outcome != "" and self._update_independent(candidate).accepted
            self._independent_guide.note_outcome(used=used)
            if used:
                self._keep_road(self._independent_guide, candidate, heights)
        self.reason = f"scan match {status}: {reason}" if reason else ""
        if status != "lost":
            share = self._filter.motion_share(candidate.lag, match.yaw_rad)
            match = replace(match, covariance=match.covariance + share)
        message = scan_match_message(
            sweep.time_ns, (status, reason), match, heights=heights, mount=mount, block=block
        )
        return message, outcome in ("recovered", "supported")

    def _update_pose(self, candidate: MatchCandidate, plane: LocalPlane | None) -> str:
        """Update the pose by a match; that around the certain independent position leaves no other place open."""
        if plane is None:
            return "no_pose"
        place, match = candidate.place, candidate.match
        unique = candidate.unique or place.guide is self._independent_guide
        return self._filter.match(
            candidate.time_ns,
            candidate.pose_in(plane),
            match.covariance,
            unique=unique,
            overlay_lag=candidate.lag,
        ).outcome

    def _update_independent(self, candidate: MatchCandidate) -> MatchUpdate:
        """Update the independent position by a match that converged."""
        independent, match, guide = self._independent, candidate.match, candidate.place.guide
        if independent is None or match.status != "converged":
            return MatchUpdate("no_pose")
        plane = independent.plane_for(*candidate.place.block.geodetic(match.east_m, match.north_m))
        result = independent.match(
            candidate.time_ns,
            candidate.pose_in(plane),
            match.covariance,
            unique=candidate.unique,
            overlay_lag=candidate.lag,
            predicted_here=guide is self._independent_guide,
        )
        self._diagnostics.count(f"independent.match.{result.outcome}")
        return result

    def _seek_independent(
        self, sweep: PreparedSweep, candidate: MatchCandidate | None, plane: LocalPlane | None, road: Road
    ) -> None:
        """Search for the independent position, now and then: around it, or where it is lost around the pose.

        `candidate`: the match around the pose, which serves where it was searched for. A position that is not certain
        is not matched without a search: along a row of equal houses any of them fits.
        """
        independent, guide = self._independent, self._independent_guide
        if independent is None or guide is None or not independent.knows_motion:
            return
        if 0 <= sweep.time_ns - guide.searched_ns < self._pause_ns:
            return
        guide.searched_ns = sweep.time_ns
        prediction = guide.prediction(sweep.time_ns)
        lost = isinstance(prediction, str) or independent.plane is None
        if not lost or candidate is None or not candidate.unique:
            around, its_plane = (self._pose_guide, plane) if lost else (guide, independent.plane)
            place = self._locate(around, its_plane, sweep.time_ns, sweep.time_ns)
            if isinstance(place, str):
                return
            reach = FULL_RANGE if isinstance(prediction, str) else guide.range_around(prediction)
            candidate = self._search(sweep.time_ns, place, road, reach)
        usable = candidate is not None and candidate.unique and candidate.match.status == "converged"
        self._pause_ns = SEARCH_PAUSE_NS if usable else min(2 * self._pause_ns, _LONGEST_PAUSE_NS)
        if candidate is not None and usable and self._update_independent(candidate).accepted:
            guide.note_outcome(used=True)

    def _search(
        self, time_ns: int, place: MatchPlace, road: Road, reach: SearchRange
    ) -> MatchCandidate | None:
        """Search for the independent position; the pose's own next search is due when it was."""
        searched_ns = self._pose_guide.searched_ns
        candidate = self._match(time_ns, place, road, reach=reach)
        self._pose_guide.searched_ns = searched_ns
        return None if isinstance(candidate, str) else candidate

    def _keep_road(self, guide: MatchGuide, candidate: MatchCandidate, heights: SensorHeights) -> None:
        """Keep attitude and road height of a match that was used, where the local map has shown the road."""
        if candidate.alignment.road is None:
            return
        roll_rad, pitch_rad, _ = roll_pitch_yaw_from_rotation(heights.map_from_vehicle)
        height_m = float(heights.map_from_vehicle[2, 3]) + candidate.place.block.base_height_m
        guide.keep_road(candidate.time_ns, (roll_rad, pitch_rad), height_m)

    def _lost(self, time_ns: int, reason: str) -> tuple[ScanMatch, bool]:
        self.reason = f"scan match lost: {reason}"
        self._pose_guide.note_outcome(used=False)
        if self._independent_guide is not None:
            self._independent_guide.note_outcome(used=False)
        self._diagnostics.count("match.lost")
        return ScanMatch(time_ns=time_ns, status="lost", reason=reason), False
