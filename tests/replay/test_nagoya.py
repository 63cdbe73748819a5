"""The recorded drive through the real processes: its figures; and one process says the same, message for message."""

import os
from pathlib import Path

import pytest

from camber.schemas.drive import load_manifest
from support.running import assert_same_messages, in_one_process, replayed, summary_of

DRIVE = Path(__file__).with_name("nagoya.toml")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not os.environ.get("CAMBER_DATA"), reason="CAMBER_DATA is not set: no recordings, nothing is replayed"
    ),
]


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("nagoya")
    return replayed(DRIVE, out, "--processes", "--seed", 1, timeout_s=400.0)


def test_no_wrong_fix_is_confirmed_and_nearly_all_right_ones_are(out):
    summary = summary_of(out)
    assert summary["tentative"]["fixed"] == 1799
    assert summary["tentative"]["wrong"] == 114
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] >= 0.96
    assert summary["notes"] == summary["damage"] == []


def test_synthesised_inputs_are_named_with_the_figures(out):
    made_up = load_manifest(DRIVE).surrogates.inputs
    assert {"wheel_speed", "yaw_rate", "links", "road_surfaces"} <= set(made_up)
    for name in made_up:
        assert any(name in line for line in summary_of(out)["surrogates"])


def test_verdicts_depend_on_the_drive_and_not_on_the_processes(out, tmp_path):
    """No bus, no other process, no waiting: none of these has a part in any message."""
    drive = in_one_process(DRIVE, tmp_path, "surrogates.seed=1")
    assert len(drive.recorded["verdict"]) > 6000
    assert_same_messages(out, drive)
