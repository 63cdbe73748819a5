"""Sweeps, the map around the vehicle and the filter's prediction become scan matches, and matches hold the pose.

A sweep waits until the motion up to its end is known. Then the local map is laid where the filter expects it, set down
on the road of the level that is being driven, and matched in layers. A match moves the pose through the filter's gate
only. Where the prediction is too wide for that, where matching has been lost for a while, where the filter keeps
refusing or nothing but fixes stands for the pose, a search looks around, and says whether its answer is the only one.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.se3 import roll_pitch_yaw_from_rotation, transform_points
from camber.localizer.filter.dead_reckoning import OverlayLag
from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_clouds.map_blocks import Block, BlockOptions
from camber.localizer.map_clouds.tile_loading import CloudTileLoader
from camber.localizer.map_queries import Diagnostics, MapAnswers
from camber.localizer.matching.coarse_search import REACH_M, REACH_RAD, SearchResult, search, seems_mirrored
from camber.localizer.matching.ground_alignment import (
    GroundAlignment,
    RoadBy,
    SensorHeights,
    align_to_road,
    measure_sensor_heights,
)
from camber.localizer.matching.layered_matching import LayeredMatch, MatchOptions, match_layers
from camber.localizer.matching.local_map import LEVEL, LocalMap
from camber.localizer.matching.match_view import MatchView, match_view
from camber.localizer.matching.shift_profile import log_likelihoods, shift_profile
from camber.localizer.matching.sweep_preparation import (
    PreparedSweep,
    SensorMount,
    SweepOptions,
    prepare_sweep,
)
from camber.localizer.road.road_attitude import GroundPlane, ground_plane
from camber.schemas.lidar import Sweep
from camber.schemas.pose import Road, ScanMatch

Array = NDArray[np.float64]

_MOST_WAITING = 3
_MOTION_COMES_NS = 300_000_000  # a sweep waits so long for the motion of its end
_HEIGHT_KEPT_M = 30.0  # a height that was matched tells the level for so far
_ATTITUDE_KEPT_NS = 300_000_000
_SEARCH_PAUSE_NS = 1_000_000_000
_SEARCH_AFTER = 3  # matches in a row that were lost or refused
_MIRRORED_AFTER = 50
_MISPLACED_AFTER = 10  # sweeps in a row; a crest or a kerb makes one of them look so
_SIGMAS = 3.0
_AHEAD_S = 3.0
STANDING_M = (0.3, 3.0)
"""Heights between which the local map is compared with what stands."""
_UNSURE_M = 0.5
_LOW_THINGS_M = 0.3
_LOW_THINGS_RAD = math.radians(0.5)
_RIVAL_GONE = math.log(1.0e6)
"""A place that is so much less likely by what stands is no rival."""
_STILL_HONEST = ("direction_unseen", "layers_disagree", "not_unique", "low_things")
"""Ambiguous, with a covariance that says how much."""
_NEVER_SEARCHED_NS = -_SEARCH_PAUSE_NS


@dataclass(frozen=True, slots=True)
class ScanMatchOptions:
    """How sweeps are used. A prediction whose 3 σ is beyond `sure_m`, `sure_rad` is searched around before anything is
    believed; one whose σ is beyond `most_sigma_m` is not looked for at all."""

    mount: SensorMount = field(default_factory=SensorMount)
    sweep: SweepOptions = field(default_factory=SweepOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    blocks: BlockOptions = field(default_factory=BlockOptions)
    sweeps: int = 10
    road_by: RoadBy = "surface"
    sure_m: float = 1.0
    sure_rad: float = math.radians(5.0)
    most_sigma_m: float = 5.0


class Done(NamedTuple):
    """The matches of the sweeps that were worked off, and whether the pose has jumped."""

    matches: tuple[ScanMatch, ...]
    jumped: bool


class _Found(NamedTuple):
    """A match, where the local map stood for it, and whether a search says that there is no other place like it."""

    match: LayeredMatch
    standing: GroundAlignment
    unique: bool
    behind: OverlayLag


class ScanMatcher:
    """One sensor's sweeps. Call `work` after what was heard of one time."""

    def __init__(
        self, options: ScanMatchOptions, pose: PoseFilter, answers: MapAnswers, reports: Diagnostics
    ) -> None:
        self._options, self._filter, self._reports = options, pose, reports
        self._supply = CloudTileLoader(options.blocks, answers, reports)
        self._local_map = LocalMap(options.sweeps)
        self._waiting: deque[Sweep] = deque()
        self._tilt: tuple[float, float] | None = None  # roll and pitch by a sensor
        self._matched: tuple[int, float, float] | None = None  # time, roll and pitch by the last match
        # Ellipsoidal, of the road under the vehicle, and the path driven then.
        self._height: tuple[float, float] | None = None
        self._last_sweep_ns: int | None = None
        self._searched_ns = _NEVER_SEARCHED_NS
        self._consecutive_failures = 0  # matches in a row that were lost or refused
        self._misplaced = 0
        self._view: tuple[int, Array, Block, _Found] | None = None
        self.reason = ""

    # What is heard

    def add_sweep(self, sweep: Sweep) -> None:
        """A sweep, worked off when the motion up to its end is known."""
        if len(self._waiting) == _MOST_WAITING:
            self._waiting.popleft()
            self._reports.count("sweep.dropped")
        self._waiting.append(sweep)

    def set_attitude(self, roll_rad: float | None, pitch_rad: float | None) -> None:
        """Roll and pitch against gravity by a sensor; None where it gave nothing."""
        self._tilt = None if roll_rad is None or pitch_rad is None else (roll_rad, pitch_rad)

    def note_map_version(self, map_version: int | None) -> None:
        """The map's other answers are of this version."""
        self._supply.note_map_version(map_version)

    def reset_road_height(self) -> None:
        """The pose has jumped: the level may be another one."""
        self._height = None

    # What is asked

    def attitude(self, time_ns: int) -> tuple[float, float] | None:
        """Roll and pitch as matched to the road just now."""
        if self._matched is None or not 0 <= time_ns - self._matched[0] <= _ATTITUDE_KEPT_NS:
            return None
        return self._matched[1:]

    @property
    def last_view(self) -> MatchView | None:
        """The last match, for a picture of it."""
        if self._view is None:
            return None
        time_ns, points_m, block, found = self._view
        return match_view(
            time_ns, points_m, found.standing.heights_m, block, found.match, self._options.match
        )

    # Work

    def work(self, plane: LocalPlane | None, road: Road) -> Done:
        """Match the sweeps whose motion is known; `road` is the one under the last pose."""
        matches: list[ScanMatch] = []
        jumped = False
        now_ns = self._filter.time_ns
        while now_ns is not None and self._waiting:
            if 0 < self._waiting[0].time_ns - now_ns < _MOTION_COMES_NS:
                break
            match, moved = self._one(self._waiting.popleft(), now_ns, plane, road)
            matches.append(match)
            jumped |= moved
        return Done(tuple(matches), jumped)

    def _one(self, raw: Sweep, now_ns: int, plane: LocalPlane | None, road: Road) -> tuple[ScanMatch, bool]:
        sweep = prepare_sweep(
            raw.points_m,
            raw.offset_ns,
            raw.time_ns,
            self._options.mount,
            self._filter.track,
            now_ns=now_ns,
            last_time_ns=self._last_sweep_ns,
            options=self._options.sweep,
        )
        if sweep.problem is not None:
            self._reports.issue(f"sweep_{sweep.problem}", f"sweep of {raw.sensor} at {raw.time_ns} ns")
        if not sweep.usable or sweep.at is None:
            return self._lost(raw.time_ns, f"sweep: {sweep.problem or 'no_motion'}")
        self._last_sweep_ns = raw.time_ns
        estimate = self._filter.estimate()
        if estimate is not None and estimate.wheel_slip_suspected:
            self._local_map.reset()  # sweeps laid on one another by a wrong speed are a smear
        own = ground_plane(sweep.points_m, self._options.mount)
        self._local_map.add(sweep, sweep.at, self._tilt, road_tilt=own.tilt if own is not None else LEVEL)
        prediction = self._filter.prediction_at(raw.time_ns)
        if prediction is None or plane is None:
            return self._lost(raw.time_ns, "no pose to begin from")
        if not prediction.yaw_known:
            return self._lost(raw.time_ns, "the heading is not known")
        if _sigma_m(prediction) > self._options.most_sigma_m:
            return self._lost(raw.time_ns, "the pose is too uncertain")
        place = plane.geodetic(prediction.east_m, prediction.north_m)
        block = self._supply.block_at(*place, now_ns)
        if block is None:
            return self._lost(raw.time_ns, f"map: {self._supply.reason}")
        turned_rad = _convergence(plane, block, prediction)
        near_m = self._near_height(road)
        if near_m is None:
            return self._lost(raw.time_ns, "which road it is, is not known")
        found = self._find(sweep.time_ns, block, prediction, place, turned_rad, near_m - block.base_height_m)
        if estimate is not None and estimate.speed_m_s:
            self._build_ahead(plane, prediction, estimate.speed_m_s)
        if found is None:
            return self._lost(raw.time_ns, "map: no road here")
        return self._apply_match(sweep, own, found, plane, block, turned_rad)

    def _build_ahead(self, plane: LocalPlane, prediction: Prediction, speed_m_s: float) -> None:
        """A step towards the block where the vehicle will be in some seconds, so that no border costs half a second."""
        ahead_m = _AHEAD_S * speed_m_s
        place = plane.geodetic(
            prediction.east_m + ahead_m * math.cos(prediction.yaw_rad),
            prediction.north_m + ahead_m * math.sin(prediction.yaw_rad),
        )
        self._supply.build_ahead(*place, self._options.match.bounds_m)

    def _near_height(self, road: Road) -> float | None:
        """Ellipsoidal height of the road that is driven, by the last match or by the road that the links lead along."""
        if self._height is not None and abs(self._filter.travelled_m - self._height[1]) < _HEIGHT_KEPT_M:
            return self._height[0]
        return road.elevation_m

    def _find(
        self,
        time_ns: int,
        block: Block,
        prediction: Prediction,
        place: tuple[float, float],
        turned_rad: float,
        near_m: float,
    ) -> _Found | None:
        local = self._local_map.overlay()
        assert local is not None, "a sweep has just been added"
        options = self._options.match
        east_m, north_m = block.east_north(*place)
        yaw_rad = prediction.yaw_rad - turned_rad
        by = self._options.road_by
        standing = align_to_road(local.points_m, block, east_m, north_m, yaw_rad, near_m, by=by)
        if standing is None:
            return None
        targets = block.layers(options.bounds_m)
        material = (local.points_m, standing.heights_m, targets, standing.map_from_local, options)
        unique = False
        reach = self._search_reach(prediction, time_ns)
        if reach is not None:
            self._searched_ns = time_ns
            result = search(*material, *reach)
            match, unique = result.match, result.unique and result.match.status != "lost"
            if result.rivals and _beats(result, local.points_m, standing, block):
                match, unique = result.best, True
            if (
                self._consecutive_failures
                and self._consecutive_failures % _MIRRORED_AFTER == 0
                and seems_mirrored(*material)
            ):
                self._reports.issue("sensor_mirrored", "sweeps fit the map with left and right exchanged")
        else:
            match = match_layers(*material)
            if match.status != "lost" and self._too_wide(prediction):
                # Between two searches nothing is known of other places.
                match = replace(match, status="ambiguous", reason="not_searched")
        if match.status == "lost":
            match, unique = self._by_low_things(local.points_m, standing, block, reach)
        else:
            match = _doubted(match, local.points_m, standing, block)
        found = _Found(match, standing, unique, local.behind)
        self._view = (time_ns, local.points_m, block, found)
        return found

    def _by_low_things(
        self, points_m: Array, standing: GroundAlignment, block: Block, reach: tuple[float, float] | None
    ) -> tuple[LayeredMatch, bool]:
        """Where nothing fits that stands: by fences, hedges and cars, which may have moved; believed no more."""
        options = self._options.match
        targets = block.layers(options.bounds_m, steady=False)
        material = (points_m, standing.heights_m, targets, standing.map_from_local, options)
        if reach is None:
            match, unique = match_layers(*material), False
        else:
            result = search(*material, *reach)
            match, unique = result.match, result.unique
        if match.status != "converged":
            return replace(match, status="lost"), False
        covariance = match.covariance + np.diag([_LOW_THINGS_M**2, _LOW_THINGS_M**2, _LOW_THINGS_RAD**2])
        return replace(match, status="ambiguous", reason="low_things", covariance=covariance), unique

    def _too_wide(self, prediction: Prediction) -> bool:
        sigma_rad = math.sqrt(float(prediction.covariance[2, 2]))
        wide = _SIGMAS * _sigma_m(prediction) > self._options.sure_m
        return wide or _SIGMAS * sigma_rad > self._options.sure_rad

    def _search_reach(self, prediction: Prediction, time_ns: int) -> tuple[float, float] | None:
        """How far to search (m, rad); None: no search now."""
        in_vain = self._consecutive_failures >= _SEARCH_AFTER or self._filter.mode == "provisional"
        if not in_vain and not self._too_wide(prediction):
            return None
        if 0 <= time_ns - self._searched_ns < _SEARCH_PAUSE_NS:
            return None
        if in_vain:
            return REACH_M, REACH_RAD
        sigma_rad = math.sqrt(float(prediction.covariance[2, 2]))
        reach_m = _SIGMAS * _sigma_m(prediction) + self._options.sure_m
        return min(reach_m, REACH_M), min(_SIGMAS * sigma_rad + self._options.sure_rad, REACH_RAD)

    # What comes out

    def _apply_match(
        self,
        sweep: PreparedSweep,
        own: GroundPlane | None,
        found: _Found,
        plane: LocalPlane,
        block: Block,
        turned_rad: float,
    ) -> tuple[ScanMatch, bool]:
        """Tell the filter, and everybody else what has become of the match."""
        match, standing = found.match, found.standing
        heights = measure_sensor_heights(
            sweep.points_m, own, self._options.mount, match.map_from_local, block
        )
        self._misplaced = self._misplaced + 1 if heights.misplaced else 0
        status: str = match.status
        reason: str = "" if status == "converged" else match.reason
        outcome = ""
        if self._misplaced >= _MISPLACED_AFTER:
            status, reason = "ambiguous", "the sensor is not where its mount says"
            self._reports.issue("sensor_mounting", "its own returns from the road put it elsewhere")
        elif match.status == "converged" or match.reason in _STILL_HONEST:
            east_m, north_m = plane.east_north(*block.geodetic(match.east_m, match.north_m))
            outcome = self._filter.match(
                sweep.time_ns,
                east_m,
                north_m,
                match.yaw_rad + turned_rad,
                match.covariance,
                unique=found.unique,
                behind=found.behind,
            ).outcome
            self._reports.count(f"match.{outcome}")
            if outcome == "outside_gate":
                status, reason = "ambiguous", "contradicts the pose"
        if status != "lost" and outcome in ("accepted", "recovered", "supported"):
            self._consecutive_failures = 0
            self._keep_attitude(sweep.time_ns, heights.map_from_vehicle, standing, block)
        else:
            self._consecutive_failures += 1
        self.reason = f"scan match {status}: {reason}" if reason else ""
        if status != "lost":
            share = self._filter.motion_share(found.behind, match.yaw_rad)
            match = replace(match, covariance=match.covariance + share)
        said = _message(sweep.time_ns, status, reason, match, heights, self._options.mount, block)
        return said, outcome in ("recovered", "supported")

    def _keep_attitude(
        self, time_ns: int, map_from_vehicle: Array, standing: GroundAlignment, block: Block
    ) -> None:
        if standing.road is None:
            return
        roll_rad, pitch_rad, _ = roll_pitch_yaw_from_rotation(map_from_vehicle)
        self._matched = (time_ns, roll_rad, pitch_rad)
        self._height = (float(map_from_vehicle[2, 3]) + block.base_height_m, self._filter.travelled_m)

    def _lost(self, time_ns: int, reason: str) -> tuple[ScanMatch, bool]:
        self.reason = f"scan match lost: {reason}"
        self._consecutive_failures += 1
        self._reports.count("match.lost")
        return ScanMatch(time_ns=time_ns, status="lost", reason=reason), False


