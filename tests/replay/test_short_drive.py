"""The drive that is made on the spot, through the real processes: the same at any speed, for several seeds."""

from pathlib import Path

import pytest

from camber.simulator.short_drive import write_short_drive
from support.running import camber, figures, payloads, summary_of

SPEEDS = ("max", "20")
SEEDS = (1, 2, 3)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=SEEDS)
def outs(request, tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp(f"seed-{request.param}")
    drive = write_short_drive(folder / "drive", request.param)
    for speed in SPEEDS:
        done = camber("replay", drive, "--speed", speed, "--out", folder / speed, "--quiet", timeout_s=120.0)
        assert done.returncode == 0, done.stderr
    return {speed: folder / speed for speed in SPEEDS}


def test_no_wrong_fix_is_confirmed_and_nearly_all_right_ones_are(outs):
    summary = summary_of(outs["max"])
    assert summary["tentative"]["wrong"] > 50
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] >= 0.96


def test_speed_changes_no_figure(outs):
    assert figures(outs["max"]) == figures(outs["20"])


def test_speed_changes_no_byte_on_any_key(outs):
    fast, slow = payloads(outs["max"]), payloads(outs["20"])
    assert {key: len(found) for key, found in fast.items()} == {
        key: len(found) for key, found in slow.items()
    }
    for key, found in fast.items():
        assert found == slow[key], f"{key} differs"
