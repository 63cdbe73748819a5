"""One drive through all services in one process, and its evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.formats.drive.truth_csv import TruthTable
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.replay.run_folder import RunFacts, drive_facts
from camber.replay.single_process_replay import DriveOutput, replay_in_one_process
from camber.schemas.drive import DriveManifest
from camber.validation.evaluation import Evaluation, evaluate
from camber.validation.reference_trajectory import truth_of


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluatedDrive:
    """Inputs with their truth, all published messages, and the statistics."""

    inputs: DriveInputs
    truth: TruthTable
    output: DriveOutput
    evaluation: Evaluation


def evaluate_drive(
    manifest: DriveManifest, folder: Path, settings: Mapping[str, Mapping[str, Any]] | None = None
) -> EvaluatedDrive:
    """Run a drive that has a truth; `settings` are added to those of the drive, by service."""
    inputs = prepare_drive(manifest, folder / "work")
    output = replay_in_one_process(inputs, folder, settings=settings)
    truth = inputs.truth
    assert truth is not None
    evaluation = evaluate(output.recorded, drive_facts(inputs), RunFacts(), truth_of(truth))
    return EvaluatedDrive(inputs=inputs, truth=truth, output=output, evaluation=evaluation)
