"""Scan matching of sweeps: deskew → overlay → align to the road → split into layers → register → select → update
the pose.

A sweep waits until the motion up to its end is known. A match updates the pose through the filter's gate only.
Where the prediction is too uncertain, after several matches that were lost or rejected, and while the pose rests on
fixes alone, a coarse search looks for the position and for rivals of it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.se3 import roll_pitch_yaw_from_rotation, transform_points
from camber.localizer.arrays import Floats, Mask
from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.track import OverlayLag
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_clouds.map_blocks import MapBlock, MapBlockOptions
from camber.localizer.map_clouds.tile_loading import CloudTileLoader
from camber.localizer.map_queries import Diagnostics, MapQueries
from camber.localizer.matching.coarse_search import (
    FULL_RANGE,
    SearchRange,
    SearchResult,
    search,
    seems_mirrored,
)
from camber.localizer.matching.deskewing import SweepOptions
from camber.localizer.matching.ground_alignment import (
    GroundAlignment,
    PlanarPose,
    RoadBy,
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
from camber.localizer.matching.match_covariance import DEGENERATE_SIGMA_M
from camber.localizer.matching.match_view import MatchView, match_view
from camber.localizer.matching.scan_match_message import scan_match_message
from camber.localizer.matching.shift_profile import log_likelihoods, shift_profile
from camber.localizer.matching.sweep_preparation import (
    PreparedSweep,
    SensorMount,
    prepare_sweep,
)
from camber.localizer.road.road_attitude import GroundPlane, ground_plane
from camber.schemas.lidar import Sweep
from camber.schemas.pose import Road, ScanMatch

_MAX_QUEUED: Final = 3  # chosen: of sweeps; a later one replaces the oldest
_MOTION_WAIT_NS: Final = 300_000_000  # chosen: how long a sweep waits for the motion of its end
_HEIGHT_VALID_M: Final = 30.0  # chosen: distance over which a matched road height identifies the deck
_ATTITUDE_VALID_NS: Final = 300_000_000  # chosen: three sweeps of a LiDAR at 10 Hz
_SEARCH_PAUSE_NS: Final = 1_000_000_000  # chosen: a search costs several matches
_SEARCH_AFTER: Final = 3  # chosen: consecutive matches that were lost or rejected
_MIRRORED_AFTER: Final = 50  # chosen: consecutive failures between two tests for a mirrored sensor
_MISPLACED_AFTER: Final = 10  # chosen: consecutive sweeps; a crest or a kerb makes one look misplaced
_SIGMAS: Final = 3.0  # chosen: 99.7 % of a normal error
_AHEAD_S: Final = 3.0  # chosen: a block is built in less time
STRUCTURE_M: Final = (0.3, 3.0)
"""Chosen: heights between which the local map is compared with the static structure: the bounds of the layers."""
# Chosen: σ added where only objects fit that may have moved.
_MOVABLE_SIGMA_M: Final = 0.3
_MOVABLE_SIGMA_RAD: Final = math.radians(0.5)
_RIVAL_LOG_RATIO: Final = math.log(1.0e6)
"""Chosen: a rival that the static structure makes so much less likely is none."""
_USABLE_IF_AMBIGUOUS: Final = ("direction_unseen", "layers_disagree", "not_unique", "low_things")
"""Ambiguous for reasons that the covariance covers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanMatchOptions:
    """Parameters of scan matching. A prediction whose 3 σ exceeds `sure_m` or `sure_rad` is searched around; one
    whose σ exceeds `max_sigma_m` is not matched."""

    mount: SensorMount = field(default_factory=SensorMount)
    sweep: SweepOptions = field(default_factory=SweepOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    blocks: MapBlockOptions = field(default_factory=MapBlockOptions)
    sweeps: int = 10
    road_by: RoadBy = "surface"
    sure_m: float = 1.0
    sure_rad: float = math.radians(5.0)
    max_sigma_m: float = 5.0


class ScanMatcherOutput(NamedTuple):
    """The matches of the sweeps that were processed, and whether the pose has jumped."""

    matches: tuple[ScanMatch, ...]
    jumped: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class _MatchPlace:
    """Where a sweep is matched: the prediction in the plane, and the block."""

    prediction: Prediction
    plane: LocalPlane
    block: MapBlock

    @property
    def pose(self) -> PlanarPose:
        """The predicted pose in the block's frame."""
        return PlanarPose(*self._in_block(0.0), self.prediction.yaw_rad - self.convergence_rad)

    @cached_property
    def convergence_rad(self) -> float:
        """Angle of the block's east from the plane's at the vehicle."""
        here, east = self._in_block(0.0), self._in_block(10.0)
        return -math.atan2(east[1] - here[1], east[0] - here[0])

    def _in_block(self, further_east_m: float) -> tuple[float, float]:
        east_m = self.prediction.east_m + further_east_m
        return self.block.east_north(*self.plane.geodetic(east_m, self.prediction.north_m))


@dataclass(frozen=True, eq=False, kw_only=True)
class _MatchCandidate:
    """A match before the filter's gate, its input and alignment, and whether a search has excluded rivals."""

    time_ns: int
    match: LayeredMatch
    scan: MatchInput
    alignment: GroundAlignment
    unique: bool
    lag: OverlayLag
    block: MapBlock


class ScanMatcher:
    """Matches one sensor's sweeps. Call `process` after all inputs of one time."""

    def __init__(
        self, options: ScanMatchOptions, pose: PoseFilter, map_queries: MapQueries, diagnostics: Diagnostics
    ) -> None:
        self._options, self._filter, self._diagnostics = options, pose, diagnostics
        self._tiles = CloudTileLoader(options.blocks, map_queries, diagnostics)
        self._local_map = LocalMap(options.sweeps)
        self._queue: deque[Sweep] = deque()
        self._measured_tilt: tuple[float, float] | None = None  # roll and pitch by a sensor
        self._matched_attitude: tuple[int, float, float] | None = None  # time; roll and pitch by a match
        self._road_height: tuple[float, float] | None = None  # ellipsoidal, and the path driven then
        self._last_sweep_ns: int | None = None
        self._searched_ns = -_SEARCH_PAUSE_NS
        self._consecutive_failures = 0
        self._consecutive_misplaced = 0
        self._last: _MatchCandidate | None = None
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
        self._road_height = None

    def attitude(self, time_ns: int) -> tuple[float, float] | None:
        """Return roll and pitch of a recent match."""
        matched = self._matched_attitude
        if matched is None or not 0 <= time_ns - matched[0] <= _ATTITUDE_VALID_NS:
            return None
        return matched[1:]

    @property
    def last_view(self) -> MatchView | None:
        """The last match, for a picture of it."""
        last = self._last
        if last is None:
            return None
        return match_view(last.time_ns, last.scan, last.block, last.match, options=self._options.match)

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
        place = self._locate(raw.time_ns, now_ns, plane)
        if isinstance(place, str):
            return self._lost(raw.time_ns, place)
        near_m = self._road_height_m(road)
        if near_m is None:
            return self._lost(raw.time_ns, "which road it is, is not known")
        candidate = self._match(sweep.time_ns, place, near_m - place.block.base_height_m)
        self._build_ahead(place)
        if candidate is None:
            return self._lost(raw.time_ns, "map: no road here")
        return self._apply_match(sweep, ground, candidate, place)

    def _deskew(self, raw: Sweep, now_ns: int) -> PreparedSweep:
        sweep = prepare_sweep(
            raw,
            self._options.mount,
            self._filter.track,
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
        """Add a sweep to the local map; return its ground. Not accumulated over suspected wheel slip."""
        assert sweep.at is not None
        estimate = self._filter.estimate()
        if estimate is not None and estimate.wheel_slip_suspected:
            self._local_map.reset()
        ground = ground_plane(sweep.points_m, self._options.mount)
        tilt = ground.tilt if ground is not None else LEVEL
        self._local_map.add(sweep, sweep.at, self._measured_tilt, road_tilt=tilt)
        return ground

    def _locate(self, time_ns: int, now_ns: int, plane: LocalPlane | None) -> _MatchPlace | str:
        """Return where to match, or the reason why not."""
        prediction = self._filter.prediction_at(time_ns)
        if prediction is None or plane is None:
            return "no pose to begin from"
        if not prediction.yaw_known:
            return "the heading is not known"
        if prediction.position_sigma_m > self._options.max_sigma_m:
            return "the pose is too uncertain"
        block = self._tiles.block_at(*plane.geodetic(prediction.east_m, prediction.north_m), now_ns)
        if block is None:
            return f"map: {self._tiles.reason}"
        return _MatchPlace(prediction=prediction, plane=plane, block=block)

    def _road_height_m(self, road: Road) -> float | None:
        """Return the ellipsoidal height of the driven road, by the last match or by the road of the links."""
        height = self._road_height
        if height is not None and abs(self._filter.travelled_m - height[1]) < _HEIGHT_VALID_M:
            return height[0]
        return road.elevation_m

    def _build_ahead(self, place: _MatchPlace) -> None:
        """Do a step of building the block ahead, so that no border costs half a second."""
        estimate, prediction = self._filter.estimate(), place.prediction
        if estimate is None or not estimate.speed_m_s:
            return
        ahead_m = _AHEAD_S * estimate.speed_m_s
        ahead = place.plane.geodetic(
            prediction.east_m + ahead_m * math.cos(prediction.yaw_rad),
            prediction.north_m + ahead_m * math.sin(prediction.yaw_rad),
        )
        self._tiles.build_ahead(*ahead, self._options.match.bounds_m)

    def _match(self, time_ns: int, place: _MatchPlace, near_m: float) -> _MatchCandidate | None:
        """Align the local map to the road and match its layers; None where the map has no road."""
        local, block, options = self._local_map.overlay(), place.block, self._options.match
        assert local is not None, "a sweep has just been added"
        alignment = align_to_road(local.points_m, block, place.pose, near_m=near_m, by=self._options.road_by)
        if alignment is None:
            return None
        scan = MatchInput(
            points_m=local.points_m,
            heights_m=alignment.heights_m,
            targets=block.layers(options.bounds_m),
            guess=alignment.map_from_local,
        )
        reach = self._search_range(place.prediction, time_ns)
        match, unique = self._register(scan, block, place.prediction, reach)
        if match.status == "lost":
            match, unique = self._match_movable(scan, block, reach)
        else:
            match = _with_shift_variance(match, scan, block)
        self._last = _MatchCandidate(
            time_ns=time_ns,
            match=match,
            scan=scan,
            alignment=alignment,
            unique=unique,
            lag=local.lag,
            block=block,
        )
        if reach is not None:
            self._searched_ns = time_ns
        return self._last

    def _register(
        self, scan: MatchInput, block: MapBlock, prediction: Prediction, reach: SearchRange | None
    ) -> tuple[LayeredMatch, bool]:
        """Match the layers, by a search where one is due; return whether the match is unique too."""
        options = self._options.match
        if reach is None:
            match = match_layers(scan, options)
            if match.status != "lost" and self._is_uncertain(prediction):
                # Between two searches rivals are not known.
                match = replace(match, status="ambiguous", reason="not_searched")
            return match, False
        result = search(scan, options, reach)
        match, unique = result.match, result.unique and result.match.status != "lost"
        if result.rivals and _outweighs_rivals(result, scan, block):
            match, unique = result.best, True
        failures = self._consecutive_failures
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

    def _is_uncertain(self, prediction: Prediction) -> bool:
        wide = _SIGMAS * prediction.position_sigma_m > self._options.sure_m
        return wide or _SIGMAS * prediction.yaw_sigma_rad > self._options.sure_rad

    def _search_range(self, prediction: Prediction, time_ns: int) -> SearchRange | None:
        """Return how far to search; None: no search is due."""
        lost = self._consecutive_failures >= _SEARCH_AFTER or self._filter.mode == "provisional"
        if not lost and not self._is_uncertain(prediction):
            return None
        if 0 <= time_ns - self._searched_ns < _SEARCH_PAUSE_NS:
            return None
        if lost:
            return FULL_RANGE
        return SearchRange(
            m=min(_SIGMAS * prediction.position_sigma_m + self._options.sure_m, FULL_RANGE.m),
            rad=min(_SIGMAS * prediction.yaw_sigma_rad + self._options.sure_rad, FULL_RANGE.rad),
        )

    def _apply_match(
        self, sweep: PreparedSweep, ground: GroundPlane | None, candidate: _MatchCandidate, place: _MatchPlace
    ) -> tuple[ScanMatch, bool]:
        """Update the pose by a match; return its message, and whether the pose has jumped."""
        match, block, mount = candidate.match, candidate.block, self._options.mount
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
            east_m, north_m = place.plane.east_north(*block.geodetic(match.east_m, match.north_m))
            outcome = self._filter.match(
                sweep.time_ns,
                (east_m, north_m, match.yaw_rad + place.convergence_rad),
                match.covariance,
                unique=candidate.unique,
                overlay_lag=candidate.lag,
            ).outcome
            self._diagnostics.count(f"match.{outcome}")
            if outcome == "outside_gate":
                status, reason = "ambiguous", "contradicts the pose"
        if status != "lost" and outcome in ("accepted", "recovered", "supported"):
            self._consecutive_failures = 0
            if candidate.alignment.road is not None:
                self._keep_attitude(sweep.time_ns, heights.map_from_vehicle, block)
        else:
            self._consecutive_failures += 1
        self.reason = f"scan match {status}: {reason}" if reason else ""
        if status != "lost":
            share = self._filter.motion_share(candidate.lag, match.yaw_rad)
            match = replace(match, covariance=match.covariance + share)
        message = scan_match_message(
            sweep.time_ns, (status, reason), match, heights=heights, mount=mount, block=block
        )
        return message, outcome in ("recovered", "supported")

    def _keep_attitude(self, time_ns: int, map_from_vehicle: Floats, block: MapBlock) -> None:
        roll_rad, pitch_rad, _ = roll_pitch_yaw_from_rotation(map_from_vehicle)
        self._matched_attitude = (time_ns, roll_rad, pitch_rad)
        self._road_height = (float(map_from_vehicle[2, 3]) + block.base_height_m, self._filter.travelled_m)

    def _lost(self, time_ns: int, reason: str) -> tuple[ScanMatch, bool]:
        self.reason = f"scan match lost: {reason}"
        self._consecutive_failures += 1
        self._diagnostics.count("match.lost")
        return ScanMatch(time_ns=time_ns, status="lost", reason=reason), False


def _outweighs_rivals(result: SearchResult, scan: MatchInput, block: MapBlock) -> bool:
    """Whether the static structure makes the best match far more likely than rivals with as many points on the map:
    long walls fit anywhere along themselves, and outnumber what does not."""
    poses = [result.best.map_from_local, *(rival.map_from_local for rival in result.rivals)]
    points_m = scan.points_m[_is_structure(scan)]
    best, *others = log_likelihoods(points_m, poses, block.static_occupancy).tolist()
    return bool(best - max(others) > _RIVAL_LOG_RATIO)


def _is_structure(scan: MatchInput) -> Mask:
    return (scan.heights_m > STRUCTURE_M[0]) & (scan.heights_m < STRUCTURE_M[1])


def _with_shift_variance(match: LayeredMatch, scan: MatchInput, block: MapBlock) -> LayeredMatch:
    """Return the match with the variance that shifts along its worst direction leave open."""
    values, vectors = np.linalg.eigh(match.covariance[:2, :2])
    worst = vectors[:, 1]
    placed_m = transform_points(match.map_from_local, scan.points_m[_is_structure(scan)])
    more_m2 = shift_profile(placed_m, block.static_occupancy, worst).variance_m2 - float(values[1])
    if more_m2 <= 0.0:
        return match
    covariance = match.covariance.copy()
    covariance[:2, :2] += more_m2 * np.outer(worst, worst)
    if match.status == "converged" and more_m2 > DEGENERATE_SIGMA_M**2:
        return replace(match, status="ambiguous", reason="direction_unseen", covariance=covariance)
    return replace(match, covariance=covariance)
