"""A recorded drive through all services, in this process."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.api.columns import Columns
from camber.replay.drive_inputs import prepare_drive
from camber.replay.single_process_replay import ReportedIssue, replay_in_one_process
from camber.schemas.antenna import AntennaHeight
from camber.schemas.base import Message
from camber.schemas.channels import inputs_of
from camber.schemas.drive import load_manifest
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.pose import Pose

_KINDS: dict[str, type[Message]] = {
    "verdict": Verdict,
    "position": Position,
    "fix": Fix,
    "pose": Pose,
    "antenna_height": AntennaHeight,
}
_ALL = (*_KINDS, *(channel.name for channel in inputs_of("integrity") if channel.name not in _KINDS))


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayResult:
    """What the services have published, one row a message in the order of publishing, and the issues they reported."""

    verdicts: Columns
    positions: Columns
    fixes: Columns
    poses: Columns
    antenna_heights: Columns
    issues: tuple[ReportedIssue, ...]
    notes: tuple[str, ...]
    messages: Mapping[str, Sequence[Message]]
    """The messages themselves by channel, with all that the judge has taken."""


def replay_drive(
    drive: Path | str,
    *,
    overrides: Sequence[str] = (),
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> ReplayResult:
    """Run the drive of a manifest (docs/drive.md) as `camber replay` does, but write nothing.

    `overrides` of the manifest are texts KEY=VALUE, `settings` of services are added to those of the drive, by service.
    Raises ManifestError for a manifest that cannot be used, FormatError for a file, OSError for one that cannot be
    opened.
    """
    manifest = load_manifest(Path(drive), list(overrides))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = prepare_drive(manifest, folder / "work")
        output = replay_in_one_process(inputs, folder, settings=settings, channels=_ALL)
    messages = {channel: [item.message for item in output.recorded[channel]] for channel in _ALL}
    columns = {channel: Columns.of_messages(kind, messages[channel]) for channel, kind in _KINDS.items()}
    return ReplayResult(
        verdicts=columns["verdict"],
        positions=columns["position"],
        fixes=columns["fix"],
        poses=columns["pose"],
        antenna_heights=columns["antenna_height"],
        issues=tuple(output.issues),
        notes=output.notes,
        messages=messages,
    )
