"""A drive through the localizer alone: one process, no bus, as fast as it goes."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from tqdm import tqdm

from camber.localizer.localization import Localization, LocalizationOptions
from camber.localizer.map_queries import MapAnswers
from camber.localizer.matching.scan_matcher import ScanMatcher
from camber.replay.drive_inputs import DriveInputs
from camber.replay.sweep_files import SweepReader
from camber.schemas.base import Message
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.pose import Pose, ScanMatch

M = TypeVar("M", bound=Message)


class Watcher(Protocol):
    """Whoever wants to see matches while their material is at hand."""

    def saw(self, matches: Sequence[ScanMatch], matcher: ScanMatcher) -> None:
        """These have just come out."""


@dataclass(slots=True)
class Tally:
    """What the localizer says on the way: issues by code, each with its last text, and counters."""

    issues: Counter[str] = field(default_factory=Counter)
    texts: dict[str, str] = field(default_factory=dict)
    counters: Counter[str] = field(default_factory=Counter)

    def issue(self, code: str, text: str) -> None:
        """Something amiss."""
        self.issues[code] += 1
        self.texts[code] = text

    def count(self, name: str) -> None:
        """One more of these."""
        self.counters[name] += 1


@dataclass(frozen=True, slots=True)
class LocalizedDrive:
    """What came out, in the order of time. `sweep_s`: what a sweep took from hearing it to its match."""

    poses: list[Pose]
    matches: list[ScanMatch]
    sweep_s: list[float]
    tally: Tally
    notes: tuple[str, ...]


def localize(
    inputs: DriveInputs,
    options: LocalizationOptions,
    answers: MapAnswers,
    *,
    fixes: Sequence[Fix] = (),
    anchors: Sequence[Verdict] = (),
    watcher: Watcher | None = None,
    quiet: bool = True,
) -> LocalizedDrive:
    """Hear everything as a replay would let the localizer hear it: a verdict comes after the pose of its epoch."""
    tally, reader = Tally(), SweepReader()
    localization = Localization(options, answers, tally)
    matcher = localization.matcher
    fixed, confirmed = _InTime(fixes), _InTime(anchors)
    poses: list[Pose] = []
    matches: list[ScanMatch] = []
    sweep_s: list[float] = []
    with tqdm(total=len(inputs.tick_times_ns), unit="epoch", disable=quiet or not sys.stderr.isatty()) as bar:
        for tick in inputs.ticks():
            fixed.before(tick.time_ns + 1, localization.on_fix)
            confirmed.before(tick.time_ns, localization.on_verdict)
            for motion in tick.motion:
                localization.on_motion(motion)
            sweeps = list(reader.read(tick.sweeps)) if matcher is not None else []
            began_s = time.perf_counter()
            for sweep in sweeps:
                localization.on_sweep(sweep)
            step = localization.advance()
            if step.matches:
                sweep_s.append((time.perf_counter() - began_s) / len(step.matches))
            matches += step.matches
            if step.pose is not None:
                poses.append(step.pose)
            if watcher is not None and matcher is not None and step.matches:
                watcher.saw(step.matches, matcher)
            bar.update()
    return LocalizedDrive(poses, matches, sweep_s, tally, (*inputs.notes, *reader.notes()))


class _InTime(Generic[M]):
    """Messages in the order of their times, each handed on once."""

    def __init__(self, messages: Sequence[M]) -> None:
        self._messages = messages
        self._next = 0

    def before(self, time_ns: int, hear: Callable[[M], None]) -> None:
        """Hand on those that are older than a time."""
        while self._next < len(self._messages) and self._messages[self._next].time_ns < time_ns:
            hear(self._messages[self._next])
            self._next += 1
