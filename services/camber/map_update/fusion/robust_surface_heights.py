"""Robust height of each surface from its votes: Tukey's biweight with its standard error, for all surfaces at once.

Location: the M-estimate of ψ(u) = u (1 − u²)² for |u| < 1, u = (x − T) / (c s), with c = 4.685 for 95 % of the mean's
efficiency under normal errors (Beaton & Tukey 1974, "The fitting of power series, meaning polynomials, illustrated on
band-spectroscopic data"; Huber & Ronchetti 2009, "Robust Statistics", 4.8, 6.3). It redescends: values more than c s
away have no weight. Iteration starts from the median, which selects the root that most votes support.

Each vehicle counts once: its votes of several days are first reduced to their median.

Few votes hardly determine scale and standard error, so each is pooled with the spread of a vote over all surfaces,
weighted as PRIOR_VOTES votes (moderated variance: Smyth 2004, "Linear models and empirical Bayes methods", eq. 3).
The surface's own scale is 1.4826 × the median absolute deviation; its own standard error is that of the sandwich
estimator (Huber & Ronchetti, 6.6), times n / (n − 1). The degrees of freedom carry the remaining uncertainty.

**Change of the road**: of all days the one before and after which the votes differ most, if the difference is
significant; votes before it are of a road that no longer exists. The search repeats on the remaining votes (binary
segmentation).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.votes import Floats, Integers

TUNING = 4.685
"""c of the biweight: 95 % efficiency under normal errors (Beaton & Tukey 1974)."""
EFFICIENCY = 0.95
"""Efficiency of the biweight with this c, relative to the mean."""
MAD_TO_SIGMA = 1.4826
"""σ over the median absolute deviation of normal errors: 1 / Φ⁻¹(0.75)."""
PRIOR_VOTES = 10.0
"""Chosen: degrees of freedom of the prior spread, about those at which a scale is known to a quarter."""
_MAD_EFFICIENCY = 0.37  # of the median absolute deviation under normal errors (Huber & Ronchetti 2009, 5.1)
_ITERATIONS = 30  # chosen: the loop ends at steps below 1 µm, in general after about ten
_LEAST_WEIGHT = 1e-3
"""Chosen: a vote of less weight is ignored; it neither counts nor agrees nor disagrees."""
_ROUNDING = 1e-9  # of a share times a count, before it is rounded up

# Detection of a changed road. Chosen on the fleet scenario, seeds 1, 2 and 4 (docs/fusion.md).
_CHANGE_VOTERS = 5
"""Least voters on each side of a change; after it, in addition to the possible liars."""
_CHANGE_Z = 5.0
"""Difference over its standard error; over sixty days of each surface about 10⁻⁵ false changes."""
_CHANGE_M = 0.02
"""A smaller difference is no change of the road."""
_COALITION = 0.2
"""This share of a surface's vehicles alone must not bring about a change ..."""
_COALITION_DAYS = 21
"""... counted over this many days, or a coalition arriving on one quiet day would be the majority."""


class VoteColumns(NamedTuple):
    """Votes (n,), sorted by surface and within one by voter.

    `weight` is relative: a vote of weight 1 has the spread of a vote, one of weight w that spread over √w.
    """

    voter: Integers
    session: Integers
    value_m: Floats
    weight: Floats


class Location(NamedTuple):
    """Biweight location of a group of values, NaN for an empty one."""

    location_m: float
    standard_error_m: float
    degrees: float
    """Degrees of freedom of the standard error."""
    scale_m: float


class FusedHeights(NamedTuple):
    """For each surface (n,): location of its votes and its uncertainty; NaN without votes."""

    location_m: Floats
    standard_error_m: Floats
    degrees: Floats
    """Degrees of freedom of the standard error."""
    voters: Integers
    """Vehicles with a weight."""
    known_voters: Integers
    """Of them those whose bias is known from other streets."""
    votes: Integers
    days: Integers
    """Different sessions among the votes."""
    agreement: Floats
    """Share of the voters within three spreads of the location."""
    first_session: Integers
    """First session whose votes are of the present road; −1 without votes."""
    last_session: Integers
    without_highest_m: Floats
    """Location without the highest voters, as many as a coalition has: it cannot raise it. NaN if none remain."""
    without_lowest_m: Floats
    """Location without the lowest voters, which a coalition cannot lower."""


