"""Heights of the road beside where a vehicle went: local regressions over its track, on one level at a time.

At a place, heights are fitted by h = a + b u + c v, u along the track there and v across it, points weighted by their
distance. Along, the points say the slope; across, a single pass says nothing, so crossfall is taken for zero with a
standard deviation, unless passes beside one another say it. Source of the method: weighted local linear regression
(Cleveland & Devlin 1988) with a Gaussian prior on the slopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CROSSFALL_SIGMA = 0.02
"""Roads fall 1.5 to 3 % to one side or to both."""
_GRADE_SIGMA = 0.15  # chosen: steeper than nearly all roads, so that the positions decide
_AT_ONCE = 512  # chosen: places per batch, bounds memory
_TINY = 1e-12  # chosen: avoids division by zero


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackHeights:
    """Points (n, 2) in a plane, road heights and σ (n,) under them.

    `reach_m`: how far from the last point along the track the road is still known; the regression's points lie mostly
    within it. `apart_m`: points whose height differs by more from what is expected are of another level.
    """

    plane_m: Floats
    height_m: Floats
    sigma_m: Floats
    reach_m: float
    half_width_m: float
    apart_m: float = 2.0

    def at(self, places_m: Floats, about_m: Floats) -> tuple[Floats, Floats]:
        """Heights and σ (m,) at places (m, 2) of the level that is near `about_m` (m,); NaN where no track is near."""
        height_m, sigma_m = np.full(len(places_m), np.nan), np.full(len(places_m), np.nan)
        reach = 3.0 * self.reach_m + self.half_width_m
        for begin in range(0, len(places_m), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            batch_m = places_m[part]
            near = (
                (self.plane_m >= batch_m.min(axis=0) - reach) & (self.plane_m <= batch_m.max(axis=0) + reach)
            ).all(axis=1)
            if near.any():
                height_m[part], sigma_m[part] = self._fitted(batch_m, about_m[part], np.flatnonzero(near))
        return height_m, sigma_m

    def _fitted(self, places_m: Floats, about_m: Floats, near: NDArray[np.int64]) -> tuple[Floats, Floats]:
        off = self.plane_m[near] - places_m[:, None, :]
        z, sigma = self.height_m[near] - about_m[:, None], self.sigma_m[near]
        same_level = np.abs(z) <= self.apart_m
        distance2 = np.sum(off**2, axis=2)
        kernel = np.where(same_level, np.exp(-0.5 * distance2 / self._kernel_m() ** 2), 0.0)
        along = _direction(off, kernel)
        u = off[..., 0] * along[:, None, 0] + off[..., 1] * along[:, None, 1]
        v = off[..., 1] * along[:, None, 0] - off[..., 0] * along[:, None, 1]
        close = same_level & (np.abs(u) <= self.reach_m) & (np.abs(v) <= self.half_width_m + 0.5)
        known = close.any(axis=1)
        # Of many points on one spot, as of a vehicle that stands, each says the same again.
        weight = kernel / sigma**2
        columns = np.stack((np.ones_like(u), u, v), axis=2)
        normal = np.einsum("nm,nmi,nmj->nij", weight, columns, columns)
        normal += np.diag([_TINY, _GRADE_SIGMA**-2, CROSSFALL_SIGMA**-2])
        right = np.einsum("nm,nmi,nm->ni", weight, columns, np.where(same_level, z, 0.0))
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        left_m = np.where(same_level, z - np.einsum("nmi,ni->nm", columns, solved), 0.0)
        total = np.maximum(kernel.sum(axis=1), _TINY)
        scatter2 = np.sum(kernel * left_m**2, axis=1) / total
        own2 = np.sum(kernel * np.where(same_level, sigma, 0.0) ** 2, axis=1) / total
        mean_v = np.sum(kernel * v, axis=1) / total
        spread2 = np.maximum(np.sum(kernel * (v - mean_v[:, None]) ** 2, axis=1) / total, 0.0)
        # Errors of positions last for seconds: one pass is one measurement, however many points it has.
        crossfall2 = own2 * CROSSFALL_SIGMA**2 / (own2 + CROSSFALL_SIGMA**2 * spread2)
        variance = own2 + scatter2 + mean_v**2 * crossfall2
        nan = np.full(len(places_m), np.nan)
        return np.where(known, about_m + solved[:, 0], nan), np.where(known, np.sqrt(variance), nan)

    def _kernel_m(self) -> float:
        return 0.5 * self.reach_m


def _direction(off: Floats, kernel: Floats) -> Floats:
    """Unit vectors (n, 2) along which weighted points (n, m, 2) extend most."""
    total = np.maximum(kernel.sum(axis=1), _TINY)
    middle = np.einsum("nm,nmi->ni", kernel, off) / total[:, None]
    about = off - middle[:, None, :]
    xx, xy, yy = (np.sum(kernel * about[..., i] * about[..., j], axis=1) for i, j in ((0, 0), (0, 1), (1, 1)))
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return np.column_stack((np.cos(angle), np.sin(angle)))
