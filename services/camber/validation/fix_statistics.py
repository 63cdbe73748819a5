"""Statistics of decisions on the candidate fixes of a drive: the same for Camber and for every baseline.

Definitions (3D, at the antenna, after the constant offset):
    wrong    error > 0.5 m;  right  error ≤ 0.2 m;  between them a fix is neither
    episode  consecutive wrong fixes (or wrong confirmed positions) without a right fix between them, each at most
             `EPISODE_GAP_S` after the previous one
    missed   an episode in which at least one wrong position was confirmed

Epochs of one episode share their cause, so only episodes count as trials: with none of n missed, the rate of
missed episodes is bounded by 3/n (95 %). After one second a moving vehicle has other reflections, a stopped
one has not: `cautious` counts again with 10 s; quote its n where vehicles often stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from camber.formats.drive.truth_csv import WRONG_M
from camber.schemas.base import Float64, Int64

RIGHT_M = 0.2
"""Chosen: several σ of a correct fix and of the reference, and less than one wrong cycle usually moves a position."""
EPISODE_GAP_S = 1.0
"""Chosen: a moving vehicle has other reflections after it (see above)."""
CAUTIOUS_GAP_S = 10.0
"""Chosen: the largest reflection time constant of `camber lab` (`Assumptions.reflection_time_s`)."""
_JITTER_S = 0.05  # of receiver times that are nominally a whole period apart

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class CandidateFixes:
    """Fixes that passed the ratio test, in the order of time: arrays (n,).

    `error_m` is in 3D, NaN where the truth is unknown: such a fix is neither right nor wrong.
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixDecisions:
    """Decisions of one judge: flags (n,) over the candidate fixes, and all positions (m,) that it confirmed.

    A confirmed position may differ from the candidate fix (re-estimation), or be of an epoch without one.
    `unknown_count` counts every verdict *unknown*, also on epochs without a fix.
    """

    confirmed: Flags
    erroneous: Flags
    unknown: Flags
    unknown_count: int
    confirmed_time_ns: Int64
    confirmed_error_m: Float64


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """An episode of wrong positions; `fixes` are rows of `CandidateFixes`."""

    start_ns: int
    end_ns: int
    fixes: tuple[int, ...]
    confirmed_wrong: int

    @property
    def missed(self) -> bool:
        """Whether a wrong position was confirmed in it."""
        return self.confirmed_wrong > 0


def episodes_of(
    fixes: CandidateFixes, decisions: FixDecisions, gap_s: float = EPISODE_GAP_S
) -> list[Episode]:
    """The episodes, in the order of time."""
    n, m = len(fixes.time_ns), len(decisions.confirmed_time_ns)
    time_ns = np.concatenate((fixes.time_ns, decisions.confirmed_time_ns))
    missed = np.concatenate((np.zeros(n, bool), decisions.confirmed_error_m > WRONG_M))
    wrong = np.concatenate((fixes.wrong, np.zeros(m, bool))) | missed
    right = np.concatenate((fixes.right, np.zeros(m, bool)))
    row = np.concatenate((np.arange(n), np.full(m, -1)))
    relevant = np.flatnonzero(wrong | right)
    order = relevant[np.argsort(time_ns[relevant], kind="stable")]

    groups: list[list[int]] = []
    right_between = True
    for i in order.tolist():
        if not wrong[i]:
            right_between = True
            continue
        apart = not groups or time_ns[i] - time_ns[groups[-1][-1]] > (gap_s + _JITTER_S) * 1e9
        if apart or right_between:
            groups.append([])
        groups[-1].append(i)
        right_between = False
    return [
        Episode(
            start_ns=int(time_ns[group[0]]),
            end_ns=int(time_ns[group[-1]]),
            fixes=tuple(int(row[i]) for i in group if row[i] >= 0),
            confirmed_wrong=int(missed[group].sum()),
        )
        for group in groups
    ]


def is_evaluable(error_m: Float64) -> bool:
    """Whether errors can be counted: at least one is known, or there is none."""
    return not len(error_m) or bool(np.isfinite(error_m).any())


def decision_statistics(fixes: CandidateFixes, decisions: FixDecisions, *, truth: bool) -> dict[str, Any]:
    """Statistics of one judge; what needs a truth is None where it is unknown at every fix."""
    error_m = decisions.confirmed_error_m
    right = fixes.right
    fixes_known = truth and is_evaluable(fixes.error_m)
    confirmed_known = truth and is_evaluable(error_m)
    any_known = truth and is_evaluable(np.concatenate((fixes.error_m, error_m)))
    kept = float(decisions.confirmed[right].mean()) if right.any() else None
    return {
        "confirmed": {
            "count": len(error_m),
            "wrong": int((error_m > WRONG_M).sum()) if confirmed_known else None,
            "truth_unknown": int(np.isnan(error_m).sum()),
        },
        "right": {
            "count": int(right.sum()) if fixes_known else None,
            "kept": kept if fixes_known else None,
            "erroneous": int(decisions.erroneous[right].sum()) if fixes_known else None,
        },
        "erroneous": {"count": int(decisions.erroneous.sum())},
        "unknown": {"count": decisions.unknown_count, "of_fixed": int(decisions.unknown.sum())},
        "episodes": _episode_statistics(fixes, decisions) if any_known else dict.fromkeys(_EPISODE_NAMES),
    }


_EPISODE_NAMES = ("wrong", "missed", "longest_s", "n", "bound", "cautious")


def _episode_statistics(fixes: CandidateFixes, decisions: FixDecisions) -> dict[str, Any]:
    episodes = episodes_of(fixes, decisions)
    cautious = episodes_of(fixes, decisions, CAUTIOUS_GAP_S)
    return {
        **_counts(episodes),
        "longest_s": max(((e.end_ns - e.start_ns) / 1e9 for e in episodes), default=0.0),
        "cautious": {"gap_s": CAUTIOUS_GAP_S, **_counts(cautious)},
    }


def _counts(episodes: list[Episode]) -> dict[str, Any]:
    n, missed = len(episodes), sum(e.missed for e in episodes)
    return {"wrong": n, "missed": missed, "n": n, "bound": min(1.0, 3.0 / n) if n and not missed else None}