_COUNTS = {"voters": 0, "known_voters": 0, "votes": 0, "days": 0, "first_session": -1, "last_session": -1}
"""The integers of FusedHeights, and their values without votes."""


def estimate_heights(
    begins: Integers, votes: VoteColumns, *, known: NDArray[np.bool_], vote_sigma_m: float
) -> FusedHeights:
    """Return the heights of surfaces; votes of surface i are rows `begins[i]` to `begins[i + 1]`.

    `known` (n,): the voter's bias is known from other streets. `vote_sigma_m`: spread of a vote of weight 1.
    """
    heights = FusedHeights(
        *(np.full(len(begins) - 1, _COUNTS.get(name, np.nan)) for name in FusedHeights._fields)
    )
    _fill_heights(begins, votes, known, vote_sigma_m, heights=heights)
    return heights


@compiled_without_gil
def biweight_location(x: Floats, w: Floats, sigma_m: float) -> Location:
    """Return the biweight location of values (n,) with weights (n,), all above zero."""
    n = len(x)
    if n == 0:
        return Location(np.nan, np.nan, np.nan, np.nan)
    median = np.median(x)
    prior_share = PRIOR_VOTES / (PRIOR_VOTES + _MAD_EFFICIENCY * (n - 1))
    mad_m = MAD_TO_SIGMA * np.median(np.abs(x - median) * np.sqrt(w))
    scale_m = math.sqrt(prior_share * sigma_m**2 + (1.0 - prior_share) * mad_m**2)
    location_m = median
    cutoff_m = TUNING * scale_m
    for _ in range(_ITERATIONS):
        total, moment = 0.0, 0.0
        for k in range(n):
            u = (x[k] - location_m) * math.sqrt(w[k]) / cutoff_m
            if abs(u) < 1.0:
                robust = w[k] * (1.0 - u * u) ** 2
                total += robust
                moment += robust * (x[k] - location_m)
        if total == 0.0:
            break
        step = moment / total
        location_m += step
        if abs(step) < 1e-6:
            break
    slope, square, weight, weight_square = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        root = math.sqrt(w[k])
        u = (x[k] - location_m) * root / cutoff_m
        weight += w[k]
        weight_square += w[k] * w[k]
        if abs(u) < 1.0:
            rest = 1.0 - u * u
            slope += w[k] * rest * (1.0 - 5.0 * u * u)
            square += w[k] * (u * rest * rest * cutoff_m) ** 2
    effective = weight * weight / weight_square
    pooled = scale_m**2 / (EFFICIENCY * weight)
    if slope > 0.0 and effective > 1.0:
        sandwich = square / slope**2 * effective / (effective - 1.0)
        variance = (PRIOR_VOTES * pooled + (effective - 1.0) * sandwich) / (PRIOR_VOTES + effective - 1.0)
    elif slope > 0.0:
        variance = pooled
    else:
        variance = max(pooled, scale_m**2)
    return Location(location_m, math.sqrt(variance), PRIOR_VOTES + effective - 1.0, scale_m)


@compiled_without_gil
def _one_per_voter(votes: VoteColumns, from_day: int, to_day: int) -> tuple[Floats, Floats]:
    """Return value and weight of each voter, the median of its votes in sessions `from_day` to before `to_day`."""
    n = len(votes.voter)
    x, w, voter_values = np.empty(n), np.empty(n), np.empty(n)
    count, first = 0, 0
    while first < n:
        last, of_voter, weight = first, 0, 0.0
        while last < n and votes.voter[last] == votes.voter[first]:
            if from_day <= votes.session[last] < to_day and votes.weight[last] >= _LEAST_WEIGHT:
                voter_values[of_voter] = votes.value_m[last]
                weight += votes.weight[last]
                of_voter += 1
            last += 1
        if of_voter > 0:
            x[count] = voter_values[0] if of_voter == 1 else np.median(voter_values[:of_voter])
            w[count] = weight / of_voter
            count += 1
        first = last
    return x[:count], w[:count]


