"""The recorded drive through the real processes: its figures, and the same bytes twice."""

import os
from pathlib import Path

import pytest

from camber.schemas.drive import load_manifest
from support.running import camber, figures, payloads, summary_of

DRIVE = Path(__file__).with_name("nagoya.toml")
TIMEOUT_S = 400.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not os.environ.get("CAMBER_DATA"), reason="CAMBER_DATA is not set: no recordings, nothing is replayed"
    ),
]


@pytest.fixture(scope="module")
def twice(tmp_path_factory) -> tuple[Path, Path]:
    outs = tuple(tmp_path_factory.mktemp("nagoya") / name for name in ("first", "second"))
    for out in outs:
        done = camber(
            "replay", DRIVE, "--speed", "max", "--seed", 1, "--out", out, "--quiet", timeout_s=TIMEOUT_S
        )
        assert done.returncode == 0, done.stderr
    return outs


def test_no_wrong_fix_is_confirmed_and_nearly_all_right_ones_are(twice):
    summary = summary_of(twice[0])
    assert summary["tentative"]["fixed"] == 1799
    assert summary["tentative"]["wrong"] == 114
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] >= 0.96
    assert summary["notes"] == summary["damage"] == []


def test_what_was_made_up_is_named_beside_the_figures(twice):
    made_up = load_manifest(DRIVE).surrogates.inputs
    assert {"wheel_speed", "yaw_rate", "links", "road_surfaces"} <= set(made_up)
    for name in made_up:
        assert any(name in line for line in summary_of(twice[0])["surrogates"])


def test_the_same_drive_gives_the_same_figures(twice):
    first, second = map(figures, twice)
    assert first == second


def test_the_same_drive_gives_the_same_bytes_on_every_key(twice):
    first, second = map(payloads, twice)
    assert {key: len(found) for key, found in first.items()} == {
        key: len(found) for key, found in second.items()
    }
    for key, found in first.items():
        assert found == second[key], f"{key} differs"
