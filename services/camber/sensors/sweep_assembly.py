"""Firings, in whatever order their packets came, cut into sweeps where the turn begins anew."""

from __future__ import annotations

from collections import Counter, deque
from itertools import pairwise

import numpy as np

from camber.formats.lidar_can.firings import Firings, Float64, Int32, Int64, joined
from camber.schemas.lidar import Sweep

_SETTLES_NS = 3_000_000  # chosen: so long a turn's first packets wait for the last ones of the turn before
_PAUSE_NS = 40_000_000  # chosen: after a longer one the seam may have been in it
_BACK = 0.1  # chosen: of a turn: sensors do not turn backwards
_LONGEST_NS = 1_000_000_000  # chosen: nothing turns so slowly
_SECTOR = 1.0 / 24.0  # chosen: of a turn: what lacks there in every turn was not measured, and is not lost

_Part = tuple[float, float]
"""Of turns: where it begins, how much it is."""


class SweepCutter:
    """Sweeps of one sensor; `counts`: packets that were late or repeated or lost, sweeps that were not whole.

    A sweep with less than `least_share` of a turn is left out.
    """

    def __init__(self, sensor: str, interval_ns: int, beam_after_ns: Int32, least_share: float) -> None:
        self.counts: Counter[str] = Counter()
        self._sensor, self._least_share = sensor, least_share
        self._interval_ns = interval_ns
        self._beam_after_ns = beam_after_ns
        self._last_beam_ns = int(beam_after_ns.max())
        self._lost = 0.0
        self.start_anew()

    def start_anew(self) -> None:
        """The clock was set, or the sensor started again: what waits belongs to no sweep."""
        self._time_ns: Int64 = np.empty(0, np.int64)
        self._waiting: Firings | None = None
        self._done_ns: int | None = None
        self._done_turn = 0.0
        self._of_packet = 1
        # Of the last two turns; before them it is unknown what is measured.
        self._lacking: deque[list[_Part]] = deque([[(0.0, 1.0)]] * 2, maxlen=2)

    def add(self, time_ns: Int64, firings: Firings) -> list[Sweep]:
        """Firings (n,) at their GPS times; returns the sweeps that are complete with them."""
        self._of_packet = max(self._of_packet, int(np.bincount(firings.packet).max()))
        fresh = np.ones(len(time_ns), np.bool_)
        if self._done_ns is not None:
            fresh = time_ns > self._done_ns
            self.counts["packets.late"] += self._packets(int((~fresh).sum()))
        all_ns = np.concatenate((self._time_ns, time_ns[fresh]))
        waiting = firings.chosen(fresh)
        if self._waiting is not None:
            waiting = joined([self._waiting, waiting])
        order = np.argsort(all_ns, kind="stable")
        once = np.ones(len(order), np.bool_)
        once[1:] = np.diff(all_ns[order]) > self._interval_ns // 2
        self.counts["packets.repeated"] += self._packets(int((~once).sum()))
        if not (np.diff(order) == 1).all() or not once.all():
            order = order[once]
            all_ns, waiting = all_ns[order], waiting.chosen(order)
        self._time_ns, self._waiting = all_ns, waiting
        sweeps = self._cut(_seams(all_ns, waiting.turn))
        if len(self._time_ns) and self._time_ns[-1] - self._time_ns[0] > _LONGEST_NS:
            self.counts["sweeps.not_turning"] += 1
            self._time_ns, self._waiting = self._time_ns[:0], None
        return sweeps

    def finish(self) -> list[Sweep]:
        """Nothing more comes: what waits is the last sweep."""
        if self._waiting is None:
            return []
        return self._cut([*_seams(self._time_ns, self._waiting.turn, 0), len(self._time_ns)])

    def _cut(self, ends: list[int]) -> list[Sweep]:
        """The sweeps that end there; what stands after the last end goes on waiting."""
        assert self._waiting is not None
        begins = [0, *ends]
        parts = [slice(begin, end) for begin, end in pairwise(begins) if begin < end]
        turns = [(self._time_ns[part], self._waiting.chosen(part)) for part in parts]
        rest = slice(begins[-1], None)
        self._time_ns, self._waiting = self._time_ns[rest], self._waiting.chosen(rest)
        sweeps = [self._sweep(time_ns, firings) for time_ns, firings in turns]
        return [sweep for sweep in sweeps if sweep is not None]

    def _sweep(self, time_ns: Int64, firings: Firings) -> Sweep | None:
        steps = np.diff(firings.turn)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        self._count_lost(time_ns, firings.turn, step)
        self._done_ns, self._done_turn = int(time_ns[-1]), float(firings.turn[-1])
        if time_ns[-1] - time_ns[0] > _LONGEST_NS:
            self.counts["sweeps.not_turning"] += 1
            return None
        if min(len(time_ns) * step, float(np.ptp(firings.turn)) + step) < self._least_share:
            self.counts["sweeps.partial"] += 1
            return None
        end_ns = int(time_ns[-1]) + self._last_beam_ns
        offset_ns = (time_ns - end_ns)[:, None] + self._beam_after_ns
        returned = firings.returned
        self.counts["sweeps.whole"] += 1
        return Sweep(
            time_ns=end_ns,
            sensor=self._sensor,
            points_m=firings.points_m[returned],
            intensity=firings.intensity[returned],
            offset_ns=offset_ns[returned].astype(np.int32),
        )

    def _count_lost(self, time_ns: Int64, turn: Float64, step: float) -> None:
        if self._done_ns is not None:
            time_ns, turn = np.append(self._done_ns, time_ns), np.append(self._done_turn, turn)
        steps_ns = np.diff(time_ns)
        wide: list[_Part] = []
        for k in np.flatnonzero((steps_ns > 1.5 * self._interval_ns) & (steps_ns <= _LONGEST_NS)).tolist():
            lost = round(steps_ns[k] / self._interval_ns) - 1.0
            part = float(turn[k]), min(lost * step, 1.0)
            if part[1] > _SECTOR and len(wide) < 1.0 / _SECTOR:  # of a turn; packets can claim anything
                wide.append(part)
                lost *= 1.0 - max(_common(part, before) for before in self._lacking) / part[1]
            self._lost += lost / self._of_packet
        self._lacking.append(wide)
        self.counts["packets.lost"] = round(self._lost)

    def _packets(self, firings: int) -> int:
        return -(-firings // self._of_packet)


def _common(part: _Part, before: list[_Part]) -> float:
    """How much of a part of turns lay, in a turn before, in one of these."""
    begin, length = part
    common = 0.0
    for other, other_length in before:
        ahead = (other - begin) % 1.0
        for at in (ahead - 1.0, ahead):
            common += max(min(length, at + other_length) - max(at, 0.0), 0.0)
    return min(common, length)


def _seams(time_ns: Int64, turn: Float64, settles_ns: int = _SETTLES_NS) -> list[int]:
    """Where sweeps end, of those whose end nothing late can move any more."""
    if len(time_ns) < 2:
        return []
    ends = np.flatnonzero((np.diff(turn) < -_BACK) | (np.diff(time_ns) > _PAUSE_NS)) + 1
    return [int(end) for end in ends if time_ns[-1] - time_ns[end] >= settles_ns]
