"""Compile the fusion before the first observations arrive, by taking synthetic ones through to a decision.

The compiled code is cached on disk. `python -m camber.map_update.warm_up` fills the cache ahead, for an image.
"""

from __future__ import annotations

import numpy as np

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.contribution import OBSERVATION, QUALITIES
from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.publication_decision import Decisions
from camber.map_update.fusion.votes import merge_votes
from camber.road_map.road_columns import flat_road

FUNCTIONS = 15
"""Compiled functions that the warm-up calls from Python."""

# Any valid time and place.
_TIME_NS = 1_400_000_000 * 10**9
_LATITUDE_RAD = 0.6
_LONGITUDE_RAD = 2.4


def warm_up() -> Decisions:
    """Fuse two vehicles on two days over two surfaces, twice each; returns the decisions."""
    surfaces = flat_road(_LATITUDE_RAD, [_LONGITUDE_RAD, _LONGITUDE_RAD + 4e-6], seen_ns=_TIME_NS)
    rows = np.zeros(4, OBSERVATION)
    rows["time_ns"] = _TIME_NS + NS_PER_DAY * np.array([0, 0, 1, 1])
    rows["fix_quality"] = QUALITIES.index("fixed")
    rows["surface_id"] = [1, 2, 1, 2]
    rows["latitude_rad"] = _LATITUDE_RAD
    rows["longitude_rad"] = surfaces.longitude_rad[[0, 1, 0, 1]]
    rows["horizontal_sigma_m"] = rows["road_height_sigma_m"] = 0.02
    rows["road_height_m"] = 50.0
    again = rows.copy()
    again["time_ns"] += 10**9
    rows = np.concatenate((rows, again))
    fusion = Fusion(surfaces, bytes(32))
    votes = merge_votes(*(fusion.votes_from(rows, fusion.voter_of(vehicle)) for vehicle in ("a", "b")))
    return fusion.decide(votes, np.zeros(0, np.int64), np.zeros(0), _TIME_NS + 2 * NS_PER_DAY)


if __name__ == "__main__":
    warm_up()
