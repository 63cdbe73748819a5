"""Re-estimation of one epoch from satellite subsets: further candidate fixes for the judge.

Source: JP7707657B2, fifth embodiment. Every subset is tried, and every one that passes the tests is reported, with the
number of others that agree with it and the number of trials. No height of road or map is used, so agreement is
independent of height. The single differences of the epoch are reused. Of other epochs only the epoch's Doppler prior
is used, which depends on no integers. Satellites of GLONASS, which have none, are in every subset unless `excluded`:
without one of them the integers are the same, and the agreement of the positions is no evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Literal

import numpy as np

from camber.formats.observations import Floats, Integers, satellite_name
from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED, FixCriteria
from camber.gnss.ambiguity.fixed_solution import estimate
from camber.gnss.observations.differenced_observations import SingleDifferences
from camber.gnss.observations.signal_pairs import SYSTEMS, Booleans, systems_of
from camber.gnss.position.float_solution import NO_PRIOR, float_position, relative_to
from camber.gnss.position.rtk_engine import Solution

Strategy = Literal[
    "leave_one_out", "leave_one_system_out", "by_cn0", "by_elevation", "by_residual", "explicit", "all"
]
_ALL: tuple[Strategy, ...] = (
    "by_residual",
    "by_cn0",
    "by_elevation",
    "leave_one_system_out",
    "leave_one_out",
)
"""Strategies in the order of trial: the number of trials is limited, and each strategy begins with its most suspect."""
IDENTICAL_M = 1.0e-9
"""Below it two positions come from the same measurements: the excluded satellite had been rejected anyway."""
_AGREEMENT_M = 0.05  # chosen: 3 σ of the difference of two fixes with the same integers
_LEAST_SATELLITES = 4  # a position and a clock
_LEAST_SUCCESS_RATE = 0.5
"""Chosen below that of a fix: agreement is required in addition, and each candidate reports its success rate."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SubsetCandidate:
    """A position (3,) in ECEF with covariance (3, 3) from all satellites but those excluded.

    `agreeing`: number of other trials with the same position from other measurements.
    """

    position_ecef_m: Floats
    covariance_ecef_m2: Floats
    excluded: tuple[str, ...]
    ambiguities: int
    fixed: int
    ratio: float
    success_rate: float
    agreeing: int


def subset_candidates(
    solution: Solution,
    criteria: FixCriteria,
    strategy: Strategy,
    excluded: Sequence[str] = (),
    *,
    most_trials: int,
) -> tuple[int, list[SubsetCandidate]]:
    """Number of trials, and all candidates of a differenced epoch that passed, in the order of trial.

    `excluded` satellites are left out of every subset; with `explicit` that is the only one.
    """
    rows, approximate_ecef_m = solution.rows, solution.approximate_ecef_m
    if rows is None or approximate_ecef_m is None:
        return 0, []
    numbers, place = np.unique(rows.satellite, return_inverse=True)
    names = [satellite_name(int(number)) for number in numbers]
    given = np.array([name not in excluded for name in names], np.bool_)
    subsets = _subsets(rows, place, given, strategy, most=max(most_trials, 0))
    if not subsets:
        return 0, []
    trial = criteria._replace(least_success_rate=min(criteria.least_success_rate, _LEAST_SUCCESS_RATE))
    prior = relative_to(solution.prior, approximate_ecef_m)
    trials = [(subset, estimate(rows, subset[place], prior, trial)) for subset in subsets]
    passed = [(subset, result) for subset, result in trials if result.status == RESOLVED]
    dx = np.array([result.dx_m for _, result in passed]).reshape(-1, 3)
    apart = np.linalg.norm(dx[:, None] - dx[None], axis=2)
    agreeing = ((apart > IDENTICAL_M) & (apart < _AGREEMENT_M)).sum(axis=1)
    candidates = [
        SubsetCandidate(
            position_ecef_m=approximate_ecef_m + result.dx_m,
            covariance_ecef_m2=result.covariance_m2,
            excluded=tuple(name for name, used in zip(names, subset, strict=True) if not used),
            ambiguities=result.ambiguities,
            fixed=result.fixed,
            ratio=result.ratio,
            success_rate=result.success_rate,
            agreeing=int(agree),
        )
        for (subset, result), agree in zip(passed, agreeing.tolist(), strict=True)
    ]
    return len(subsets), candidates


def _subsets(
    rows: SingleDifferences, place: Integers, given: Booleans, strategy: Strategy, most: int
) -> list[Booleans]:
    """Satellites (m,) of each trial, `most` at most; no repetitions, none with fewer than a position needs.

    Several strategies take turns. `place` (n,) is the index of each row's satellite; only the `given` (m,) are tried.
    """
    if strategy == "explicit":
        return [given][:most] if given.sum() >= _LEAST_SATELLITES else []
    parts = _ALL if strategy == "all" else (strategy,)
    systems = np.zeros(given.size, np.int64)
    systems[place] = systems_of(rows.group)
    in_turn = given & (systems != SYSTEMS.index("R"))
    orders = [
        _left_out(rows, place, given, in_turn=in_turn, systems=systems, strategy=part) for part in parts
    ]
    subsets: dict[bytes, Booleans] = {}
    for left_out in (one for turn in zip_longest(*orders) for one in turn if one is not None):
        if len(subsets) >= most:
            break
        subset = given & ~left_out
        if (subset & in_turn).sum() >= _LEAST_SATELLITES:
            subsets.setdefault(subset.tobytes(), subset)
    return list(subsets.values())


def _left_out(
    rows: SingleDifferences,
    place: Integers,
    given: Booleans,
    in_turn: Booleans,
    systems: Integers,
    strategy: Strategy,
) -> Booleans:
    """Satellites left out by each trial (k, m) of one strategy, the most suspect first; only those `in_turn` (m,)."""
    m = given.size
    if strategy == "leave_one_system_out":
        of_system: Booleans = np.unique(systems[in_turn])[:, None] == systems
        return of_system
    merit = np.full(m, np.inf)
    if strategy in ("by_residual", "leave_one_out"):
        np.minimum.at(merit, place, -_normalised_residuals(rows, given[place]))
    else:
        np.minimum.at(merit, place, rows.cn0_dbhz if strategy == "by_cn0" else rows.elevation_rad)
    worst_first = np.argsort(merit, kind="stable")
    worst_first = worst_first[in_turn[worst_first]]
    alone: Booleans = worst_first[:, None] == np.arange(m)
    return alone if strategy == "leave_one_out" else np.logical_or.accumulate(alone, axis=0)[:-1]


def _normalised_residuals(rows: SingleDifferences, usable: Booleans) -> Floats:
    """Absolute residual of each code (n,) from the position of all, over its σ; 0 where it is not used."""
    position = float_position(rows, usable, NO_PRIOR, 3.5)
    residual = np.where(usable, rows.code_m - rows.direction @ position.dx_m, np.nan)
    for group in np.unique(rows.group):
        of_group = rows.group == group
        if position.used[of_group].any():
            residual[of_group] -= np.nanmedian(residual[of_group & position.used])
    return np.nan_to_num(np.abs(residual) / np.sqrt(rows.code_variance_m2))
