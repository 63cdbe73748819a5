"""Evidence from the scenario `faults`: what the services reported during each fault and after it, and who named it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camber.formats.drive.recording import Recorded
from camber.formats.drive.truth_csv import WRONG_M, TruthTable
from camber.replay.single_process_replay import DriveOutput
from camber.schemas.base import Int64
from camber.schemas.drive import load_manifest
from camber.simulator.scenario import load_scenario
from camber.tools.simulate import simulate
from camber.validation.evidence.evaluated_drive import EvaluatedDrive, evaluate_drive

AFTER_S = 15.0
"""Chosen: a cause may be named so long after the fault's end; its effects have ended by then."""
LASTING_S = 2.0
"""Chosen: an indication repeated within this time is the same one, going on."""
_PREFIX, _POSITIONS = "fault_", "receiver"
NO_SURFACE = -1  # chosen: map surfaces count from one
_SURFACE = re.compile(r"surface (\d+)")
_OF_LIDAR = ("blocked_lidar", "symmetric_scene")
_NS = 1e9  # nanoseconds of a second
_STATUSES = (("scan_match", "match", "converged"), ("antenna_height", "antenna_height", "known"))
"""Channel, name in texts, and the status that is usual."""

NAMED_BY: Mapping[str, frozenset[str]] = {
    "wrong_base": frozenset({"cause base", "verdict common_offset"}),
    "wrong_map": frozenset({"cause road", "cause ambiguous", "integrity road_changed"}),
    "changed_road": frozenset({"cause road", "cause ambiguous", "integrity road_changed"}),
    "changed_tyre": frozenset({"cause antenna", "antenna_height disagreement"}),
    "changed_load": frozenset({"cause antenna", "antenna_height disagreement"}),
    "wheel_slip": frozenset({"pose: the wheels do not say how fast the vehicle goes"}),
    "blocked_lidar": frozenset({"match lost", "match ambiguous", "localizer sweep_half_sweep"}),
    "symmetric_scene": frozenset({"match lost", "match ambiguous"}),
    "spoofing": frozenset(
        {"verdict common_offset", "verdict position_disagrees", "verdict height_and_position_disagree"}
    ),
    "jamming": frozenset({"verdict not_a_fix", "verdict gnss_stale", "verdict receiver_warns"}),
    "time_jump": frozenset({"verdict fix_implausible", "gnss epoch_from_the_future", "verdict gnss_stale"}),
    "repeated_epochs": frozenset({"verdict fix_repeated", "gnss repeated_epoch"}),
    "missing_epochs": frozenset({"verdict gnss_stale"}),
    "dropped_process": frozenset({"verdict localizer_absent", "verdict gnss_absent"}),
}
"""What names a fault: any one of these that begins while it acts or within `AFTER_S`.

*Ambiguous* is right for a road that one vehicle alone has seen before and after. A road counts as named where one of
the surfaces is named on which the fault was met.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultWindow:
    """When a fault acts, GPS time; one that acts again on the same link has a window for each time."""

    kind: str
    begin_ns: int
    end_ns: int


def fault_windows(truth: TruthTable) -> list[FaultWindow]:
    """The faults of a simulated drive's truth, in the order of time."""
    windows = []
    for name, column in truth.more.items():
        if not name.startswith(_PREFIX):
            continue
        acts = np.concatenate(([False], column > 0.0, [False]))
        edges = np.flatnonzero(np.diff(acts.astype(np.int8))).reshape(-1, 2)
        for begin_ns, end_ns in truth.time_ns[edges - (0, 1)].tolist():
            windows.append(FaultWindow(kind=name.removeprefix(_PREFIX), begin_ns=begin_ns, end_ns=end_ns))
    return sorted(windows, key=lambda window: window.begin_ns)


class FaultIndication(NamedTuple):
    """What may name a fault, and the surface that it names, if any."""

    time_ns: int
    text: str
    surface_id: int = NO_SURFACE


def indications_of(output: DriveOutput) -> list[FaultIndication]:
    """All that may name a fault: reasons of verdicts, causes, matches, antenna heights, poses, issues."""
    indications: list[FaultIndication] = []

    def add(time_ns: int, text: str, surface_id: int = NO_SURFACE) -> None:
        indications.append(FaultIndication(time_ns, text, surface_id))

    def messages(channel: str) -> Iterator[Any]:
        return (item.message for item in output.recorded.get(channel, ()))

    for verdict in messages("verdict"):
        add(verdict.time_ns, f"verdict {verdict.reason}")
        if verdict.cause != "none":
            surface_id = verdict.surface_id if verdict.cause == "road" else NO_SURFACE
            add(verdict.time_ns, f"cause {verdict.cause}", surface_id)
    for channel, name, usual in _STATUSES:
        for message in messages(channel):
            if message.status != usual:
                add(message.time_ns, f"{name} {message.status}")
    for pose in messages("pose"):
        for reason in filter(None, pose.reason.split("; ")):
            add(pose.time_ns, f"pose: {reason}")
    for issue in output.issues:
        surface = _SURFACE.search(issue.text) if issue.code == "road_changed" else None
        surface_id = NO_SURFACE if surface is None else int(surface[1])
        add(issue.time_ns, f"{issue.service} {issue.code}", surface_id)
    return sorted(indications)


