"""Errors of a fix's height less antenna and the map's elevation at the true place: common offset, map, fix.

    height − antenna − elevation = b + m + f + white

| part | process | from |
|---|---|---|
| b | constant, with a random walk in time | antenna, base station, datum, tyres, troposphere, survey |
| c t | constant rate c, after a step of the fixes alone | wrong integers: their error moves with the satellites |
| m | in two scales of the distance (`road_map.map_error_model`) | survey; what the road has moved since |
| f | Gauss–Markov in time | multipath of the phases |
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from camber.localizer.arrays import Floats
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightErrorModel:
    """Standard deviations and correlations of the parts; the map's σ comes with each elevation."""

    map_errors: MapErrorModel = field(default_factory=lambda: MAP_ERRORS)
    offset_sigma_m: float = 30.0  # chosen: base, datum or antenna off by metres; only changes of height count
    offset_walk_m_sqrt_s: float = 4e-4  # chosen: 1 cm in 10 min, residual troposphere between base and rover
    stepped_rate_m_s: float = (
        4e-3  # rms of 2,213 wrong fixes of `wrong_fix_shapes` (median 0.5 mm/s, 95 % 6.5 mm/s)
    )
    fix_common_sigma_m: float = 0.015  # docs/theory/integrity.md: multipath of the phase, at least
    fix_common_share: float = 2.4  # of the white noise; `support.height_claims`, Nagoya: 2.1 to 2.6
    fix_common_time_s: float = 30.0  # chosen: reflections change within metres, and last at a standstill

    def fix_common_m(self, fix_sigma_m: Floats | float) -> Floats:
        """Return σ of f by that of the white noise, `fix_sigma_m`, a number or (n,): in streets both are larger."""
        common_m = self.fix_common_share * np.asarray(fix_sigma_m, np.float64)
        return np.asarray(np.maximum(self.fix_common_sigma_m, common_m), np.float64)

    def covariance(
        self,
        places: Floats,
        time_s: Floats,
        *,
        map_sigma_m: Floats,
        fix_sigma_m: Floats,
        white_sigma_m: float | None = None,
        stepped: bool = False,
    ) -> Floats:
        """Return the covariance (n, n) in m² of n observations, without the offset's initial variance.

        `places` (n, 2): east and north in m; a road driven twice has the same error twice. `fix_sigma_m` (n,): of the
        white noise, and `white_sigma_m` what was measured of it, if it was. `stepped`: the fixes have stepped before.
        """
        since_s = time_s - time_s.min()
        walk = self.offset_walk_m_sqrt_s**2 * np.minimum.outer(since_s, since_s)
        if stepped:
            walk += self.stepped_rate_m_s**2 * np.outer(since_s, since_s)
        apart_s = np.abs(np.subtract.outer(time_s, time_s))
        common_m = self.fix_common_m(
            fix_sigma_m if white_sigma_m is None else np.full_like(time_s, white_sigma_m)
        )
        fix = np.outer(common_m, common_m) * np.exp(-apart_s / self.fix_common_time_s)
        alike = self.map_errors.covariance_m2(places, map_sigma_m)
        return np.asarray(alike + walk + fix + np.diag(fix_sigma_m**2), np.float64)
