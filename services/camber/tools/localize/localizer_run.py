"""Run the localizer alone on a recorded drive: one process, no bus, as fast as possible."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from camber.localizer import warm_up as localizer_warm_up
from camber.localizer.localization import Localization, LocalizationOptions
from camber.localizer.map_queries import MapQueries
from camber.localizer.matching.scan_matcher import ScanMatcher
from camber.localizer.settings import LocalizerSettings
from camber.map_server import warm_up as map_server_warm_up
from camber.replay.drive_inputs import DriveInputs
from camber.replay.lock_step.processes import config_text
from camber.replay.sweep_files import SweepReader
from camber.road_map.release import Release
from camber.runtime.settings import load
from camber.schemas.base import Message
from camber.schemas.drive import ManifestError
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.motion import Imu, Motion
from camber.schemas.pose import Pose, ScanMatch
from camber.tools.localize.local_map_queries import release_for
from camber.tools.localize.localizer_config import localizer_config
from camber.tools.options.progress_display import ProgressDisplay
from camber.tools.options.shared_warm_up import warm_up_all

M = TypeVar("M", bound=Message)
OnMatches = Callable[[Sequence[ScanMatch], ScanMatcher], None]
"""Called with the matches of one step, while the matcher still holds their view."""


def localizer_settings(
    inputs: DriveInputs, folder: Path, *, prog: str, further: Sequence[str] = ()
) -> LocalizerSettings:
    """Return the settings that the process would have in a replay; their file stays in the folder."""
    file = folder / "localizer.toml"
    file.write_text(config_text(localizer_config(inputs.manifest, inputs.initial_pose)) + "\n", "utf-8")
    settings, _ = load(LocalizerSettings, ["--config", str(file), *further], prog=prog)
    return settings


def drive_map(inputs: DriveInputs, *needed: tuple[object, str]) -> Release:
    """Return the map of a drive. ManifestError names what is missing: motion, the map, or what else is `needed`."""
    motion = "table motion or imu, expected one, or wheel_speed and yaw_rate in surrogates.inputs"
    release = "table map, expected one, or links and road_surfaces as surrogates"
    for present, name in ((inputs.motion or inputs.imu, motion), *needed, (inputs.map_release, release)):
        if not present:
            raise ManifestError(f"{inputs.manifest.name}: no {name}")
    assert inputs.map_release is not None  # checked above
    return release_for(inputs.map_release, inputs.manifest.datum)


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


def _compile(*, scan_matching: bool, quiet: bool) -> None:
    """Compile map queries, and scan matching where it is used."""
    modules = (localizer_warm_up, map_server_warm_up) if scan_matching else (map_server_warm_up,)
    warm_up_all(modules, sum(module.FUNCTIONS for module in modules), quiet=quiet)


def localize(
    inputs: DriveInputs,
    options: LocalizationOptions,
    answers: MapQueries,
    *,
    fixes: Sequence[Fix] = (),
    anchors: Sequence[Verdict] = (),
    on_matches: OnMatches | None = None,
    quiet: bool = True,
) -> LocalizedDrive:
    """Feed all inputs in the order of a replay: a verdict comes after the pose of its epoch."""
    tally, reader = IssueTally(), SweepReader()
    localization = Localization(options, answers, tally)
    matcher = localization.matcher
    _compile(scan_matching=matcher is not None, quiet=quiet)
    fixed, confirmed = deque(fixes), deque(anchors)
    poses: list[Pose] = []
    matches: list[ScanMatch] = []
    sweep_s: list[float] = []
    with ProgressDisplay(len(inputs.tick_times_ns), "epoch", quiet=quiet) as display:
        for tick in inputs.ticks():
            _deliver_before(tick.time_ns + 1, fixed, localization.on_fix)
            _deliver_before(tick.time_ns, confirmed, localization.on_verdict)
            samples: tuple[Motion | Imu, ...] = (*tick.motion, *tick.imu)
            for sample in sorted(samples, key=lambda sample: sample.time_ns):
                if isinstance(sample, Imu):
                    localization.on_imu(sample)
                else:
                    localization.on_motion(sample)
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
            if on_matches is not None and matcher is not None and step.matches:
                on_matches(step.matches, matcher)
            display.advance()
    return LocalizedDrive(
        poses=poses, matches=matches, sweep_s=sweep_s, tally=tally, notes=(*inputs.notes, *reader.notes())
    )


def _deliver_before(time_ns: int, waiting: deque[M], receive: Callable[[M], None]) -> None:
    while waiting and waiting[0].time_ns < time_ns:
        receive(waiting.popleft())
