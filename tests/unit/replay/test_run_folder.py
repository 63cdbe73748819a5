"""The files of a run: written whole, read again, refused in one line."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.replay.run_folder import DriveFacts, RunFacts, RunFolder
from camber.validation.reference_trajectory import ReferenceTrajectory

NS = 1_373_000_000_000_000_000
FACTS = DriveFacts(
    drive="a drive", surrogates=("map: made", "wheels: made"), truth=True, offset_enu_m=(0.1, 0.2, -0.3),
    alert_limit_m=1.5, fixed_tolerance_m=0.25,
)  # fmt: skip
TRUTH = ReferenceTrajectory(
    time_ns=np.array([NS, NS + 1], dtype=np.int64),
    latitude_rad=np.array([0.6, 0.61]),
    longitude_rad=np.array([2.3, 2.31]),
    height_m=np.array([40.0, 41.0]),
)


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "new" / "run")
    run = RunFacts(speed_factor=51.5, wall_s=24.0, notes=("the disk was full",))
    folder.write_drive(FACTS, TRUTH)
    folder.write_run(run)
    truth = folder.read_truth()
    assert folder.read_drive() == FACTS
    assert folder.read_run() == run
    for name in ("time_ns", "latitude_rad", "longitude_rad", "height_m"):
        assert getattr(truth, name).tolist() == getattr(TRUTH, name).tolist()
    assert sorted(path.name for path in folder.path.iterdir()) == ["drive.json", "run.json", "truth.npz"]


def test_a_run_that_was_no_replay_has_no_speed(tmp_path: Path) -> None:
    assert RunFolder(tmp_path).read_run() == RunFacts(speed_factor=None, wall_s=None)


@pytest.mark.parametrize("truth", [None, TRUTH])
def test_facts_and_truth_must_agree(tmp_path: Path, truth: ReferenceTrajectory | None) -> None:
    facts = FACTS.model_copy(update={"truth": truth is None})
    with pytest.raises(ValueError, match="truth is"):
        RunFolder(tmp_path).write_drive(facts, truth)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("{", "file"),
        ("[]", "file"),
        ('{"truth": false}', "drive"),
        ('{"drive": "a", "truth": "yes"}', "truth"),
        ('{"drive": "a", "truth": false, "alert_limit_m": -1}', "alert_limit_m"),
        ('{"drive": "a", "truth": false, "offset_enu_m": [1, NaN, 2]}', "offset_enu_m"),
        ('{"drive": "a", "truth": false, "surplus": 1}', "surplus"),
    ],
)
def test_a_damaged_drive_is_one_line_that_names_file_and_field(tmp_path: Path, text: str, field: str) -> None:
    (tmp_path / "drive.json").write_text(text)
    with pytest.raises(FormatError) as caught:
        RunFolder(tmp_path).read_drive()
    assert str(caught.value).startswith("drive.json: " + field)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"^drive\.json: file is 'No such file or directory', expected"):
        RunFolder(tmp_path).read_drive()
    with pytest.raises(FormatError, match=r"^truth\.npz: file is 'No such file"):
        RunFolder(tmp_path).read_truth()


def test_a_truth_cut_short_is_refused(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.write_drive(FACTS, TRUTH)
    data = folder.truth_path.read_bytes()
    for length in range(0, len(data), 37):
        folder.truth_path.write_bytes(data[:length])
        with pytest.raises(FormatError, match=r"^truth\.npz: "):
            folder.read_truth()


def test_damaged_bytes_of_a_truth_are_refused_or_change_nothing(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.write_drive(FACTS, TRUTH)
    data = folder.truth_path.read_bytes()
    rng = random.Random(11)
    refused = 0
    for _ in range(200):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] = rng.randrange(256)
        folder.truth_path.write_bytes(damaged)
        try:
            truth = folder.read_truth()
        except FormatError:
            refused += 1
        else:
            assert truth.height_m.tolist() == TRUTH.height_m.tolist()
    assert refused > 50


def test_a_single_array_is_no_truth(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    with folder.truth_path.open("wb") as file:
        np.save(file, TRUTH.height_m)
    with pytest.raises(FormatError, match=r"^truth\.npz: arrays"):
        folder.read_truth()


def test_a_truth_of_other_arrays_or_of_objects_is_refused(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    np.savez(folder.truth_path, time_ns=TRUTH.time_ns)
    with pytest.raises(FormatError, match="expected time_ns, latitude_rad"):
        folder.read_truth()
    # Unpickling would run whatever the file says.
    np.savez(folder.truth_path, time_ns=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FormatError, match=r"^truth\.npz: arrays"):
        folder.read_truth()
