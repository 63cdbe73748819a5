"""Where the votes of a surface lie: Tukey's biweight with its standard error, for all surfaces at once.

Location: the M-estimate of ψ(u) = u (1 − u²)² within |u| < 1, u = (x − T) / (c s), c = 4.685, for 95 % of the mean's
efficiency where errors are normal (Beaton & Tukey 1974, "The fitting of power series, meaning polynomials,
illustrated on band-spectroscopic data"; Huber & Ronchetti 2009, "Robust Statistics", 4.8, 6.3). It redescends: who is
more than c s off has no say. It starts from the median, so that which of several roots is taken is the one of most.

A vehicle speaks once: its votes of several days are first made one, their median, so that who drives by daily is not
louder than who came once.

Scale and standard error are those of few votes, which are hardly known from them alone: each is pooled with what all
surfaces tell of a vote's spread, as that of `PRIOR_VOTES` votes (a moderated variance: Smyth 2004, "Linear models and
empirical Bayes methods", eq. 3). Own scale: 1.4826 × the median absolute deviation; own standard error: the
sandwich's (Huber & Ronchetti, 6.6), times n / (n − 1). What remains of "few" is in the degrees of freedom.

**When the road changed**: of all days, that before and after which the votes differ most, where that is beyond doubt;
then the votes before are of a road that is no more. Looked for again in what remains (binary segmentation).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.votes import Floats, Integers

TUNING = 4.685
EFFICIENCY = 0.95
PRIOR_VOTES = 10.0
_MAD = 1.4826
_MAD_EFFICIENCY = 0.37
_ROUNDS = 30
_NO_SAY = 1e-3
"""A vote of less weight than this has none: it neither counts nor agrees nor disagrees."""


class ChangeRule(NamedTuple):
    """When the votes from a day on are of another road than those before, and how many may be lying."""

    least_voters: int = 5
    """On either side; after the change, besides as many as might be lying."""
    least_z: float = 5.0
    """Difference in units of its standard error: of the sixty days of every surface, by chance 10⁻⁵."""
    least_m: float = 0.02
    coalition: float = 0.2
    """Nothing is to be brought about by this share of a surface's vehicles alone ..."""
    coalition_days: int = 21
    """... of those seen in the last so many days, or a coalition that comes on one quiet day is the majority."""


class Heights(NamedTuple):
    """Of each surface (n,): location of its votes and how well it is known; NaN where nobody voted."""

    location_m: Floats
    standard_error_m: Floats
    degrees: Floats
    """Of freedom of the standard error."""
    scale_m: Floats
    """Spread of a vote."""
    voters: Integers
    """Vehicles with a say."""
    known_voters: Integers
    """Of them those whose bias is known from other streets."""
    votes: Integers
    days: Integers
    """Different sessions among the votes."""
    agreement: Floats
    """Share of the voters within three spreads of the location."""
    first_session: Integers
    """From which on the votes are of the road as it is; −1 where nobody voted."""
    last_session: Integers
    without_highest_m: Floats
    """The location without the highest voters, as many as a coalition has: it cannot lift it. NaN: none is left."""
    without_lowest_m: Floats
    """Likewise; none lowers it."""


def heights_of(
    begins: Integers,
    voter: Integers,
    session: Integers,
    value_m: Floats,
    weight: Floats,
    known: NDArray[np.bool_],
    vote_sigma_m: float,
    rule: ChangeRule,
) -> Heights:
    """Heights of surfaces; votes (n,) of surface i are rows `begins[i]` to `begins[i + 1]`, in order of voters.

    `weight` is relative: a vote of weight 1 has the spread `vote_sigma_m`, a vote of weight w that over √w.
    """
    integers, floats = _heights(begins, voter, session, value_m, weight, known, vote_sigma_m, *rule)
    location_m, error_m, degrees, scale_m, agreement, no_highest_m, no_lowest_m = np.ascontiguousarray(
        floats.T
    )
    voters, known_voters, votes, days, first, last = np.ascontiguousarray(integers.T)
    return Heights(
        location_m,
        error_m,
        degrees,
        scale_m,
        voters,
        known_voters,
        votes,
        days,
        agreement,
        first,
        last,
        no_highest_m,
        no_lowest_m,
    )


def biweight(values: Floats, weights: Floats, begins: Integers, sigma_m: float) -> tuple[Floats, Floats]:
    """Location (groups,) and standard error of groups of values, rows `begins[i]` to `begins[i + 1]`, by themselves."""
    return _biweights(values, weights, begins, sigma_m)


