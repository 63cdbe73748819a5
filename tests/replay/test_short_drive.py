"""The drive that is made on the spot: the same by real processes at any speed and by one process, for several seeds."""

from pathlib import Path

import pytest

from camber.replay.short_drive import write_short_drive
from support.running import (
    Drive,
    assert_same_messages,
    figures,
    in_one_process,
    payloads,
    replayed,
    summary_of,
)

SPEEDS = ("max", "20")
SEEDS = (1, 2, 3)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def manifest(tmp_path_factory) -> Path:
    return write_short_drive(tmp_path_factory.mktemp("drive") / "drive", SEEDS[0])


@pytest.fixture(scope="module")
def outs(manifest, tmp_path_factory) -> dict[str, Path]:
    """By speed, what the real processes leave of the first seed's drive."""
    folder = tmp_path_factory.mktemp("replayed")
    options = ("--processes", "--speed")
    return {speed: replayed(manifest, folder / speed, *options, speed) for speed in SPEEDS}


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> dict[int, Drive]:
    """By seed, in one process."""
    folder = tmp_path_factory.mktemp("one-process")
    return {
        seed: in_one_process(write_short_drive(folder / f"{seed}" / "drive", seed), folder / f"{seed}")
        for seed in SEEDS
    }


@pytest.mark.parametrize("seed", SEEDS)
def test_no_wrong_fix_is_confirmed_and_nearly_all_right_ones_are(drives, seed):
    summary = drives[seed].summary
    assert summary["tentative"]["wrong"] > 50
    assert summary["confirmed"]["wrong"] == 0
    assert summary["right"]["kept"] >= 0.96


def test_speed_changes_no_figure(outs):
    assert figures(outs["max"]) == figures(outs["20"])


def test_speed_changes_no_byte_on_any_key(outs):
    fast, slow = payloads(outs["max"]), payloads(outs["20"])
    assert {key: len(row) for key, row in fast.items()} == {key: len(row) for key, row in slow.items()}
    for key, row in fast.items():
        assert row == slow[key], f"{key} differs"


def test_one_process_says_what_the_processes_of_a_replay_say(outs, drives):
    drive = drives[SEEDS[0]]
    verdicts = {item.message.verdict for item in drive.recorded["verdict"]}
    assert verdicts >= {"confirmed", "erroneous", "unknown"}
    assert_same_messages(outs["max"], drive)
    of_replay = summary_of(outs["max"])
    for name in ("tentative", "confirmed", "right", "episodes", "controls", "position", "verdicts"):
        assert drive.summary[name] == of_replay[name], name