@compiled_without_gil
def _likeliest_change(
    votes: VoteColumns, sigma_m: float, from_day: int, end_day: int, least_before: int, least_after: int
) -> int:
    """Return the day before and after which the votes differ most; `from_day` if a side always has too few.

    Compares means of values clipped about the median, from sums per day.
    """
    days = end_day - from_day
    count, sum_m = np.zeros(days), np.zeros(days)
    considered = (votes.session >= from_day) & (votes.weight >= _LEAST_WEIGHT)
    if np.count_nonzero(considered) < least_before + least_after:
        return from_day
    median_m, cutoff_m = np.median(votes.value_m[considered]), TUNING * sigma_m
    for k in range(len(votes.session)):
        if considered[k]:
            day = votes.session[k] - from_day
            count[day] += 1.0
            sum_m[day] += min(max(votes.value_m[k] - median_m, -cutoff_m), cutoff_m)
    total, total_m = count.sum(), sum_m.sum()
    best, best_square, before, before_m = from_day, 0.0, 0.0, 0.0
    for day in range(1, days):
        before += count[day - 1]
        before_m += sum_m[day - 1]
        after, after_m = total - before, total_m - before_m
        if before >= least_before and after >= least_after:
            square = (after_m / after - before_m / before) ** 2 / (1.0 / after + 1.0 / before)
            if square > best_square:
                best, best_square = from_day + day, square
    return best


@compiled_without_gil
def _day_of_change(votes: VoteColumns, sigma_m: float, from_day: int, end_day: int, liars: int) -> int:
    """Return the day after `from_day` on which the road changed significantly, or `from_day`.

    Significant also without the possible liars: those after the change whose votes support it most.
    """
    least_after = _CHANGE_VOTERS + liars
    day = _likeliest_change(
        votes, sigma_m, from_day, end_day, least_before=_CHANGE_VOTERS, least_after=least_after
    )
    if day == from_day:
        return from_day
    after, after_w = _one_per_voter(votes, day, end_day)
    before, before_w = _one_per_voter(votes, from_day, day)
    if len(after) < least_after or len(before) < _CHANGE_VOTERS:
        return from_day
    old = biweight_location(before, before_w, sigma_m)
    by_value = np.argsort(after)
    rest = by_value[: len(after) - liars] if np.median(after) > old.location_m else by_value[liars:]
    new = biweight_location(after[rest], after_w[rest], sigma_m)
    threshold_m = _CHANGE_Z * math.sqrt(new.standard_error_m**2 + old.standard_error_m**2)
    return day if abs(new.location_m - old.location_m) > max(threshold_m, _CHANGE_M) else from_day


@compiled_without_gil
def _fill_heights(
    begins: Integers, votes: VoteColumns, known: NDArray[np.bool_], sigma_m: float, heights: FusedHeights
) -> None:
    for i in range(len(begins) - 1):
        a, b = begins[i], begins[i + 1]
        if a == b:
            continue
        of_surface = VoteColumns(votes.voter[a:b], votes.session[a:b], votes.value_m[a:b], votes.weight[a:b])
        from_day, end_day = of_surface.session.min(), of_surface.session.max() + 1
        recent, _ = _one_per_voter(of_surface, end_day - _COALITION_DAYS, end_day)
        liars = math.ceil(_COALITION * len(recent) - _ROUNDING)
        while True:
            changed = _day_of_change(of_surface, sigma_m, from_day=from_day, end_day=end_day, liars=liars)
            if changed == from_day:
                break
            from_day = changed
        heights.first_session[i], heights.last_session[i] = from_day, end_day - 1
        x, w = _one_per_voter(of_surface, from_day, end_day)
        if len(x) == 0:
            continue
        result = biweight_location(x, w, sigma_m)
        heights.location_m[i], heights.standard_error_m[i] = result.location_m, result.standard_error_m
        heights.degrees[i] = result.degrees
        agree = np.count_nonzero(np.abs(x - result.location_m) * np.sqrt(w) <= 3.0 * sigma_m)
        heights.agreement[i] = agree / len(x)
        if from_day < end_day - _COALITION_DAYS:
            liars = math.ceil(_COALITION * len(x) - _ROUNDING)
        by_value, removed = np.argsort(x), min(liars, len(x))
        low, high = by_value[: len(x) - removed], by_value[removed:]
        heights.without_highest_m[i] = biweight_location(x[low], w[low], sigma_m).location_m
        heights.without_lowest_m[i] = biweight_location(x[high], w[high], sigma_m).location_m
        counted = (of_surface.session >= from_day) & (of_surface.weight >= _LEAST_WEIGHT)
        heights.voters[i], heights.votes[i] = len(x), np.count_nonzero(counted)
        heights.known_voters[i] = len(np.unique(of_surface.voter[counted & known[a:b]]))
        heights.days[i] = len(np.unique(of_surface.session[counted]))