@compiled_without_gil
def _biweights(values: Floats, weights: Floats, begins: Integers, sigma_m: float) -> tuple[Floats, Floats]:
    n = len(begins) - 1
    location_m, error_m = np.empty(n), np.empty(n)
    for i in range(n):
        first, last = begins[i], begins[i + 1]
        location_m[i], error_m[i], _, _ = located(values[first:last], weights[first:last], sigma_m)
    return location_m, error_m


@compiled_without_gil
def located(x: Floats, w: Floats, sigma_m: float) -> tuple[float, float, float, float]:
    """Location, standard error, degrees of freedom and scale of values (n,) with weights (n,), all above zero."""
    n = len(x)
    if n == 0:
        return np.nan, np.nan, np.nan, np.nan
    middle = np.median(x)
    own = PRIOR_VOTES / (PRIOR_VOTES + _MAD_EFFICIENCY * (n - 1))
    mad_m = _MAD * np.median(np.abs(x - middle) * np.sqrt(w))
    scale_m = math.sqrt(own * sigma_m**2 + (1.0 - own) * mad_m**2)
    location_m = middle
    reach_m = TUNING * scale_m
    for _ in range(_ROUNDS):
        total, moment = 0.0, 0.0
        for k in range(n):
            u = (x[k] - location_m) * math.sqrt(w[k]) / reach_m
            if abs(u) < 1.0:
                say = w[k] * (1.0 - u * u) ** 2
                total += say
                moment += say * (x[k] - location_m)
        if total == 0.0:
            break
        step = moment / total
        location_m += step
        if abs(step) < 1e-6:
            break
    slope, square, weight, weight_square = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        root = math.sqrt(w[k])
        u = (x[k] - location_m) * root / reach_m
        weight += w[k]
        weight_square += w[k] * w[k]
        if abs(u) < 1.0:
            rest = 1.0 - u * u
            slope += w[k] * rest * (1.0 - 5.0 * u * u)
            square += w[k] * (u * rest * rest * reach_m) ** 2
    effective = weight * weight / weight_square
    pooled = scale_m**2 / (EFFICIENCY * weight)
    if slope > 0.0 and effective > 1.0:
        own_square = square / slope**2 * effective / (effective - 1.0)
        variance = (PRIOR_VOTES * pooled + (effective - 1.0) * own_square) / (PRIOR_VOTES + effective - 1.0)
    elif slope > 0.0:
        variance = pooled
    else:
        variance = max(pooled, scale_m**2)
    return location_m, math.sqrt(variance), PRIOR_VOTES + effective - 1.0, scale_m


@compiled_without_gil
def _once_each(
    voter: Integers, session: Integers, value_m: Floats, weight: Floats, from_day: int, to_day: int
) -> tuple[Floats, Floats]:
    """Values and weights, one for each voter with a say, of sessions from `from_day` to before `to_day`."""
    n = len(voter)
    x, w, few = np.empty(n), np.empty(n), np.empty(n)
    count, first = 0, 0
    while first < n:
        last, votes, says = first, 0, 0.0
        while last < n and voter[last] == voter[first]:
            if from_day <= session[last] < to_day and weight[last] >= _NO_SAY:
                few[votes] = value_m[last]
                says += weight[last]
                votes += 1
            last += 1
        if votes > 0:
            x[count] = few[0] if votes == 1 else np.median(few[:votes])
            w[count] = says / votes
            count += 1
        first = last
    return x[:count], w[:count]


@compiled_without_gil
def _likeliest_change(
    session: Integers,
    value_m: Floats,
    weight: Floats,
    sigma_m: float,
    from_day: int,
    end_day: int,
    least: int,
    least_after: int,
) -> int:
    """The day of sessions from `from_day` to `end_day` before and after which the votes differ most.

    By their means, clipped about the median, from a table of days; `from_day` where either side is always too few.
    """
    days = end_day - from_day
    count, sum_m = np.zeros(days), np.zeros(days)
    some = np.empty(len(session))
    votes = 0
    for k in range(len(session)):
        if session[k] >= from_day and weight[k] >= _NO_SAY:
            some[votes] = value_m[k]
            votes += 1
    if votes < least + least_after:
        return from_day
    middle_m, reach_m = np.median(some[:votes]), TUNING * sigma_m
    for k in range(len(session)):
        if session[k] >= from_day and weight[k] >= _NO_SAY:
            day = session[k] - from_day
            count[day] += 1.0
            sum_m[day] += min(max(value_m[k] - middle_m, -reach_m), reach_m)
    total, total_m = count.sum(), sum_m.sum()
    best, best_square, before, before_m = from_day, 0.0, 0.0, 0.0
    for day in range(1, days):
        before += count[day - 1]
        before_m += sum_m[day - 1]
        after, after_m = total - before, total_m - before_m
        if before >= least and after >= least_after:
            square = (after_m / after - before_m / before) ** 2 / (1.0 / after + 1.0 / before)
            if square > best_square:
                best, best_square = from_day + day, square
    return best


