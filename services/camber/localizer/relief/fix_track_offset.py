"""Offset of the fixes against the map from their heights alone, over the way that they have shown: a window estimate.

The track is that of the fixes themselves, centimetres in shape, so that no error of odometry is in it: what shifts the
whole track is a base station or a datum. Fixes that are led away have a track that is off by a growing vector; so
growth is estimated beside the offset. A run of wrong fixes contradicts the heights of all others and is rejected.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.road_ribbon import RibbonPlane, RoadRibbon
from camber.localizer.relief.terrain_contour_matching import HeightWindow, ShiftEstimate, estimate_shift
from camber.localizer.relief.white_noise import LEAST_WHITE_SIGMA_M, white_sigma_m

_PRIOR_SIGMA_M: Final = 8.0  # chosen: larger vectors show against the independent position
_PRIOR_GROWTH_M_S: Final = 0.2  # chosen: what grows faster leaves the path of odometry within 20 s
_MAX_PRIOR_SHARE: Final = 0.02  # chosen: a base 12 m off moves the result by 0.24 m, a fifth of its σ
_SPACING_M: Final = 10.0  # as a start's: within it the map's errors are the same
_WINDOW_M: Final = 1500.0  # issue: a base 1.7 m off is named within it
_LEAST_M: Final = 1000.0  # docs/theory/relief.md: ellipses of shorter windows are too small
_LEAST_COUNT: Final = 15  # as a start's
_GAP_M: Final = 40.0  # chosen: a fix a second at 40 m/s; a longer gap has no heights
_KNOWN_SHARE: Final = 0.7  # chosen: of the way, as the windows of docs/theory/relief.md
_PLANES_M: Final = 2.0  # chosen: errors of a slope are millimetres over half of it
_EVERY_M: Final = 100.0  # chosen: a tenth of the shortest window is new
_NO_SHIFT: Final[Floats] = np.zeros(2)
_SHIFTED_CHI2: Final = 9.21  # chi-square, 2 degrees of freedom, 99 %
_FITS_CHI2: Final = 1.5  # chosen: of residuals; another place may fit better


class TrackHeight(NamedTuple):
    """A fix on the way driven: time (s), path (m), its place (m), the road's height by it and σ of the map's (m)."""

    time_s: float
    path_m: float
    east_m: float
    north_m: float
    height_m: float
    map_sigma_m: float


class FixTrackOffset(NamedTuple):
    """Fix less true place over a window, east and north (m), and its growth (m/s), each with covariance (2, 2).

    `begin_s`, `end_s`: of the window.
    """

    offset_m: Floats
    covariance_m2: Floats
    growth_m_s: Floats
    growth_covariance: Floats
    begin_s: float
    end_s: float


class FixTrackOffsets:
    """Collects fixes and roads along the way, in one plane."""

    def __init__(self, model: HeightErrorModel) -> None:
        self._model = model
        self._heights: deque[TrackHeight] = deque()
        self._planes: deque[RibbonPlane] = deque(maxlen=round(2.0 * _WINDOW_M / _PLANES_M))
        self._tried_at_m = -np.inf
        self._stepped = False

    def forget(self) -> None:
        """Forget what was collected: the plane is another one."""
        self.forget_fixes()
        self._planes.clear()

    def forget_fixes(self, *, stepped: bool = False) -> None:
        """Forget the fixes: the next ones are off by another vector where they have stepped."""
        self._stepped |= stepped
        self._heights.clear()

    def add_road(self, plane: RibbonPlane) -> None:
        """Add the road below the pose's antenna, each few metres."""
        if not self._planes or math.dist(self._planes[-1][:2], plane[:2]) >= _PLANES_M:
            self._planes.append(plane)

    def add(self, fix: TrackHeight) -> bool:
        """Take a fix; return whether it is time for `estimate`."""
        heights = self._heights
        since_m = fix.path_m - heights[-1].path_m if heights else math.inf
        if since_m < 0.0:
            self.forget()
        elif since_m < _SPACING_M:
            return False
        heights.append(fix)
        while heights and fix.path_m - heights[0].path_m > _WINDOW_M:
            heights.popleft()
        if len(heights) < _LEAST_COUNT or fix.path_m - self._tried_at_m < _EVERY_M:
            return False
        driven_m = heights[-1].path_m - heights[0].path_m
        if not self._planes:
            return False
        return driven_m >= _LEAST_M and self._known_m() >= _KNOWN_SHARE * driven_m

    def _known_m(self) -> float:
        """Return the way on which heights follow one another."""
        gaps_m = np.diff([height.path_m for height in self._heights])
        return float(gaps_m[gaps_m <= _GAP_M].sum())

    def estimate(self) -> FixTrackOffset | None:
        """Return the offset over the window, where the heights determine it."""
        self._tried_at_m = self._heights[-1].path_m
        ribbon = RoadRibbon(list(self._planes))
        window = _window(self._heights, ribbon, self._model)
        constant = self._solve(window, ribbon, (_NO_SHIFT,))
        if constant is None or not _fits_unshifted(constant):
            constant = self._solve(window, ribbon)
        if constant is None:
            return None
        growing = self._solve(window, ribbon, (constant.shift,), growing=True)
        if growing is None:
            return None
        return FixTrackOffset(
            offset_m=-constant.shift,
            covariance_m2=constant.covariance,
            growth_m_s=-growing.shift[2:],
            growth_covariance=growing.covariance[2:, 2:],
            begin_s=float(window.time_s[0]),
            end_s=float(window.time_s[-1]),
        )

    def _solve(
        self,
        window: HeightWindow,
        ribbon: RoadRibbon,
        starts: Sequence[Floats] | None = None,
        *,
        growing: bool = False,
    ) -> ShiftEstimate | None:
        prior = np.full(4 if growing else 2, _PRIOR_SIGMA_M**2)
        prior[2:] = _PRIOR_GROWTH_M_S**2
        since = window.time_s - window.time_s.mean()
        result = estimate_shift(
            window,
            ribbon.at,
            self._model,
            prior=np.diag(prior),
            modes=since[:, None, None] * np.eye(2) if growing else None,
            max_prior_share=_MAX_PRIOR_SHARE,
            starts=starts,
            stepped=self._stepped,
        )
        if result is None or not result.unique or result.prior_share > _MAX_PRIOR_SHARE:
            return None
        return result


def _fits_unshifted(estimate: ShiftEstimate) -> bool:
    """Whether the heights fit near no shift, so that no other place has to be looked for."""
    chi2 = float(estimate.shift @ np.linalg.solve(estimate.covariance, estimate.shift))
    return chi2 < _SHIFTED_CHI2 and estimate.chi2 < _FITS_CHI2 * estimate.count


def _window(heights: Sequence[TrackHeight], ribbon: RoadRibbon, model: HeightErrorModel) -> HeightWindow:
    table = np.array(heights)
    residual = table[:, 4] - ribbon.at(table[:, 2], table[:, 3]).elevation_m
    white_m = white_sigma_m(residual, table[:, 2:4], table[:, 5], model)
    return HeightWindow(
        time_s=table[:, 0],
        east_m=table[:, 2],
        north_m=table[:, 3],
        height_m=table[:, 4],
        sigma_m=np.full(len(table), LEAST_WHITE_SIGMA_M if white_m is None else white_m),
        map_sigma_m=table[:, 5],
    )
