"""Wording of the report's headlines: counts, and rates with their 95 % interval where there are trials enough.

Epochs near in time share their causes (reflections, satellites in sight), so they are no independent trials: a rate of
epochs rests on the number of pieces of `CAUTIOUS_GAP_S` that they cover, each counted as one trial.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.schemas.base import Float64, Int64
from camber.validation import markdown
from camber.validation.fix_statistics import CAUTIOUS_GAP_S
from camber.validation.statistics import rate_interval

LEAST_TRIALS = 20
"""Fewer support no rate. By the rule of three n trials without an event leave rates up to 3/n possible (95 %): 15 %
with 20, as often as fixes are wrong in city streets (5 to 30 %). With fewer, a judge and none look alike."""
NBSP = "\u00a0"
NOT_KNOWN = "not known"


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """A tile: what was measured, and below it what it is worth."""

    name: str
    value: str
    more: str
    kind: Literal["", "good", "bad"] = ""


def pieces_of(time_ns: Int64) -> int:
    """How many pieces of `CAUTIOUS_GAP_S` contain at least one of the times (n,)."""
    return len(np.unique(time_ns // round(CAUTIOUS_GAP_S * 1e9)))


def count_headline(
    name: str, events: int | None, of: int | None, *, more: str, trials: int | None
) -> Headline:
    """Events that should not occur, as a count: bad where there are some, good where none of enough trials was one."""
    if events is None or of is None:
        return Headline(name=name, value=NOT_KNOWN, more="no truth")
    if not of:
        return Headline(name=name, value="none occurred", more="nothing to count")
    kind: Literal["", "good", "bad"] = "good" if (trials or 0) >= LEAST_TRIALS else ""
    return Headline(name=name, value=f"{events:,} of {of:,}", more=more, kind="bad" if events else kind)


def share_headline(name: str, share: float | None, time_ns: Int64, what: str) -> Headline:
    """A share of epochs or fixes at times (n,): in percent where they cover pieces enough, else as a count."""
    if share is None or not len(time_ns):
        return Headline(name=name, value=NOT_KNOWN, more=what)
    pieces, count = pieces_of(time_ns), len(time_ns)
    if pieces < LEAST_TRIALS:
        more = f"{what}; {too_few(pieces, _PIECES)}"
        return Headline(name=name, value=f"{round(share * count):,} of {count:,}", more=more)
    more = f"of {count:,} {what}; {interval_text(share * pieces, pieces)}, n = {pieces:,} ({_PIECES})"
    return Headline(name=name, value=percent(share), more=more)


def quantile_headline(name: str, values: Float64, time_ns: Int64) -> Headline:
    """The 95 % quantile of errors [m] (n,) at times (n,) with its interval; of few pieces the median."""
    known = np.isfinite(values)
    values, pieces = values[known], pieces_of(time_ns[known])
    if not len(values):
        return Headline(name=name, value=NOT_KNOWN, more="no truth")
    median, largest = metres(float(np.median(values))), metres(float(values.max()))
    if pieces < LEAST_TRIALS:
        return Headline(
            name=f"{name}, median",
            value=median,
            more=f"largest {largest}; {too_few(pieces, _PIECES, 'quantile')}",
        )
    # The share of values below a quantile is a rate of 95 %: its interval, as quantiles.
    low, high = np.quantile(values, rate_interval(0.95 * pieces, pieces), method="inverted_cdf")
    more = (
        f"95{NBSP}%: {low:.2f}–{metres(high)}, n = {pieces:,} ({_PIECES}); median {median}, largest {largest}"
    )
    return Headline(name=f"{name}, 95{NBSP}%", value=metres(float(np.quantile(values, 0.95))), more=more)


def rate_claim(events: int | None, trials: int | None, unit: str) -> str:
    """What a count of independent trials supports: a bound or an interval, or that there are too few of them."""
    if events is None or trials is None:
        return NOT_KNOWN
    if trials < LEAST_TRIALS:
        return too_few(trials, unit)
    if events == 0:
        return f"rate at most {_upper(3.0 / trials)} (95{NBSP}%, 3/n), n = {trials:,} ({unit})"
    return f"rate {percent(events / trials)}, {interval_text(events, trials)}, n = {trials:,} ({unit})"


def too_few(trials: int, unit: str, what: str = "rate") -> str:
    """Why nothing is claimed."""
    return f"no {what}: n = {trials} ({unit}), below {LEAST_TRIALS}"


def interval_text(events: float, trials: float) -> str:
    """The 95 % interval of a rate in percent, rounded outwards."""
    low, high = rate_interval(events, trials)
    decimals = 1 if high - low < 0.1 else 0
    scale = 10**decimals * 100.0
    low, high = math.floor(low * scale + 1e-9) / scale, math.ceil(high * scale - 1e-9) / scale
    return f"95{NBSP}%: {100.0 * low:.{decimals}f}–{100.0 * high:.{decimals}f}{NBSP}%"


def percent(share: float | None, decimals: int = 1) -> str:
    """A share in percent; only 1 is written as 100 %."""
    return NOT_KNOWN if share is None else markdown.percent(share, decimals).replace(" ", NBSP)


def metres(value: float | None) -> str:
    """A length to the centimetre."""
    return NOT_KNOWN if value is None else f"{value:.2f}{NBSP}m"


def _upper(bound: float) -> str:
    """A bound in percent, rounded up so that it still holds."""
    scale = 100.0 if bound >= 0.1 else 1000.0
    return f"{100.0 * math.ceil(scale * bound - 1e-9) / scale:g}{NBSP}%"


_PIECES = f"pieces of {CAUTIOUS_GAP_S:g} s"
