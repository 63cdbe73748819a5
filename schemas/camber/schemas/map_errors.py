"""Parameters of the map's height errors, as measured: defaults of `camber.road_map.map_error_model` and of manifests.

Source: two drives of one road a month apart, docs/theory/map-errors.md.
"""

from __future__ import annotations

SHORT_SHARE = 0.07
"""Measured: share of the short part in the variance along the road."""
SHORT_M = 40.0
"""Measured: correlation length of the short part (first-order Gauss–Markov), metres."""
LONG_M = 100.0
"""Measured: correlation length of the long part (second-order Gauss–Markov), metres; correlation 0.4 at 200 m."""
COMMON_OFFSET_SIGMA_M = 0.04
"""Measured: σ of what all heights of a survey have in common, metres; one pair of surveys differs by −0.039 m."""
