"""`camber evaluate DIR`: write summary.json and report.html of a run again from its recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from camber.formats.drive.recording import Recorded, load_recording
from camber.formats.errors import FormatError
from camber.replay.run_folder import DriveFacts, RunFolder
from camber.road_map.release import Release, ReleaseError, open_release
from camber.schemas.integrity import CONFIRMED_VERDICTS
from camber.validation.evaluation import Evaluation, evaluate
from camber.validation.report.chart_data import CHART_CHANNELS, chart_data
from camber.validation.report.page import render

_REASONS_SHOWN = 3  # chosen: a line


def evaluate_folder(
    folder: RunFolder,
    *,
    partial: bool = False,
    recorded: Mapping[str, Sequence[Recorded[Any]]] | None = None,
) -> Evaluation:
    """Evaluate the run in `folder` and write summary.json and report.html into it.

    `recorded`: the messages by channel (`CHART_CHANNELS`) as the recording has them, where they are still in memory.

    Raises ValueError where `recorded` lacks a channel, FormatError for anything missing or damaged; with `partial`, the
    readable part of a damaged recording is evaluated, and summary and report list the damage.
    """
    drive, run = folder.read_drive(), folder.read_run()
    truth = folder.read_truth() if drive.truth else None
    damage: list[str] = []
    if recorded is None:
        recorded, damage = _load(folder, partial)
    if missing := set(CHART_CHANNELS) - recorded.keys():
        raise ValueError(f"messages of {', '.join(sorted(missing))} were not kept")
    evaluation = evaluate(recorded, drive, run, truth, damage=damage)
    folder.write_summary(evaluation.summary)
    folder.write_report(render(evaluation, chart_data(recorded, drive, truth, _release(folder, drive))))
    return evaluation


def _release(folder: RunFolder, drive: DriveFacts) -> Release | None:
    """The map of the run; None where it had none, or where it is not there any more."""
    path = folder.map_release(drive)
    if path is None:
        return None
    with suppress(ReleaseError):
        return open_release(path)
    return None


def _load(folder: RunFolder, partial: bool) -> tuple[dict[str, list[Recorded[Any]]], list[str]]:
    path = folder.recording_path
    try:
        recorded, errors = load_recording(path, CHART_CHANNELS)
    except OSError as error:
        actual = error.strerror or str(error)
        raise FormatError(path.name, "file", "a readable recording", actual=actual) from None
    if errors and not partial:
        raise errors[0]
    return recorded, [str(error) for error in errors]


def main(argv: Sequence[str]) -> int:
    """The command; returns the exit code: 0, or 2 after one line on standard error."""
    parser = argparse.ArgumentParser(prog="camber evaluate", description=__doc__)
    parser.add_argument("directory", type=Path, help="folder of a replay or a recording")
    parser.add_argument(
        "--partial", action="store_true", help="evaluate the readable part of a damaged recording"
    )
    arguments = parser.parse_args(argv)
    folder = RunFolder(arguments.directory)
    try:
        summary = evaluate_folder(folder, partial=arguments.partial).summary
    except FormatError as error:
        print(f"camber evaluate: {folder.path}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"camber evaluate: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    for line in summary["damage"]:
        print(f"camber evaluate: only partly read: {line}", file=sys.stderr)
    print(headline(summary))
    print(folder.report_path)
    return 0


def headline(summary: dict[str, Any]) -> str:
    """The most important statistics as text for a terminal; those of the truth where there is one."""
    confirmed, right, episodes = summary["confirmed"], summary["right"], summary["episodes"]
    epochs, known = summary["epochs"], summary["truth"]
    fixes = f"{summary['tentative']['fixed']} fixes"
    fixes += f", {_text(summary['tentative']['wrong'])} of them wrong" if known else ""
    wrong = f", wrong among them {_text(confirmed['wrong'])}" if known else ""
    lines = [
        f"{summary['drive']}: {epochs} epochs, {fixes}",
        f"confirmed {confirmed['count']}{wrong}; unknown {summary['unknown']['count']}, "
        f"{summary['unknown']['of_fixed']} of them fixes; erroneous {summary['erroneous']['count']}",
    ]
    if known:
        lines.append(
            f"right fixes kept {_text(right['kept'], percent=True)}; "
            f"wrong episodes missed {_text(episodes['missed'])} of {_text(episodes['n'])}"
        )
    reasons = [
        f"{row['reason']} {row['count']}"
        for row in summary["verdicts"]["by_reason"]
        if row["verdict"] not in CONFIRMED_VERDICTS
    ]
    if reasons:
        lines.append(f"not confirmed, most often: {', '.join(reasons[:_REASONS_SHOWN])}")
    lines.append(f"position usable: {_text(summary['position']['usable'], percent=True)} of the epochs")
    lines += [f"surrogate: {text}" for text in summary["surrogates"]]
    return "\n".join(lines)


def _text(value: float | None, *, percent: bool = False) -> str:
    if value is None:
        return "not known"
    return f"{100 * value:.1f} %" if percent else str(value)
