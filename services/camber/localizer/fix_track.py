"""The track of the fixes in the world: where it lies against the map by its heights, for the judge.

Unlike in the independent position, east and north of fixes are used here; nothing of it enters any pose.
"""

from __future__ import annotations

import math
from typing import Final

from camber.localizer.arrays import Floats
from camber.localizer.filter.track import RelativeTrack
from camber.localizer.local_plane import LocalPlane
from camber.localizer.relief.fix_step_detection import FixStep
from camber.localizer.relief.fix_track_offset import FixTrackOffset, FixTrackOffsets, TrackHeight
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.road_ribbon import RibbonPlane
from camber.schemas.gnss import Fix
from camber.schemas.pose import FixesOffset, Road

_REACH_M: Final = 10_000.0  # derived: there distances are off by 1e-6, and north by 0.1° at 45° latitude


class FixTrack:
    """Follows the fixes of one vehicle; `antenna_z_m`: of the antenna above the road."""

    def __init__(self, model: HeightErrorModel, *, antenna_z_m: float) -> None:
        self._antenna_z_m = antenna_z_m
        self._offsets = FixTrackOffsets(model)
        self._plane: LocalPlane | None = None
        self.offset: FixesOffset | None = None
        """The newest estimate; None where heights do not determine one."""

    def note_road(self, latitude_rad: float, longitude_rad: float, road: Road) -> None:
        """Note the road below the pose's antenna."""
        if road.elevation_m is None or road.slope_east is None or road.slope_north is None:
            return
        plane = self._plane
        if plane is None or math.hypot(*plane.east_north(latitude_rad, longitude_rad)) > _REACH_M:
            plane = LocalPlane(latitude_rad, longitude_rad)
            self._restart(plane)
        place_m = plane.east_north(latitude_rad, longitude_rad)
        slopes = road.slope_east, road.slope_north
        self._offsets.add_road(RibbonPlane(*place_m, road.elevation_m, road.sigma_m or 0.0, *slopes))

    def on_step(self, step: FixStep, time_ns: int) -> None:
        """Begin anew: the next fixes are of other integers or of another base, and are off by another vector.

        Until their own heights show it, it is the one before and what they have moved by.
        """
        self._offsets.forget_fixes(stepped=True)
        self.offset = None if self.offset is None else _after_step(self.offset, step, time_ns)

    def on_fix(self, fix: Fix, track: RelativeTrack, road: Road) -> None:
        """Take a fix; `road` is the newest one below the pose."""
        place, same_datum = track.at(fix.time_ns), road.datum in (None, fix.datum)
        if self._plane is None or place is None or road.status != "known" or not same_datum:
            return
        east_m, north_m = self._plane.east_north(fix.latitude_rad, fix.longitude_rad)
        height = TrackHeight(
            time_s=1e-9 * fix.time_ns,
            path_m=place.path_m,
            east_m=east_m,
            north_m=north_m,
            height_m=fix.height_m - self._antenna_z_m,
            map_sigma_m=road.sigma_m or 0.0,
        )
        if self._offsets.add(height):
            result = self._offsets.estimate()
            self.offset = None if result is None else _message(result)

    def forget(self) -> None:
        """Begin anew: the track is another one."""
        self.offset = None
        self._offsets.forget()

    def _restart(self, plane: LocalPlane) -> None:
        self._plane = plane
        self.forget()


def _message(result: FixTrackOffset) -> FixesOffset:
    east_m, north_m = result.offset_m.tolist()
    east_m_s, north_m_s = result.growth_m_s.tolist()
    return FixesOffset(
        begin_time_ns=round(1e9 * result.begin_s),
        end_time_ns=round(1e9 * result.end_s),
        east_north_m=(east_m, north_m),
        covariance_east_north=_upper(result.covariance_m2),
        growth_east_north_m_s=(east_m_s, north_m_s),
        growth_covariance_east_north=_upper(result.growth_covariance),
    )


def _after_step(offset: FixesOffset, step: FixStep, time_ns: int) -> FixesOffset | None:
    if step.east_north_m is None:
        return None
    (east_m, north_m), (step_east_m, step_north_m) = offset.east_north_m, step.east_north_m
    ee, en, nn = offset.covariance_east_north
    return offset.model_copy(
        update={
            "end_time_ns": time_ns,
            "east_north_m": (east_m + step_east_m, north_m + step_north_m),
            "covariance_east_north": (ee + step.variance_m2, en, nn + step.variance_m2),
            "steps": offset.steps + 1,
        }
    )


def _upper(covariance: Floats) -> tuple[float, float, float]:
    (ee, en), (_, nn) = covariance.tolist()
    return ee, en, nn
