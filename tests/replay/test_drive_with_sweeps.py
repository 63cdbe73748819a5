"""Sweeps go through a replay like all else: every one is waited for, a damaged one costs itself, none is recorded."""

from pathlib import Path

import numpy as np
import pytest

from camber.formats.map_exchange.pcd import write_sweep
from camber.replay.short_drive import START_NS, write_short_drive
from camber.schemas.lidar import Sweep
from support.running import camber, in_one_process, recorded

DURATION_S = 8.0
_PERIOD_NS = 100_000_000
_POINTS = 20_000


END = f"end_s={DURATION_S}"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("swept")
    manifest = write_short_drive(folder / "drive")
    (folder / "drive" / "sweeps").mkdir()
    rng = np.random.default_rng(1)
    for k in range(1, 81):
        sweep = Sweep(
            time_ns=START_NS + k * _PERIOD_NS,
            sensor="lidar",
            points_m=rng.normal(0.0, 20.0, (_POINTS, 3)).astype(np.float32),
            intensity=np.ones(_POINTS, np.float32),
            offset_ns=np.zeros(_POINTS, np.int32),
        )
        path = write_sweep(folder / "drive" / "sweeps", sweep)
    path.write_bytes(path.read_bytes()[:1000])
    manifest.write_text(manifest.read_text() + '\n[sweeps]\nfolder = "sweeps"\n')
    out = folder / "out"
    done = camber("replay", manifest, "--processes", "--out", out, "--set", END, timeout_s=120.0)
    assert done.returncode == 0, done.stderr
    (out / "stderr.txt").write_text(done.stderr)
    return out


def test_a_damaged_sweep_is_named_in_one_line_and_in_the_run(out: Path) -> None:
    (line,) = [line for line in (out / "stderr.txt").read_text().splitlines() if "sweep could" in line]
    assert "1 sweep could not be read and left out, the first: " in line
    assert "1 sweep could not be read" in (out / "run.json").read_text()


def test_sweeps_are_not_in_the_recording_and_all_else_is(out: Path) -> None:
    messages = recorded(out)
    assert messages["sweep"] == []
    assert len(messages["motion"]) == 5 * DURATION_S + 1
    assert (out / "recording.mcap").stat().st_size < 1_000_000


def test_sweeps_that_show_nothing_change_no_verdict(out: Path, tmp_path: Path) -> None:
    without = in_one_process(write_short_drive(tmp_path / "drive"), tmp_path, END).recorded["verdict"]
    assert len(without) > 30
    # Noise fits no map, and this map has no clouds either; the verdicts are the same.
    assert [item.message for item in recorded(out)["verdict"]] == [item.message for item in without]