def _beats(result: SearchResult, points_m: Array, standing: GroundAlignment, block: Block) -> bool:
    """Whether what stands tells the best place from those that have as many points on the map: long walls fit
    anywhere along themselves, and outnumber what does not."""
    poses = [result.best.map_from_local, *(rival.map_from_local for rival in result.rivals)]
    best, *others = log_likelihoods(points_m[_stands(standing)], poses, block.above).tolist()
    return bool(best - max(others) > _RIVAL_GONE)


def _stands(standing: GroundAlignment) -> NDArray[np.bool_]:
    return (standing.heights_m > STANDING_M[0]) & (standing.heights_m < STANDING_M[1])


def _doubted(match: LayeredMatch, points_m: Array, standing: GroundAlignment, block: Block) -> LayeredMatch:
    """A match that is not lost, with the variance that shifts along its worst direction leave open."""
    values, vectors = np.linalg.eigh(match.covariance[:2, :2])
    worst = vectors[:, 1]
    placed_m = transform_points(match.map_from_local, points_m[_stands(standing)])
    more_m2 = shift_profile(placed_m, block.above, worst).variance_m2 - float(values[1])
    if more_m2 <= 0.0:
        return match
    covariance = match.covariance.copy()
    covariance[:2, :2] += more_m2 * np.outer(worst, worst)
    if match.status == "converged" and more_m2 > _UNSURE_M**2:
        return replace(match, status="ambiguous", reason="direction_unseen", covariance=covariance)
    return replace(match, covariance=covariance)


