"""The pose around which sweeps are matched, and what its matches have shown."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.matching.coarse_search import FULL_RANGE, SearchRange
from camber.schemas.pose import Road

SEARCH_PAUSE_NS: Final = 1_000_000_000  # chosen: a search costs several matches
_SEARCH_AFTER: Final = 3  # chosen: consecutive matches that were lost or rejected
_HEIGHT_VALID_M: Final = 30.0  # chosen: distance over which a matched road height identifies the deck
_ATTITUDE_VALID_NS: Final = 300_000_000  # chosen: three sweeps of a LiDAR at 10 Hz
_SIGMAS: Final = 3.0  # chosen: 99.7 % of a normal error


@dataclass(frozen=True, slots=True, kw_only=True)
class CertaintyLimits:
    """A prediction whose 3 σ exceeds `sure_m` or `sure_rad` is searched around; one whose σ exceeds `max_sigma_m` is
    not matched."""

    sure_m: float = 1.0
    sure_rad: float = math.radians(5.0)
    max_sigma_m: float = 5.0


@dataclass(slots=True, kw_only=True)
class MatchGuide:
    """A pose that predicts where sweeps are; its last search, failures, road height and attitude."""

    pose: PoseFilter
    limits: CertaintyLimits
    searched_ns: int = -SEARCH_PAUSE_NS
    consecutive_failures: int = 0
    _road_height: tuple[float, float] | None = field(
        default=None, init=False
    )  # ellipsoidal, and the path driven then
    _attitude: tuple[int, float, float] | None = field(
        default=None, init=False
    )  # time; roll and pitch by a match

    def prediction(self, time_ns: int) -> Prediction | str:
        """Return where a sweep is matched, or the reason why it is not."""
        prediction = self.pose.prediction_at(time_ns)
        if prediction is None:
            return "no pose to begin from"
        if not prediction.yaw_known:
            return "the heading is not known"
        if prediction.position_sigma_m > self.limits.max_sigma_m:
            return "the pose is too uncertain"
        return prediction

    def is_certain(self, time_ns: int) -> bool:
        """Whether a sweep is matched around the prediction without a search."""
        prediction = self.prediction(time_ns)
        return not isinstance(prediction, str) and not self.is_uncertain(prediction)

    def is_uncertain(self, prediction: Prediction) -> bool:
        """Whether a prediction has to be searched around."""
        wide = _SIGMAS * prediction.position_sigma_m > self.limits.sure_m
        return wide or _SIGMAS * prediction.yaw_sigma_rad > self.limits.sure_rad

    def search_range(self, prediction: Prediction, time_ns: int) -> SearchRange | None:
        """Return how far to search; None: no search is due."""
        lost = self.consecutive_failures >= _SEARCH_AFTER or self.pose.mode == "provisional"
        if not lost and not self.is_uncertain(prediction):
            return None
        if 0 <= time_ns - self.searched_ns < SEARCH_PAUSE_NS:
            return None
        if lost:
            return FULL_RANGE
        return self.range_around(prediction)

    def range_around(self, prediction: Prediction) -> SearchRange:
        """Return how far to search around a prediction by its covariance."""
        return SearchRange(
            m=min(_SIGMAS * prediction.position_sigma_m + self.limits.sure_m, FULL_RANGE.m),
            rad=min(_SIGMAS * prediction.yaw_sigma_rad + self.limits.sure_rad, FULL_RANGE.rad),
        )

    def note_outcome(self, *, used: bool) -> None:
        """Count consecutive matches that did not update the pose."""
        self.consecutive_failures = 0 if used else self.consecutive_failures + 1

    def keep_road(self, time_ns: int, attitude_rad: tuple[float, float], height_m: float) -> None:
        """Keep roll and pitch of a match, and the ellipsoidal height of the road there."""
        self._attitude = (time_ns, *attitude_rad)
        self._road_height = (height_m, self.pose.travelled_m)

    def forget_road_height(self) -> None:
        """Forget the road's height: the pose has jumped, the deck may be another one."""
        self._road_height = None

    def road_height_m(self, road: Road) -> float | None:
        """Return the ellipsoidal height of the driven road, by the last match or by the road of the links."""
        height = self._road_height
        if height is not None and abs(self.pose.travelled_m - height[1]) < _HEIGHT_VALID_M:
            return height[0]
        return road.elevation_m

    def attitude(self, time_ns: int) -> tuple[float, float] | None:
        """Return roll and pitch of a recent match."""
        matched = self._attitude
        if matched is None or not 0 <= time_ns - matched[0] <= _ATTITUDE_VALID_NS:
            return None
        return matched[1:]
