"""A match before the filters' gates, and where it was looked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.track import OverlayLag
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.ground_alignment import GroundAlignment, PlanarPose
from camber.localizer.matching.layered_matching import LayeredMatch, MatchInput
from camber.localizer.matching.match_guide import MatchGuide


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchPlace:
    """Where a sweep is matched: the prediction in the guide's plane, and the block."""

    guide: MatchGuide
    prediction: Prediction
    plane: LocalPlane
    block: MapBlock

    @property
    def pose(self) -> PlanarPose:
        """The predicted pose in the block's frame."""
        here = self.block.east_north(*self.plane.geodetic(self.prediction.east_m, self.prediction.north_m))
        return PlanarPose(*here, self.prediction.yaw_rad - self.convergence_rad)

    @cached_property
    def convergence_rad(self) -> float:
        """Angle of the block's east from the plane's at the vehicle."""
        return _convergence_rad(self.block, self.plane, (self.prediction.east_m, self.prediction.north_m))


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchCandidate:
    """A match before the filter's gate, its input and alignment, and whether a search has excluded rivals."""

    time_ns: int
    match: LayeredMatch
    scan: MatchInput
    alignment: GroundAlignment
    unique: bool
    lag: OverlayLag
    place: MatchPlace

    def pose_in(self, plane: LocalPlane) -> tuple[float, float, float]:
        """Return east, north [m] and yaw [rad] of the match in a plane."""
        match, place = self.match, self.place
        here = plane.east_north(*place.block.geodetic(match.east_m, match.north_m))
        if plane is place.plane:
            return *here, match.yaw_rad + place.convergence_rad
        return *here, match.yaw_rad + _convergence_rad(place.block, plane, here)


def _convergence_rad(block: MapBlock, plane: LocalPlane, east_north_m: tuple[float, float]) -> float:
    """Return the angle of the block's east from the plane's at a place in the plane."""
    east_m, north_m = east_north_m
    here = block.east_north(*plane.geodetic(east_m, north_m))
    east = block.east_north(*plane.geodetic(east_m + 10.0, north_m))
    return -math.atan2(east[1] - here[1], east[0] - here[0])
