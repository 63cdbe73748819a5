"""Evidence from the scenario `faults`: what was said during each fault and after it, and whether it was named."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.drive.recording import Recorded
from camber.formats.drive.truth_csv import WRONG_M, TruthTable
from camber.replay.drive_inputs import prepare_drive
from camber.replay.one_process import DriveOutput, replay_in_one_process
from camber.replay.run_folder import RunFacts, drive_facts
from camber.schemas.base import Int64
from camber.schemas.drive import load_manifest
from camber.simulator.scenario import load_scenario
from camber.tools.simulate import simulate
from camber.validation.evaluation import Evaluation, evaluate
from camber.validation.reference_trajectory import truth_of

AFTER_S = 15.0
"""A cause may be named so long after the fault's end, and not later: what lasts has ended."""
LASTING_S = 2.0
"""What was said so short a time before is not said anew: it names what there was before."""
_PREFIX = "fault_"
NO_SURFACE = -1
_SURFACE = re.compile(r"surface (\d+)")
_OF_LIDAR = ("blocked_lidar", "symmetric_scene")
_NS = 1e9

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
"""What names a fault: any one of these, begun to be said while it acts or within `AFTER_S`.

*Ambiguous* is the right word for a road where one vehicle sees no other before and after it. A road counts as named
where one of the surfaces is named on which the fault was met.
"""


@dataclass(frozen=True, slots=True)
class FaultWindow:
    """When a fault acts, GPS time; one that acts again on the same link has a window for each time."""

    kind: str
    begin_ns: int
    end_ns: int


def fault_windows(truth: TruthTable) -> list[FaultWindow]:
    """The faults of a simulated drive's truth, in the order of time."""
    found = []
    for name, column in truth.more.items():
        if not name.startswith(_PREFIX):
            continue
        acts = np.concatenate(([False], column > 0.0, [False]))
        edges = np.flatnonzero(np.diff(acts.astype(np.int8)))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            found.append(
                FaultWindow(
                    name.removeprefix(_PREFIX), int(truth.time_ns[begin]), int(truth.time_ns[end - 1])
                )
            )
    return sorted(found, key=lambda window: window.begin_ns)


@dataclass(frozen=True, slots=True, order=True)
class FaultIndication:
    """A word, and the surface of which it was said where it was said of one."""

    time_ns: int
    text: str
    surface_id: int = NO_SURFACE


def indications_of(driven: DriveOutput) -> list[FaultIndication]:
    """All that may name a fault: words of verdicts, causes, matches, antenna heights, poses, issues."""
    said: list[FaultIndication] = []
    for item in driven.recorded.get("verdict", ()):
        said.append(FaultIndication(item.message.time_ns, f"verdict {item.message.reason}"))
        if item.message.cause == "road":
            said.append(FaultIndication(item.message.time_ns, "cause road", item.message.surface_id))
        elif item.message.cause != "none":
            said.append(FaultIndication(item.message.time_ns, f"cause {item.message.cause}"))
    for item in driven.recorded.get("scan_match", ()):
        if item.message.status != "converged":
            said.append(FaultIndication(item.message.time_ns, f"match {item.message.status}"))
    for item in driven.recorded.get("antenna_height", ()):
        if item.message.status != "known":
            said.append(FaultIndication(item.message.time_ns, f"antenna_height {item.message.status}"))
    for item in driven.recorded.get("pose", ()):
        reasons = item.message.reason.split("; ")
        said += [FaultIndication(item.message.time_ns, f"pose: {text}") for text in reasons if text]
    for issue in driven.issues:
        named = _SURFACE.search(issue.text) if issue.code == "road_changed" else None
        surface_id = NO_SURFACE if named is None else int(named[1])
        said.append(FaultIndication(issue.time_ns, f"{issue.service} {issue.code}", surface_id))
    return sorted(said)


def during(said: Iterable[FaultIndication], begin_ns: int, end_ns: int) -> dict[str, dict[str, float]]:
    """What was said from one time to another: how often, and how long after the first time it first began [s].

    Without `begun_s` it was said before already, and never began anew. `said` is in the order of time.
    """
    counts: Counter[str] = Counter()
    begun: dict[str, float] = {}
    last: dict[str, int] = {}
    for word in said:
        time_ns, text = word.time_ns, word.text
        if begin_ns <= time_ns <= end_ns:
            counts[text] += 1
            if text not in last or time_ns - last[text] > LASTING_S * _NS:
                begun.setdefault(text, (time_ns - begin_ns) / _NS)
        last[text] = time_ns
    return {
        text: {"count": count} | ({"begun_s": begun[text]} if text in begun else {})
        for text, count in counts.most_common()
    }


