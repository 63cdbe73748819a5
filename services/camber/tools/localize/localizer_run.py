"""Run the localizer alone on a recorded drive: one process, no bus, as fast as possible."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from tqdm import tqdm

from camber.localizer.localization import Localization, LocalizationOptions
from camber.localizer.map_queries import MapQueries
from camber.localizer.matching.scan_matcher import ScanMatcher
from camber.replay.drive_inputs import DriveInputs
from camber.replay.sweep_files import SweepReader
from camber.schemas.base import Message
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.pose import Pose, ScanMatch

M = TypeVar("M", bound=Message)


class MatchObserver(Protocol):
    """Receives matches while the matcher still holds their view."""

    def on_matches(self, matches: Sequence[ScanMatch], matcher: ScanMatcher) -> None:
        """Called with the matches of one step."""


@dataclass(slots=True, kw_only=True)
class IssueTally:
    """Issues and counters that the localizer reported: issues by code, each with its last text."""

    issues: Counter[str] = field(default_factory=Counter)
    texts: dict[str, str] = field(default_factory=dict)
    counters: Counter[str] = field(default_factory=Counter)

    def issue(self, code: str, text: str) -> None:
        """Count an issue."""
        self.issues[code] += 1
        self.texts[code] = text

    def count(self, name: str) -> None:
        """Increment a counter."""
        self.counters[name] += 1


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizedDrive:
    """Output of the localizer in time order. `sweep_s`: computing time of each sweep."""

    poses: list[Pose]
    matches: list[ScanMatch]
    sweep_s: list[float]
    tally: IssueTally
    notes: tuple[str, ...]


def localize(
    inputs: DriveInputs,
    options: LocalizationOptions,
    answers: MapQueries,
    *,
    fixes: Sequence[Fix] = (),
    anchors: Sequence[Verdict] = (),
    observer: MatchObserver | None = None,
    quiet: bool = True,
) -> LocalizedDrive:
    """Feed all inputs in the order of a replay: a verdict comes after the pose of its epoch."""
    tally, reader = IssueTally(), SweepReader()
    localization = Localization(options, answers, tally)
    matcher = localization.matcher
    fixed, confirmed = _TimeOrdered(fixes), _TimeOrdered(anchors)
    poses: list[Pose] = []
    matches: list[ScanMatch] = []
    sweep_s: list[float] = []
    with tqdm(total=len(inputs.tick_times_ns), unit="epoch", disable=quiet or not sys.stderr.isatty()) as bar:
        for tick in inputs.ticks():
            fixed.deliver_before(tick.time_ns + 1, localization.on_fix)
            confirmed.deliver_before(tick.time_ns, localization.on_verdict)
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
            if observer is not None and matcher is not None and step.matches:
                observer.on_matches(step.matches, matcher)
            bar.update()
    return LocalizedDrive(
        poses=poses, matches=matches, sweep_s=sweep_s, tally=tally, notes=(*inputs.notes, *reader.notes())
    )


class _TimeOrdered(Generic[M]):
    """Messages in time order, each delivered once."""

    def __init__(self, messages: Sequence[M]) -> None:
        self._messages = messages
        self._next = 0

    def deliver_before(self, time_ns: int, receive: Callable[[M], None]) -> None:
        """Deliver the messages older than `time_ns`."""
        while self._next < len(self._messages) and self._messages[self._next].time_ns < time_ns:
            receive(self._messages[self._next])
            self._next += 1
