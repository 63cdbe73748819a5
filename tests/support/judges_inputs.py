"""Inputs of a judge on the short drive, and the parts of its verdicts that do not depend on when they were given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from camber.replay.drive_inputs import prepare_drive
from camber.replay.short_drive import write_short_drive
from camber.replay.single_process_replay import replay_in_one_process
from camber.schemas.drive import load_manifest
from camber.schemas.integrity import Verdict

AFTER_S = {"motion": 0.001, "antenna_height": 0.002, "fix": 0.004, "velocity": 0.005, "pose": 0.006}
"""How long after the time of measurement each is sent."""


def recorded_inputs(folder: Path, duration_s: float) -> list[tuple[float, str, Any]]:
    """Inputs of a judge in the first seconds of the short drive, with the seconds at which they are sent."""
    manifest = load_manifest(write_short_drive(folder / "drive"), [f"end_s={duration_s}"])
    inputs = prepare_drive(manifest, folder / "drive")
    driven = replay_in_one_process(inputs, folder, channels=tuple(AFTER_S))
    messages = [(item.message, name) for name in AFTER_S for item in driven.recorded.get(name, [])]
    first_ns = min(message.time_ns for message, _ in messages)
    return sorted(
        (((message.time_ns - first_ns) / 1e9 + AFTER_S[name], name, message) for message, name in messages),
        key=lambda one: one[0],
    )


def outcome(verdict: Verdict) -> dict[str, Any]:
    """All of a verdict but its time."""
    return {name: value for name, value in verdict.model_dump().items() if name != "time_ns"}
