"""The figures of one judge over the tentative fixes of a drive: the same for Camber and for every control.

Definitions (3D, at the antenna, after the constant offset):
    wrong    error > 0.5 m;  right  error ≤ 0.2 m;  between them a fix is neither
    episode  wrong fixes (or wrong confirmed positions) one after the other, no right fix between them, each no
             more than `EPISODE_GAP_S` after the one before
    missed   an episode in which at least one wrong position was confirmed

Epochs of one episode share their cause, so only episodes count as trials: with none of n missed, the rate of
missed episodes is bounded by 3/n (95 %), no better. Beyond one second a street has other reflections, a
vehicle that stands has not: `cautious` counts again with 10 s, and its n is the one to quote where vehicles
stand much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from camber.formats.drive.truth_csv import WRONG_M
from camber.schemas.base import Float64, Int64

RIGHT_M = 0.2
EPISODE_GAP_S = 1.0
CAUTIOUS_GAP_S = 10.0
_JITTER_S = 0.05  # of receiver times that are nominally a whole period apart

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Tentative:
    """The fixes that passed the ratio test, in the order of their times: arrays (n,).

    `error_m` is in 3D and NaN where the truth is not known there: such a fix is neither right nor wrong.
    """

    time_ns: Int64
    error_m: Float64

    @property
    def wrong(self) -> Flags:
        """Which are wrong."""
        return self.error_m > WRONG_M

    @property
    def right(self) -> Flags:
        """Which are right."""
        return self.error_m <= RIGHT_M


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What one judge said: flags (n,) over the tentative fixes, and all positions (m,) that it confirmed.

    A confirmed position may be another one than the tentative fix (a new estimate), or of an epoch without
    one. `unknown_count` counts every word *unknown*, also on epochs without a fix.
    """

    confirmed: Flags
    erroneous: Flags
    unknown: Flags
    unknown_count: int
    confirmed_time_ns: Int64
    confirmed_error_m: Float64


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode of wrong positions; `fixes` are rows of `Tentative`."""

    start_ns: int
    end_ns: int
    fixes: tuple[int, ...]
    confirmed_wrong: int

    @property
    def missed(self) -> bool:
        """Whether a wrong position was confirmed in it."""
        return self.confirmed_wrong > 0


def episodes_of(fixes: Tentative, judgement: Judgement, gap_s: float = EPISODE_GAP_S) -> list[Episode]:
    """The episodes, in the order of time."""
    n, m = len(fixes.time_ns), len(judgement.confirmed_time_ns)
    time_ns = np.concatenate((fixes.time_ns, judgement.confirmed_time_ns))
    missed = np.concatenate((np.zeros(n, bool), judgement.confirmed_error_m > WRONG_M))
    wrong = np.concatenate((fixes.wrong, np.zeros(m, bool))) | missed
    right = np.concatenate((fixes.right, np.zeros(m, bool)))
    row = np.concatenate((np.arange(n), np.full(m, -1)))
    relevant = np.flatnonzero(wrong | right)
    order = relevant[np.argsort(time_ns[relevant], kind="stable")]

    groups: list[list[int]] = []
    rights_between = True
    for i in order.tolist():
        if not wrong[i]:
            rights_between = True
            continue
        apart = not groups or time_ns[i] - time_ns[groups[-1][-1]] > (gap_s + _JITTER_S) * 1e9
        if apart or rights_between:
            groups.append([])
        groups[-1].append(i)
        rights_between = False
    return [
        Episode(
            start_ns=int(time_ns[group[0]]),
            end_ns=int(time_ns[group[-1]]),
            fixes=tuple(int(row[i]) for i in group if row[i] >= 0),
            confirmed_wrong=int(missed[group].sum()),
        )
        for group in groups
    ]


def some_known(error_m: Float64) -> bool:
    """Whether counting these errors says anything: one of them is known, or there is none to know."""
    return not len(error_m) or bool(np.isfinite(error_m).any())


def figures(fixes: Tentative, judgement: Judgement, *, truth: bool) -> dict[str, Any]:
    """The figures of one judge; what depends on a truth is None where there is none, or none at any fix."""
    error_m = judgement.confirmed_error_m
    right = fixes.right
    fixes_known = truth and some_known(fixes.error_m)
    confirmed_known = truth and some_known(error_m)
    any_known = truth and some_known(np.concatenate((fixes.error_m, error_m)))
    kept = float(judgement.confirmed[right].mean()) if right.any() else None
    return {
        "confirmed": {
            "count": len(error_m),
            "wrong": int((error_m > WRONG_M).sum()) if confirmed_known else None,
            "truth_unknown": int(np.isnan(error_m).sum()),
        },
        "right": {
            "count": int(right.sum()) if fixes_known else None,
            "kept": kept if fixes_known else None,
            "erroneous": int(judgement.erroneous[right].sum()) if fixes_known else None,
        },
        "erroneous": {"count": int(judgement.erroneous.sum())},
        "unknown": {"count": judgement.unknown_count, "of_fixed": int(judgement.unknown.sum())},
        "episodes": _episode_figures(fixes, judgement) if any_known else dict.fromkeys(_EPISODE_NAMES),
    }


_EPISODE_NAMES = ("wrong", "missed", "longest_s", "n", "bound", "cautious")


def _episode_figures(fixes: Tentative, judgement: Judgement) -> dict[str, Any]:
    episodes = episodes_of(fixes, judgement)
    cautious = episodes_of(fixes, judgement, CAUTIOUS_GAP_S)
    return {
        **_counts(episodes),
        "longest_s": max(((e.end_ns - e.start_ns) / 1e9 for e in episodes), default=0.0),
        "cautious": {"gap_s": CAUTIOUS_GAP_S, **_counts(cautious)},
    }


def _counts(episodes: list[Episode]) -> dict[str, Any]:
    n, missed = len(episodes), sum(e.missed for e in episodes)
    return {"wrong": n, "missed": missed, "n": n, "bound": min(1.0, 3.0 / n) if n and not missed else None}
