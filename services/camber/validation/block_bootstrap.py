"""How sure a share is whose epochs hang together: whole blocks are drawn anew, not epochs.

Errors of neighbouring epochs share their cause, so n epochs are far fewer trials than n. Blocks longer than such a
cause lasts are nearly independent of one another: B of B blocks are drawn with replacement, again and again, and the
spread of the share over these draws is its uncertainty (Künsch 1989, with blocks that do not overlap).
"""

from __future__ import annotations

import numpy as np

from camber.schemas.base import Float64

DRAWS = 2000


def share_of(hits: Float64, trials: Float64) -> float | None:
    """Hits by trials over all blocks (b,); None without a trial."""
    total = float(trials.sum())
    return float(hits.sum()) / total if total else None


def share_interval(
    hits: Float64, trials: Float64, *, seed: int, level: float = 0.95, draws: int = DRAWS
) -> tuple[float, float] | None:
    """The interval that holds `level` of the shares redrawn from blocks (b,) of `hits` among `trials`.

    None where no block has a trial. With a single block, or with all hits in every one, it has no width: that many
    blocks say no more (with none of n missed, 3/n bounds the rate).
    """
    there = trials > 0
    hits, trials = hits[there], trials[there]
    if not len(trials):
        return None
    chosen = np.random.default_rng(seed).integers(0, len(trials), (draws, len(trials)))
    shares = hits[chosen].sum(axis=1) / trials[chosen].sum(axis=1)
    low, high = np.quantile(shares, (0.5 * (1.0 - level), 0.5 * (1.0 + level)))
    return float(low), float(high)