def _message(
    time_ns: int,
    status: str,
    reason: str,
    match: LayeredMatch,
    heights: SensorHeights,
    mount: SensorMount,
    block: Block,
) -> ScanMatch:
    if status == "lost":
        return ScanMatch(time_ns=time_ns, status="lost", reason=reason, **_distances(match))
    sensor_m = (heights.map_from_vehicle @ mount.vehicle_from_sensor)[:3, 3]
    latitude_rad, longitude_rad = block.geodetic(float(sensor_m[0]), float(sensor_m[1]))
    c = match.covariance
    overlaps = [row.fit.overlap for row in match.layers if row.outcome == "used"]
    return ScanMatch(
        time_ns=time_ns,
        status="converged" if status == "converged" else "ambiguous",
        reason=reason,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=float(sensor_m[2]) + block.base_height_m,
        sensor_height_m=heights.matched_m,
        sensor_height_sigma_m=heights.matched_sigma_m,
        ground_height_m=heights.ground_m,
        ground_height_sigma_m=heights.ground_sigma_m,
        road_slope_forward=heights.slope_forward,
        road_slope_left=heights.slope_left,
        roll_pitch_yaw_rad=roll_pitch_yaw_from_rotation(heights.map_from_vehicle),
        covariance_east_north=(float(c[0, 0]), float(c[0, 1]), float(c[1, 1])),
        overlap=float(np.mean(overlaps)) if overlaps else None,
        **_distances(match),
    )


def _distances(match: LayeredMatch) -> dict[str, Any]:
    """Of the layers that had partners."""
    distances = np.array([row.fit.mean_distance_m for row in match.layers])
    layer = np.flatnonzero(np.isfinite(distances))
    return {"layer": layer.astype(np.int32), "layer_mean_distance_m": distances[layer]}


def _sigma_m(prediction: Prediction) -> float:
    return math.sqrt(max(float(prediction.covariance[0, 0]), float(prediction.covariance[1, 1])))


def _convergence(plane: LocalPlane, block: Block, prediction: Prediction) -> float:
    """How far the block's east is turned against the plane's where the vehicle is (rad)."""
    here = block.east_north(*plane.geodetic(prediction.east_m, prediction.north_m))
    east = block.east_north(*plane.geodetic(prediction.east_m + 10.0, prediction.north_m))
    return -math.atan2(east[1] - here[1], east[0] - here[0])
