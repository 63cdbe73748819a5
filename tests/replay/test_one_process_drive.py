"""A drive in one process says, message for message, what the real processes say in a replay."""

from pathlib import Path

import pytest

from camber.schemas.codec import encode
from camber.schemas.drive import load_manifest
from camber.simulator.drive_inputs import prepare_drive
from camber.simulator.short_drive import write_short_drive
from camber.tools.evaluation import CHANNELS
from camber.tools.one_process import drive_through
from support.running import camber, recorded

pytestmark = pytest.mark.slow

END = "end_s=40.0"  # starts wrong, stands, drives, loses its fixes and comes back with wrong ones


def test_one_process_says_what_the_processes_of_a_replay_say(tmp_path: Path) -> None:
    drive, out = write_short_drive(tmp_path / "drive", 2), tmp_path / "replay"
    done = camber("replay", drive, "--set", END, "--out", out, "--quiet", timeout_s=120.0)
    assert done.returncode == 0, done.stderr
    expected = recorded(out)

    inputs = prepare_drive(load_manifest(drive, [END]), tmp_path / "work")
    said = drive_through(inputs, tmp_path).recorded

    def bytes_of(messages) -> list[bytes]:
        return sorted(encode(item.message, source="", sequence=0) for item in messages)

    assert {item.message.verdict for item in said["verdict"]} >= {"confirmed", "erroneous", "unknown"}
    for name in CHANNELS:
        assert bytes_of(said[name]) == bytes_of(expected.get(name, ())), name
