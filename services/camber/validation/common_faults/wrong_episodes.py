"""Wrong integers in episodes: when, by which vector, and with how many satellites.

Vectors are those of `simulator.satellites.wrong_fix_shapes`: what LAMBDA finds from floats that reflections have
biased, and cycles whose residuals pass. They drift as the satellites move. A low-cost receiver in streets had 25 % of
8,365 fixes wrong, in episodes of up to minutes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.simulator.random_streams import stream
from camber.simulator.satellites.random_skies import random_skies
from camber.simulator.satellites.wrong_fix_shapes import fix_shapes
from camber.simulator.scene import Floats, Integers

SHARE = 0.25  # of all fixes
LENGTH_S = (1.0, 120.0)
_SKIES = 2000  # chosen: some three hundred shapes
_SATELLITES = (8, 16)
"""Chosen: as many as other fixes in streets nearly have, so that their number does not separate the two. On the
Nagoya recording it does: 86 of 114 wrong fixes had seven or fewer, 3 of 1,685 others."""
_WRONG_M = 0.5  # as `formats/drive/truth_csv.py` defines it


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WrongEpisodes:
    """Episodes (k,): begin and end [s], the fix's offset at its beginning [m] (k, 3), its rate [m/s], satellites."""

    begin_s: Floats
    end_s: Floats
    shift_m: Floats
    rate_m_s: Floats
    count: Integers

    def offset_m(self, time_s: Floats) -> Floats:
        """Offsets (n, 3) at times (n,); zero outside of episodes."""
        row, inside = self._at(time_s)
        since_s = (time_s - self.begin_s[row])[:, None]
        offset: Floats = np.where(inside[:, None], self.shift_m[row] + self.rate_m_s[row] * since_s, 0.0)
        return offset

    def satellites(self, time_s: Floats) -> Integers:
        """Numbers of satellites (n,); zero outside of episodes."""
        row, inside = self._at(time_s)
        return np.where(inside, self.count[row], 0)

    def _at(self, time_s: Floats) -> tuple[Integers, Floats]:
        row = (np.searchsorted(self.begin_s, time_s, side="right") - 1).clip(0)
        return row, (time_s >= self.begin_s[row]) & (time_s < self.end_s[row])


def wrong_episodes(
    seed: int, *, first_s: float, lasts_s: float, length_s: tuple[float, float] = LENGTH_S
) -> WrongEpisodes:
    """Episodes from `first_s` on: lengths of even probability in their logarithm, gaps so that `SHARE` is wrong."""
    rng = stream(seed, "wrong episodes")
    skies = random_skies(_SKIES, rng)
    kinds = [fix_shapes(skies, kind, 3, rng) for kind in ("search", "cycles")]
    kinds = [s.chosen(s.residuals_agree & (np.linalg.norm(s.shift_m, axis=1) > _WRONG_M)) for s in kinds]
    shift_m, rate_m_s = (
        np.concatenate([getattr(s, name) for s in kinds]) for name in ("shift_m", "rate_m_s")
    )
    shortest_s, longest_s = length_s
    mean_s = (longest_s - shortest_s) / math.log(longest_s / shortest_s)
    gap_s = mean_s * (1.0 - SHARE) / SHARE
    spans, at_s = [], first_s
    while at_s < lasts_s:
        at_s += float(rng.exponential(gap_s))
        end_s = at_s + math.exp(float(rng.uniform(math.log(shortest_s), math.log(longest_s))))
        spans.append((at_s, end_s))
        at_s = end_s
    chosen = rng.integers(0, len(shift_m), len(spans))
    begin, end = np.array(spans).T
    return WrongEpisodes(
        begin_s=begin,
        end_s=end,
        shift_m=shift_m[chosen],
        rate_m_s=rate_m_s[chosen],
        count=rng.integers(*_SATELLITES, len(spans)),
    )