@compiled_without_gil
def _changed_on(
    voter: Integers,
    session: Integers,
    value_m: Floats,
    weight: Floats,
    sigma_m: float,
    from_day: int,
    end_day: int,
    least_voters: int,
    least_z: float,
    least_m: float,
    liars: int,
) -> int:
    """The day after `from_day` on which the road changed beyond doubt; `from_day` where on none.

    Beyond doubt also without those of after the change who say so most, as many as might be lying.
    """
    least_after = least_voters + liars
    day = _likeliest_change(session, value_m, weight, sigma_m, from_day, end_day, least_voters, least_after)
    if day == from_day:
        return from_day
    after, after_w = _once_each(voter, session, value_m, weight, day, end_day)
    before, before_w = _once_each(voter, session, value_m, weight, from_day, day)
    if len(after) < least_after or len(before) < least_voters:
        return from_day
    old_m, old_error_m, _, _ = located(before, before_w, sigma_m)
    by_value = np.argsort(after)
    rest = by_value[: len(after) - liars] if np.median(after) > old_m else by_value[liars:]
    new_m, new_error_m, _, _ = located(after[rest], after_w[rest], sigma_m)
    beyond_m = least_z * math.sqrt(new_error_m**2 + old_error_m**2)
    return day if abs(new_m - old_m) > max(beyond_m, least_m) else from_day


@compiled_without_gil
def _heights(
    begins: Integers,
    voter: Integers,
    session: Integers,
    value_m: Floats,
    weight: Floats,
    known: NDArray[np.bool_],
    sigma_m: float,
    least_voters: int,
    least_z: float,
    least_m: float,
    coalition: float,
    coalition_days: int,
) -> tuple[Integers, Floats]:
    n = len(begins) - 1
    integers, floats = np.zeros((n, 6), np.int64), np.full((n, 7), np.nan)
    integers[:, 4:] = -1
    for i in range(n):
        a, b = begins[i], begins[i + 1]
        if a == b:
            continue
        whose, day, says, of = voter[a:b], session[a:b], value_m[a:b], weight[a:b]
        from_day, end_day = day.min(), day.max() + 1
        lately, _ = _once_each(whose, day, says, of, end_day - coalition_days, end_day)
        liars = math.ceil(coalition * len(lately) - 1e-9)
        while True:
            changed = _changed_on(
                whose,
                day,
                says,
                of,
                sigma_m,
                from_day,
                end_day,
                least_voters,
                least_z,
                least_m,
                liars,
            )
            if changed == from_day:
                break
            from_day = changed
        x, w = _once_each(whose, day, says, of, from_day, end_day)
        location_m, error_m, degrees, scale_m = located(x, w, sigma_m)
        integers[i, 4], integers[i, 5] = from_day, end_day - 1
        if len(x) == 0:
            continue
        agree = 0
        for k in range(len(x)):
            if abs(x[k] - location_m) * math.sqrt(w[k]) <= 3.0 * sigma_m:
                agree += 1
        floats[i, 0], floats[i, 1], floats[i, 2], floats[i, 3] = location_m, error_m, degrees, scale_m
        floats[i, 4] = agree / len(x)
        if from_day < end_day - coalition_days:
            liars = math.ceil(coalition * len(x) - 1e-9)
        by_value, some = np.argsort(x), min(liars, len(x))
        low, high = by_value[: len(x) - some], by_value[some:]
        floats[i, 5], _, _, _ = located(x[low], w[low], sigma_m)
        floats[i, 6], _, _, _ = located(x[high], w[high], sigma_m)
        integers[i, 0] = len(x)
        integers[i, 1], integers[i, 2], integers[i, 3] = _counts(whose, day, of, known[a:b], from_day)
    return integers, floats


@compiled_without_gil
def _counts(
    voter: Integers, session: Integers, weight: Floats, known: NDArray[np.bool_], from_day: int
) -> tuple[int, int, int]:
    """Voters whose bias is known, votes, and different days, of the votes with a say from `from_day` on."""
    votes, known_voters, last_known = 0, 0, np.int64(-1)
    days = np.empty(len(voter), np.int64)
    for k in range(len(voter)):
        if session[k] < from_day or weight[k] < _NO_SAY:
            continue
        days[votes] = session[k]
        votes += 1
        if known[k] and (known_voters == 0 or voter[k] != last_known):
            known_voters += 1
            last_known = voter[k]
    days = np.sort(days[:votes])
    different = 0
    for k in range(votes):
        if k == 0 or days[k] != days[k - 1]:
            different += 1
    return known_voters, votes, different
