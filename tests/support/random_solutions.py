"""Random but valid solutions of receivers, for the writers and readers of positions."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from support.random_observations import WEEK_NS

VELOCITIES = st.tuples(*[st.floats(-60.0, 60.0)] * 3)
DIAGONAL_COVARIANCES = st.tuples(
    *(st.floats(1e-4, 100.0) if k in (0, 3, 5) else st.just(0.0) for k in range(6))
)


def solutions(**fields: st.SearchStrategy[Any]) -> st.SearchStrategy[ReceiverSolution]:
    """Solutions from 2001 to 2054; `fields` replace those of this table."""
    table: dict[str, st.SearchStrategy[Any]] = {
        "time_ns": st.integers(1100 * WEEK_NS, 3900 * WEEK_NS),
        "latitude_rad": st.floats(-math.pi / 2, math.pi / 2),
        "longitude_rad": st.floats(-math.pi, math.pi),
        "height_m": st.floats(-500.0, 9000.0),
        "quality": st.sampled_from(SolutionQuality),
        "satellites": st.none() | st.integers(0, 60),
        "covariance_enu_m2": st.none() | DIAGONAL_COVARIANCES,
        "age_s": st.none() | st.floats(0.0, 200.0),
        "velocity_enu_m_s": st.none() | VELOCITIES,
    }
    return st.builds(ReceiverSolution, **(table | fields))


def qualities_without(*missing: SolutionQuality) -> st.SearchStrategy[SolutionQuality]:
    """Qualities, but for those that a format does not distinguish from others."""
    return st.sampled_from(sorted({*SolutionQuality} - {*missing}))