def during(indications: Iterable[FaultIndication], begin_ns: int, end_ns: int) -> dict[str, dict[str, float]]:
    """The indications from one time to another: how often, and how long after the first time each first began [s].

    Without `begun_s` it was there before already, and never began anew. `indications` are in the order of time.
    """
    counts: Counter[str] = Counter()
    begun: dict[str, float] = {}
    last: dict[str, int] = {}
    for time_ns, text, _ in indications:
        if begin_ns <= time_ns <= end_ns:
            counts[text] += 1
            if text not in last or time_ns - last[text] > LASTING_S * _NS:
                begun.setdefault(text, (time_ns - begin_ns) / _NS)
        last[text] = time_ns
    return {
        text: {"count": count} | ({"begun_s": begun[text]} if text in begun else {})
        for text, count in counts.most_common()
    }


def run_faults(folder: Path, *, seed: int, overrides: Sequence[str], lidar: bool) -> dict[str, Any]:
    """Simulate the scenario, send it through one process; a row for each fault.

    Without `lidar` the vehicle has none, and the faults that concern it are left out: minutes instead of an hour.
    """
    made = load_scenario("faults", [*overrides, f"seed={seed}"])
    if not lidar:
        there = tuple(fault for fault in made.faults if fault.kind not in _OF_LIDAR)
        made = made.model_copy(update={"lidar": None, "faults": there})
    manifest = load_manifest(simulate(made, folder / "drive", quiet=True), [f'positions="{_POSITIONS}"'])
    drive = evaluate_drive(manifest, folder)
    summary, windows = drive.evaluation.summary, fault_windows(drive.truth)
    indications = indications_of(drive.output)
    return {
        "scenario": "faults",
        "seed": seed,
        "overrides": list(overrides),
        "positions": _POSITIONS,
        "sweeps": len(drive.inputs.sweeps),
        "faults": [
            _row(window, windows[number:], drive, indications) for number, window in enumerate(windows, 1)
        ],
        "confirmed_wrong": summary["confirmed"]["wrong"],
        "wrong": summary["tentative"]["wrong"],
        "right": summary["right"]["count"],
        "right_kept": summary["right"]["kept"],
    }


def _row(
    window: FaultWindow,
    later: Sequence[FaultWindow],
    drive: EvaluatedDrive,
    indications: Sequence[FaultIndication],
) -> dict[str, Any]:
    verdicts, last_ns = drive.output.recorded["verdict"], int(drive.truth.time_ns[-1])
    next_ns = later[0].begin_ns if later else last_ns + 1
    end_ns = named_until_ns(window, later, last_ns)
    after_ns = max(window.end_ns, min(end_ns, next_ns - 1))
    reported = during(_of_surfaces_met(indications, window, verdicts), window.begin_ns, end_ns)
    begun_s = {text: entry["begun_s"] for text, entry in reported.items() if "begun_s" in entry}
    names = {text: after_s for text, after_s in begun_s.items() if text in NAMED_BY.get(window.kind, ())}
    first = min(names, key=lambda text: names[text], default=None)
    evaluation, start_ns = drive.evaluation, drive.inputs.tick_times_ns[0]
    acts = _within(evaluation.fixes.time_ns, window.begin_ns, window.end_ns)
    row_ns = np.array([row.time_ns for row in evaluation.rows], dtype=np.int64)
    wrong_ns = row_ns[evaluation.confirmed_error_m > WRONG_M]
    return {
        "kind": window.kind,
        "begin_s": (window.begin_ns - start_ns) / _NS,
        "end_s": (window.end_ns - start_ns) / _NS,
        "named_by": first,
        "named_after_s": None if first is None else names[first],
        "fixed": int(acts.sum()),
        "wrong": int((acts & evaluation.fixes.wrong).sum()),
        "wrong_confirmed": int(_within(wrong_ns, window.begin_ns, window.end_ns).sum()),
        "wrong_confirmed_after": int(_within(wrong_ns, window.end_ns + 1, after_ns).sum()),
        "reported": reported,
        "correction_before_m": _correction_at(verdicts, window.begin_ns),
        "correction_at_end_m": _correction_at(verdicts, window.end_ns),
        "correction_after_m": _correction_at(verdicts, next_ns),
    }


def named_until_ns(window: FaultWindow, later: Iterable[FaultWindow], last_ns: int) -> int:
    """Until when a fault may be named: no longer than until one begins that the same indications would name.

    Another may begin while this one acts, too: a link is driven again, a second fault is at work on it.
    """
    names = NAMED_BY.get(window.kind, frozenset())
    rivals = (other.begin_ns for other in later if names & NAMED_BY.get(other.kind, frozenset()))
    most_ns = min(window.end_ns + round(AFTER_S * _NS), last_ns, next(rivals, last_ns + 1) - 1)
    return max(window.end_ns, most_ns)


def _of_surfaces_met(
    indications: Iterable[FaultIndication], window: FaultWindow, verdicts: Sequence[Recorded[Any]]
) -> list[FaultIndication]:
    """Without those of surfaces on which the fault was not met."""
    messages = (item.message for item in verdicts)
    met = {v.surface_id for v in messages if window.begin_ns <= v.time_ns <= window.end_ns} | {NO_SURFACE}
    return [indication for indication in indications if indication.surface_id in met]


def _within(time_ns: Int64, begin_ns: int, end_ns: int) -> Any:
    return (time_ns >= begin_ns) & (time_ns <= end_ns)


def _correction_at(verdicts: Sequence[Recorded[Any]], time_ns: int) -> float | None:
    """The correction in force: that of the last verdict before this time by which a height was judged."""
    judged = (v.message for v in verdicts if v.message.height_difference_m is not None)
    before = [verdict for verdict in judged if verdict.time_ns < time_ns]
    return before[-1].correction_m if before else None
