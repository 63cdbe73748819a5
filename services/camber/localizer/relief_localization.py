"""The road's relief in the world: heights of fixes against the map's heights, for the independent position.

Of a fix only time, height and vertical variance are used. A height updates the independent position by the road at
*its* place, on the surface that its own links lead to. Where there is no independent position, or it is lost, heights
start one (`ReliefStart`); the pose, which may rest on fixes, is the begin of that search alone.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import largest_variance, rotated
from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.independent_localization import IndependentLocalization
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_queries import Diagnostics, MapQueries, MapQueryFailure
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.height_states import HeightStates
from camber.localizer.relief.relief_start import PlacedPose, ReliefStart
from camber.localizer.relief.road_ribbon import RibbonPlane
from camber.localizer.relief.white_noise import WhiteNoise
from camber.schemas.gnss import Fix
from camber.schemas.pose import Road
from camber.schemas.road import ElevationRequest

_SPACING_M: Final = 5.0  # chosen: the map's errors are the same within it, and at a standstill nothing is new
_WHITE_SIGMA_M: Final = 0.01  # chosen: noise of the phases, and the vehicle's heave on its springs
_MAX_SIGMA_M: Final = 15.0  # chosen: beyond it one plane does not show the road's height at the true place
_LOST_SIGMA_M: Final = 10.0  # chosen: dead reckoning has left the road that the map knows
_CURVATURE_PER_M: Final = 4e-4  # derived: a crest of 2.5 km radius, the least for 60 km/h (RAS-L 1995)
_REOPEN_AFTER: Final = 5  # chosen: this many heights in a row and 20 m are a lasting offset of the fixes
_EVIDENCE_NATS: Final = math.log(2.0)  # chosen: the heights have halved the area of the position's ellipse
_MAX_LINKS: Final = 16  # derived: the most that an `ElevationRequest` holds


class ReliefLocalization:
    """Uses heights of fixes for one vehicle's independent position. `lever_m`: antenna, x forward, y left, z up."""

    def __init__(
        self,
        model: HeightErrorModel,
        lever_m: tuple[float, float, float],
        independent: IndependentLocalization,
        *,
        map_queries: MapQueries,
        diagnostics: Diagnostics,
    ) -> None:
        self._independent, self._lever_m = independent, lever_m
        self._map_queries, self._diagnostics = map_queries, diagnostics
        position = independent.position
        self._states = HeightStates(position.state, model)
        self._white_noise = WhiteNoise(model)
        self._start = ReliefStart(model, position.filter.model.motion)
        self._start_plane: LocalPlane | None = None
        self._road: Road | None = None
        self._rejections = 0
        self._used_at_m, self._used_ns = -math.inf, 0
        self._gained_nats = 0.0

    def note_road(self, plane: LocalPlane, antenna_m: tuple[float, float], road: Road) -> None:
        """Note the road below the pose's antenna, for a start."""
        self._road = road
        if road.status != "known" or road.elevation_m is None:
            return
        if road.slope_east is None or road.slope_north is None:
            return
        if plane is not self._start_plane:
            self._start_plane = plane
            self._start.forget()
        slopes = road.slope_east, road.slope_north
        self._start.add_road(RibbonPlane(*antenna_m, road.elevation_m, road.sigma_m or 0.0, *slopes))

    def forget_offset(self) -> None:
        """Forget what heights have in common: the next fixes are of other integers or of another base."""
        self._states.reopen()
        self._start.forget_heights(stepped=True)
        self._rejections = 0

    def on_fix(self, fix: Fix, pose: PoseFilter) -> None:
        """Use the height of a fix; `pose` begins the search for a start."""
        if fix.quality != "fixed" or fix.covariance_enu_m2 is None:
            return
        sigma_m = math.sqrt(max(0.0, fix.covariance_enu_m2[5]) + _WHITE_SIGMA_M**2)
        height_m = fix.height_m - self._lever_m[2]
        position = self._independent.position
        if position.evidence is not None:
            self._update(fix, height_m, sigma_m)
        if self._road is not None and self._road.status == "known":
            self._independent.active = True
            if position.filter.wheel_slip_suspected or position.filter.speed_is_integrated:
                self._start.forget()
            elif self._road.datum in (None, fix.datum):
                self._try_start(fix.time_ns, height_m, sigma_m, pose)

    @property
    def _is_lost(self) -> bool:
        """Whether there is no independent position, or one that heights cannot update."""
        position = self._independent.position
        return position.evidence is None or position.state.horizontal_sigma_m > _LOST_SIGMA_M

    def _try_start(self, time_ns: int, height_m: float, sigma_m: float, pose: PoseFilter) -> None:
        plane, position, road = self._start_plane, self._independent.position, self._road
        track, placed = position.filter.track.at(time_ns), pose.prediction_at(time_ns)
        self._start.forget_before(position.filter.track.begin_ns)
        if plane is None or road is None or track is None or placed is None or not placed.yaw_known:
            return
        due = self._start.add_height(
            time_ns, track, height_m=height_m, sigma_m=sigma_m, map_sigma_m=road.sigma_m or 0.0
        )
        if not due or not self._is_lost:
            return
        lever = self._lever_m[0], self._lever_m[1]
        start = self._start.solve(PlacedPose(placed.east_m, placed.north_m, placed.yaw_rad, lever))
        self._diagnostics.count("relief.start_tried")
        if start is not None and self._independent.start_by_relief(start, plane):
            self._states.reset()
            self._white_noise.forget()
            self._start.forget()
            self._used_at_m, self._used_ns = track.path_m, time_ns
            self._diagnostics.count("relief.started")

    def _update(self, fix: Fix, height_m: float, sigma_m: float) -> None:
        """Update the independent position by a height, once every few metres."""
        position, time_ns = self._independent.position, fix.time_ns
        track, predicted = position.filter.track.at(time_ns), position.filter.prediction_at(time_ns)
        if track is None or predicted is None or track.path_m - self._used_at_m < _SPACING_M:
            return
        spread_m2 = largest_variance(predicted.covariance)
        if not predicted.yaw_known or spread_m2 > _MAX_SIGMA_M**2:
            return
        road = self._road_at(predicted, time_ns)
        if road is None or road.elevation_m is None or road.datum not in (None, fix.datum):
            return
        passed_m = 0.0 if math.isinf(self._used_at_m) else track.path_m - self._used_at_m
        self._states.age(passed_m, max(0.0, (time_ns - self._used_ns) * 1e-9) if self._used_ns else 0.0)
        self._used_at_m, self._used_ns = track.path_m, time_ns
        before = position.state.p[:2, :2].copy()
        residual_m, map_sigma_m = height_m - road.elevation_m, road.sigma_m or 0.0
        self._white_noise.add(residual_m, (predicted.east_m, predicted.north_m), map_sigma_m)
        update = position.update_height(
            time_ns,
            residual_m,
            (road.slope_east or 0.0, road.slope_north or 0.0),
            variance_m2=sigma_m**2 + (0.5 * _CURVATURE_PER_M * spread_m2) ** 2,
            extra=self._states.row(map_sigma_m, self._white_noise.sigma_m(sigma_m)),
        )
        self._diagnostics.count(f"relief.{update.outcome}")
        if update.outcome == "outside_gate":
            self._rejections += 1
            if self._rejections >= _REOPEN_AFTER:
                self._states.reopen()
                self._rejections = 0
        elif update.outcome == "accepted":
            self._rejections = 0
            self._note_gain(time_ns, before, position.state.p[:2, :2])

    def _note_gain(self, time_ns: int, before: Floats, after: Floats) -> None:
        """Note evidence once heights have given as much information as all else: a flat road never does."""
        self._gained_nats += 0.5 * math.log(float(np.linalg.det(before)) / float(np.linalg.det(after)))
        if self._gained_nats >= _EVIDENCE_NATS:
            self._gained_nats = 0.0
            self._independent.position.note_evidence("relief", time_ns)

    def _road_at(self, predicted: Prediction, time_ns: int) -> Road | None:
        """Return the road at the independent position's antenna, of its own links; None where it is not known."""
        plane, estimate = self._independent.plane, self._independent.position.estimate()
        if plane is None or estimate is None:
            return None
        lever = rotated(predicted.yaw_rad, self._lever_m[0], self._lever_m[1])
        latitude_rad, longitude_rad = plane.geodetic(
            predicted.east_m + lever[0], predicted.north_m + lever[1]
        )
        link = estimate.link
        links = link.candidates or (() if link.link_id is None else (link.link_id,))
        request = ElevationRequest(
            time_ns=time_ns,
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            link_ids=tuple(int(link_id) for link_id in links)[:_MAX_LINKS],
        )
        reply = self._map_queries.elevation(request)
        if isinstance(reply, MapQueryFailure) or reply.road.status != "known":
            return None
        return reply.road
