"""Other estimates of one epoch, from other choices of satellites: a second opinion for the judge.

Every choice is tried and every one that passes the tests is told, with how many others agree with it and how many
were tried: nothing here knows a height of road or map, so agreement is no proof of height and height none of agreement.
The epoch's rows are used as they are: geometry is made once. Of other epochs enters what the epoch itself had, the
float position that its codes and Doppler have carried on, where the engine uses it; it has seen no integers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Literal

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers, satellite_name
from camber.gnss.ambiguity.fixed_solution import Limits, estimate
from camber.gnss.ambiguity.resolution import RESOLVED
from camber.gnss.observations.signal_pairs import systems_of
from camber.gnss.observations.single_differences import Booleans, Rows
from camber.gnss.position.differenced_epoch import NO_PRIOR, Prior
from camber.gnss.position.float_solution import float_position

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
"""In turn: the number of trials is limited, and what one strategy leaves out first is what it suspects most."""
IDENTICAL_M = 1.0e-9
"""Where a satellite that is left out had been rejected anyway, the position is the very same: no second opinion."""
_AGREEMENT_M = 0.05
_LEAST_SATELLITES = 4
_LEAST_SUCCESS = 0.5
"""Less than a fix by itself needs: agreement is asked for beside it, and each estimate tells its own."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherEstimate:
    """A position (3,) in ECEF with covariance (3, 3) from all satellites but those excluded.

    `agreeing` counts the other trials that led to the same position from other measurements.
    """

    position_ecef_m: Floats
    covariance_ecef_m2: Floats
    excluded: tuple[str, ...]
    ambiguities: int
    fixed: int
    ratio: float
    success_rate: float
    agreeing: int


def other_estimates(
    rows: Rows,
    approximate_ecef_m: Floats,
    limits: Limits,
    strategy: Strategy,
    excluded: Sequence[str],
    most_trials: int,
    prior: Prior = NO_PRIOR,
) -> tuple[int, list[OtherEstimate]]:
    """How many choices were tried, and all estimates that passed, in the order of trial.

    `excluded` satellites are left out of every choice; with `explicit` that is the only one.
    """
    satellites, place = np.unique(rows.satellite, return_inverse=True)
    names = [satellite_name(int(number)) for number in satellites]
    given = np.array([name not in excluded for name in names], np.bool_)
    choices = _choices(rows, satellites, place, given, strategy, max(most_trials, 0))
    if not choices:
        return 0, []
    masks = np.array(choices)[:, place]
    trial = limits._replace(least_success=min(limits.least_success, _LEAST_SUCCESS))
    prior_m = prior.position_ecef_m - approximate_ecef_m if prior.information.any() else np.zeros(3)
    status, dx, covariance, counts, quality = _estimates(
        rows, masks, prior_m, np.ascontiguousarray(prior.information), trial
    )
    passed = np.flatnonzero(status == RESOLVED)
    apart = np.linalg.norm(dx[passed, None] - dx[None, passed], axis=2)
    agreeing = ((apart > IDENTICAL_M) & (apart < _AGREEMENT_M)).sum(axis=1)
    found = [
        OtherEstimate(
            approximate_ecef_m + dx[t],
            covariance[t],
            tuple(name for name, used in zip(names, choices[t], strict=True) if not used),
            int(counts[t, 0]),
            int(counts[t, 1]),
            float(quality[t, 0]),
            float(quality[t, 1]),
            int(agree),
        )
        for t, agree in zip(passed.tolist(), agreeing.tolist(), strict=True)
    ]
    return len(choices), found


def _choices(
    rows: Rows, satellites: Integers, place: Integers, given: Booleans, strategy: Strategy, most: int
) -> list[Booleans]:
    """Satellites (m,) of each trial, `most` at most; none twice, none with fewer than a position needs.

    Of several strategies each says its best choice in turn.
    """
    if strategy == "explicit":
        return [given][:most] if given.sum() >= _LEAST_SATELLITES else []
    parts = _ALL if strategy == "all" else (strategy,)
    orders = [_left_out(rows, satellites, place, given, part) for part in parts]
    choices: dict[bytes, Booleans] = {}
    for left_out in (one for turn in zip_longest(*orders) for one in turn if one is not None):
        if len(choices) >= most:
            break
        choice = given & ~left_out
        if choice.sum() >= _LEAST_SATELLITES:
            choices.setdefault(choice.tobytes(), choice)
    return list(choices.values())


def _left_out(
    rows: Rows, satellites: Integers, place: Integers, given: Booleans, strategy: Strategy
) -> Booleans:
    """What each choice (k, m) of one strategy leaves out, the most promising first."""
    m = satellites.size
    if strategy == "leave_one_system_out":
        systems = np.zeros(m, np.int64)
        systems[place] = systems_of(rows.group)
        of_system: Booleans = np.unique(systems[given])[:, None] == systems
        return of_system
    merit = np.full(m, np.inf)
    if strategy in ("by_residual", "leave_one_out"):
        np.minimum.at(merit, place, -_normalised_residuals(rows, given[place]))
    else:
        np.minimum.at(merit, place, rows.cn0_dbhz if strategy == "by_cn0" else rows.elevation_rad)
    worst_first = np.argsort(merit, kind="stable")
    worst_first = worst_first[given[worst_first]]
    alone: Booleans = worst_first[:, None] == np.arange(m)
    return alone if strategy == "leave_one_out" else np.logical_or.accumulate(alone, axis=0)[:-1]


def _normalised_residuals(rows: Rows, usable: Booleans) -> Floats:
    """How far each code (n,) is from the position of all, in its own standard deviations; 0 where it is not used."""
    found = float_position(rows, usable, np.zeros(3), np.zeros((3, 3)), 3.5)
    left = np.where(usable, rows.code_m - rows.direction @ found.dx_m, np.nan)
    for group in np.unique(rows.group):
        of_group = rows.group == group
        if found.used[of_group].any():
            left[of_group] -= np.nanmedian(left[of_group & found.used])
    return np.nan_to_num(np.abs(left) / np.sqrt(rows.code_variance_m2))


@compiled
def _estimates(
    rows: Rows, masks: Booleans, prior_m: Floats, prior_information: Floats, limits: Limits
) -> tuple[Integers, Floats, Floats, Integers, Floats]:
    """Of each mask (t, n): status (t,), correction (t, 3), covariance (t, 3, 3), ambiguities and fixed (t, 2), ratio
    and success rate (t, 2)."""
    t = masks.shape[0]
    status, dx, covariance = np.empty(t, np.int64), np.empty((t, 3)), np.empty((t, 3, 3))
    counts, quality = np.empty((t, 2), np.int64), np.empty((t, 2))
    for k in range(t):
        found = estimate(rows, masks[k], prior_m, prior_information, limits)
        status[k], dx[k], covariance[k] = found.status, found.dx_m, found.covariance_m2
        counts[k, 0], counts[k, 1] = found.ambiguities, found.fixed
        quality[k, 0], quality[k, 1] = found.ratio, found.success_rate
    return status, dx, covariance, counts, quality
