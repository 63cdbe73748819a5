"""The services in one process: who is killed is missing for a while, and settings reach their service."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.replay.short_drive import START_NS, write_short_drive
from camber.replay.single_process_replay import RESTART_S, replay_in_one_process
from camber.schemas.drive import load_manifest


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    return write_short_drive(tmp_path_factory.mktemp("drive") / "short", 1)


def inputs_of(drive: Path, *overrides: str) -> DriveInputs:
    return prepare_drive(load_manifest(drive, ["end_s=20.0", *overrides]), drive.parent)


def test_a_service_that_is_killed_is_missing_until_it_has_started_again(drive: Path) -> None:
    inputs = inputs_of(drive, 'kills=[{service="localizer", at_s=15.0}]')
    driven = replay_in_one_process(inputs, drive.parent)
    poses_s = [(item.message.time_ns - START_NS) / 1e9 for item in driven.recorded["pose"]]
    assert not [t for t in poses_s if 15.0 <= t < 15.0 + RESTART_S]
    assert [t for t in poses_s if t >= 15.0 + RESTART_S]
    silent = [
        item.message for item in driven.recorded["verdict"] if item.message.reason == "localizer_absent"
    ]
    assert silent
    killed = [issue for issue in driven.issues if issue.code == "killed"]
    assert [(issue.service, (issue.time_ns - START_NS) / 1e9) for issue in killed] == [("localizer", 15.0)]


def test_settings_of_a_service_are_added_to_those_of_the_drive(drive: Path) -> None:
    fixed = replay_in_one_process(
        inputs_of(drive), drive.parent, settings={"antenna_height": {"fixed_height_m": 9.0}}
    )
    verdicts = {item.message.verdict for item in fixed.recorded["verdict"]}
    assert not verdicts & {"confirmed", "confirmed_after_verification"}


def without(drive: Path, *tables: str) -> Path:
    """The manifest of a drive without some of its tables."""
    kept = [table for table in drive.read_text().split("\n[") if not table.startswith(tables)]
    path = drive.with_name(f"without-{'-'.join(tables)}.toml")
    path.write_text("\n[".join(kept))
    return path


def test_a_drive_without_antenna_height_confirms_nothing_and_reports_why(drive: Path) -> None:
    inputs = inputs_of(without(drive, "antenna_height]"))
    driven = replay_in_one_process(inputs, drive.parent)
    assert {item.message.verdict for item in driven.recorded["verdict"]} <= {"unknown", "erroneous"}
    assert "height_unknown" in {issue.code for issue in driven.issues}


def test_a_drive_without_receiver_is_localized(drive: Path) -> None:
    inputs = inputs_of(without(drive, "antenna_height]", "receiver]"))
    driven = replay_in_one_process(inputs, drive.parent)
    assert driven.recorded["fix"] == []
    assert {item.message.mode for item in driven.recorded["pose"]} == {"dead_reckoning"}


def test_only_the_channels_asked_for_are_kept(drive: Path) -> None:
    assert set(replay_in_one_process(inputs_of(drive), drive.parent, channels=("pose",)).recorded) == {"pose"}