def run_faults(
    folder: Path,
    *,
    seed: int,
    scenario: str = "faults",
    overrides: Sequence[str] = (),
    positions: str = "receiver",
    lidar: bool = True,
) -> dict[str, Any]:
    """Simulate the scenario, send it through one process; a row for each fault.

    Without `lidar` the vehicle has none, and the faults that concern it are left out: minutes instead of an hour.
    """
    made = load_scenario(scenario, [*overrides, f"seed={seed}"])
    if not lidar:
        there = tuple(fault for fault in made.faults if fault.kind not in _OF_LIDAR)
        made = made.model_copy(update={"lidar": None, "faults": there})
    drive = load_manifest(simulate(made, folder / "drive", quiet=True), [f'positions="{positions}"'])
    inputs = prepare_drive(drive, folder / "work")
    driven = replay_in_one_process(inputs, folder)
    truth = inputs.truth
    assert truth is not None  # a simulated drive has one
    evaluation = evaluate(driven.recorded, drive_facts(inputs), RunFacts(), truth_of(truth))
    said, start_ns = indications_of(driven), inputs.tick_times_ns[0]
    windows = fault_windows(truth)
    last_ns = int(truth.time_ns[-1])
    rows = [
        _row(window, windows[number + 1 :], last_ns, said, evaluation, driven.recorded["verdict"], start_ns)
        for number, window in enumerate(windows)
    ]
    return {
        "scenario": scenario,
        "seed": seed,
        "overrides": list(overrides),
        "positions": positions,
        "sweeps": len(inputs.sweeps),
        "faults": rows,
        "confirmed_wrong": evaluation.summary["confirmed"]["wrong"],
        "wrong": evaluation.summary["tentative"]["wrong"],
        "right": evaluation.summary["right"]["count"],
        "right_kept": evaluation.summary["right"]["kept"],
    }


def _row(
    window: FaultWindow,
    later: Sequence[FaultWindow],
    last_ns: int,
    said: Sequence[FaultIndication],
    evaluation: Evaluation,
    verdicts: Sequence[Recorded[Any]],
    start_ns: int,
) -> dict[str, Any]:
    next_ns = later[0].begin_ns if later else last_ns + 1
    end_ns = named_until_ns(window, later, last_ns)
    after_ns = max(window.end_ns, min(end_ns, next_ns - 1))
    heard = during(_of_here(said, window, verdicts), window.begin_ns, end_ns)
    begun_s = {text: found["begun_s"] for text, found in heard.items() if "begun_s" in found}
    names = {text: after_s for text, after_s in begun_s.items() if text in NAMED_BY.get(window.kind, ())}
    first = min(names, key=lambda text: names[text], default=None)
    acts = _within(evaluation.fixes.time_ns, window.begin_ns, window.end_ns)
    wrong = np.array([row.time_ns for row in evaluation.rows], dtype=np.int64)[
        evaluation.confirmed_error_m > WRONG_M
    ]
    return {
        "kind": window.kind,
        "begin_s": (window.begin_ns - start_ns) / _NS,
        "end_s": (window.end_ns - start_ns) / _NS,
        "named_by": first,
        "named_after_s": None if first is None else names[first],
        "fixed": int(acts.sum()),
        "wrong": int((acts & evaluation.fixes.wrong).sum()),
        "wrong_confirmed": int(_within(wrong, window.begin_ns, window.end_ns).sum()),
        "wrong_confirmed_after": int(_within(wrong, window.end_ns + 1, after_ns).sum()),
        "said": heard,
        "correction_before_m": _correction_at(verdicts, window.begin_ns),
        "correction_at_end_m": _correction_at(verdicts, window.end_ns),
        "correction_after_m": _correction_at(verdicts, next_ns),
    }


def named_until_ns(window: FaultWindow, later: Iterable[FaultWindow], last_ns: int) -> int:
    """Until when a fault may be named: no longer than until one begins that the same words would name.

    Another may begin while this one acts, too: a link is driven again, a second fault is at work on it.
    """
    words = NAMED_BY.get(window.kind, frozenset())
    rivals = (other.begin_ns for other in later if words & NAMED_BY.get(other.kind, frozenset()))
    most_ns = min(window.end_ns + round(AFTER_S * _NS), last_ns, next(rivals, last_ns + 1) - 1)
    return max(window.end_ns, most_ns)


def _of_here(
    said: Iterable[FaultIndication], window: FaultWindow, verdicts: Sequence[Recorded[Any]]
) -> list[FaultIndication]:
    """Without what was said of surfaces on which the fault was not met."""
    here = {NO_SURFACE} | {
        item.message.surface_id
        for item in verdicts
        if window.begin_ns <= item.message.time_ns <= window.end_ns
    }
    return [word for word in said if word.surface_id in here]


def _within(time_ns: Int64, begin_ns: int, end_ns: int) -> Any:
    return (time_ns >= begin_ns) & (time_ns <= end_ns)


def _correction_at(verdicts: Sequence[Recorded[Any]], time_ns: int) -> float | None:
    """The correction in force: that of the last verdict before this time by which a height was judged."""
    judged = (v.message for v in verdicts if v.message.height_difference_m is not None)
    before = [verdict for verdict in judged if verdict.time_ns < time_ns]
    return before[-1].correction_m if before else None
