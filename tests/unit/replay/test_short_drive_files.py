"""The simulated drive has what it promises, and is the same bytes for the same seed."""

import math
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.truth_csv import FIX_STATES, read_truth
from camber.formats.receiver.solution import ReceiverSolution
from camber.replay.drive_inputs import prepare_drive
from camber.replay.short_drive import SCHEDULE, START_NS, short_drive_truth, write_short_drive, wrong_episodes
from camber.replay.truth_interpolation import plane_of
from camber.road_map.release import read_release
from camber.schemas.drive import load_manifest
from support.gnss_files import read_pos


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def errors_of_fixes(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quality, 3D error (n, 3) and whether made wrong (n,) of the receiver's solutions against truth.csv."""
    truth = read_truth(folder / "truth.csv", "camber")
    solutions = [s for s in read_pos(folder / "receiver.pos") if isinstance(s, ReceiverSolution)]
    rows = np.searchsorted(truth.time_ns, [s.time_ns for s in solutions])
    frame = plane_of(truth)
    places = [(s.latitude_rad, s.longitude_rad, s.height_m) for s in solutions]
    there = frame.east_north_from_geodetic_array(*np.transpose(places))
    real = frame.east_north_from_geodetic_array(
        truth.latitude_rad[rows], truth.longitude_rad[rows], truth.height_m[rows]
    )
    up = np.array([s.height_m for s in solutions]) - truth.height_m[rows]
    wrong = truth.fix_state[rows] == FIX_STATES.index("wrong")
    return np.array([s.quality for s in solutions]), np.column_stack((there - real, up)), wrong


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "abc"]
    for folder, seed in zip(folders, (1, 1, 2), strict=True):
        assert write_short_drive(folder, seed) == folder / "drive.toml"
    first, second, third = (files_of(folder) for folder in folders)
    assert first == second
    assert first["truth.csv"] == third["truth.csv"]
    assert first["receiver.pos"] != third["receiver.pos"]
    assert first["map/root.msgpack"] != third["map/root.msgpack"]


@pytest.mark.parametrize("seed", range(5))
def test_wrong_fixes_are_those_that_truth_flags_and_nothing_else(tmp_path: Path, seed: int) -> None:
    write_short_drive(tmp_path, seed)
    quality, error, wrong = errors_of_fixes(tmp_path)
    assert (quality[wrong] == 1).all()
    assert np.abs(error[wrong, 2]).min() > 0.25  # at least 0.35 m, and 2 cm of noise
    right = (quality == 1) & ~wrong
    assert np.linalg.norm(error[right], axis=1).max() < 0.12
    assert np.std(error[right, 2]) == pytest.approx(0.02, rel=0.5)
    assert right.sum() > 2 * wrong.sum() > 100


def test_there_are_six_wrong_episodes_or_more_also_at_the_start_standing_and_after_a_gap() -> None:
    truth = short_drive_truth()
    speed = np.hypot(truth.velocity_enu_m_s[:, 0], truth.velocity_enu_m_s[:, 1])
    episodes = wrong_episodes(1)
    assert len(episodes) >= 6
    assert episodes[0].from_s == 0.0
    standing = [e for e in episodes if speed[round(5 * e.from_s)] == 0.0 and e.from_s > 10.0]
    assert standing
    ends_of_gaps = {end for _, end, state in SCHEDULE if state == "none"}
    assert any(e.from_s in ends_of_gaps for e in episodes)
    for seed in range(20):
        for episode in wrong_episodes(seed):
            assert abs(episode.offset_enu_m[2]) >= 0.35
            assert math.hypot(*episode.offset_enu_m) <= 5.0


def test_the_vehicle_stops_climbs_and_comes_back_to_the_ground() -> None:
    truth = short_drive_truth()
    speed = np.hypot(truth.velocity_enu_m_s[:, 0], truth.velocity_enu_m_s[:, 1])
    assert (speed[5 * 48 : 5 * 55] == 0.0).all()
    assert np.ptp(truth.height_m) == pytest.approx(7.0, abs=0.01)
    assert truth.height_m[-1] == pytest.approx(truth.height_m[0], abs=1e-6)
    plane = plane_of(truth).east_north_from_geodetic_array(
        truth.latitude_rad, truth.longitude_rad, truth.height_m
    )
    step = np.diff(plane, axis=0) / 0.2
    np.testing.assert_allclose(
        step, 0.5 * (truth.velocity_enu_m_s[1:, :2] + truth.velocity_enu_m_s[:-1, :2]), atol=0.15
    )


def test_its_manifest_is_read_as_a_simulated_drive_without_surrogates(tmp_path: Path) -> None:
    manifest = load_manifest(write_short_drive(tmp_path / "drive"), environ={})
    assert manifest.summary()["simulated"] is True
    assert manifest.surrogates.inputs == ()
    inputs = prepare_drive(manifest, tmp_path / "work")
    assert inputs.tick_times_ns == tuple(START_NS + k * 200_000_000 for k in range(601))
    assert (len(inputs.motion), len(inputs.receiver)) == (601, 601 - 30)
    assert inputs.initial_pose is not None
    release = read_release(inputs.map_release)
    assert release.manifest.surrogate.startswith("simulated")
    assert set(release.road_surfaces().level.tolist()) == {0, 1}
    assert not (tmp_path / "work").exists()
