"""A drive that went through a ROS bag gets the verdicts of the drive folder, but for what ROS messages do not carry.

They carry no steering angle, pitch and roll of a vehicle, no stroke and ranging, no age of corrections and ratio, and
neither map, truth, start nor antenna height; receivers' times of arrival are not taken, and a sweep ends with its last
measured point. The other drive is without those, too.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.motion_csv import read_samples, write_samples
from camber.formats.map_exchange.pcd import write_sweep
from camber.replay.short_drive import write_short_drive
from camber.replay.sweep_files import sweep_files
from camber.schemas.motion import Motion
from camber.simulator.scenario import load_scenario
from camber.tools.bags.import_command import import_bag
from camber.tools.bags.topic_choice import TopicNames
from camber.tools.simulate import simulate
from support.ros_bags import BagKind, write_drive_bag
from support.running import in_one_process

_NOT_IN_ROS = ("map]", "truth]", "initial_pose]", "antenna_height]", "surrogates]")


def tables(manifest: Path) -> list[str]:
    return manifest.read_text().split("\n[")


def through_a_bag(manifest: Path, folder: Path, kind: BagKind) -> Path:
    """The manifest of the drive after its way through a bag, with what people add to it."""
    bag = write_drive_bag(manifest, folder / ("drive.bag" if kind == "ros1" else "bag"), kind)
    import_bag([bag], folder / "imported", TopicNames())
    imported = folder / "imported" / "drive.toml"
    added = [table for table in tables(manifest) if table.startswith(_NOT_IN_ROS)]
    texts = [table.replace(' = "', f' = "{manifest.parent}/', 1) for table in added if '"map"' in table]
    texts += [table.replace('file = "', f'file = "{manifest.parent}/') for table in added if "truth" in table]
    texts += [table for table in added if table.startswith(_NOT_IN_ROS[2:])]
    imported.write_text("\n[".join([imported.read_text(), *texts]))
    return imported


def without_what_ros_has_not(manifest: Path) -> Path:
    """The drive with fixed antenna height, without steering and tilt, arrivals, and the sensors of the suspension."""
    assert (manifest.parent / "motion.csv").exists()
    samples = read_samples(manifest.parent / "motion.csv", Motion)
    missing = dict.fromkeys(("steering_angle_rad", "pitch_rad", "roll_rad"))
    write_samples(manifest.parent / "motion.csv", Motion, [one.model_copy(update=missing) for one in samples])
    for file in sweep_files(manifest.parent / "sweeps")[0]:
        sweep = file.read()
        late_ns = int(sweep.offset_ns.max())
        file.path.unlink()
        changes = {"time_ns": sweep.time_ns + late_ns, "offset_ns": sweep.offset_ns - np.int32(late_ns)}
        write_sweep(manifest.parent / "sweeps", sweep.model_copy(update=changes))
    kept = [
        table.replace('way = "stroke"', 'way = "fixed"')
        for table in tables(manifest)
        if not table.startswith(("suspension]", "ranging]", "observations]"))
    ]
    lines = [line for table in "\n[".join(kept).split("\n") for line in [table] if "arrivals" not in line]
    path = manifest.with_name("less.toml")
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_the_verdicts_are_those_of_the_drive_folder(tmp_path: Path, kind: BagKind) -> None:
    manifest = without_what_ros_has_not(write_short_drive(tmp_path / "drive"))
    imported = through_a_bag(manifest, tmp_path, kind)
    expected = in_one_process(manifest, tmp_path / "folder")
    again = in_one_process(imported, tmp_path / "bagged")
    verdicts = [item.message for item in expected.recorded["verdict"]]
    assert Counter(verdict.verdict for verdict in verdicts).keys() == {"confirmed", "erroneous", "unknown"}
    assert [item.message for item in again.recorded["verdict"]] == verdicts
    assert again.summary["confirmed"] == expected.summary["confirmed"]


@pytest.mark.slow
def test_a_drive_with_lidar_keeps_its_verdicts_and_scan_matches(tmp_path: Path) -> None:
    scenario = load_scenario(
        "city", ["duration_s=20.0", "satellites.streams=false", "lidar={beams=32, traffic=2}"]
    )
    manifest = without_what_ros_has_not(simulate(scenario, tmp_path / "drive", quiet=True))
    imported = through_a_bag(manifest, tmp_path, "mcap")
    expected = in_one_process(manifest, tmp_path / "folder")
    again = in_one_process(imported, tmp_path / "bagged")
    matches = [[item.message for item in drive.recorded["scan_match"]] for drive in (expected, again)]
    assert Counter(match.status for match in matches[0])["converged"] > 100
    for match, other in zip(*matches, strict=True):
        assert (match.time_ns, match.status, match.reason) == (other.time_ns, other.status, other.reason)
        # Points of one time are in another order, so sums differ in their last digits.
        assert match.sensor_height_m == pytest.approx(other.sensor_height_m, abs=1e-6)
    verdicts = [[item.message for item in drive.recorded["verdict"]] for drive in (expected, again)]
    assert len(verdicts[0]) > 100
    for verdict, other in zip(*verdicts, strict=True):
        assert (verdict.fix_id, verdict.verdict, verdict.reason) == (
            other.fix_id,
            other.verdict,
            other.reason,
        )
        assert verdict.height_difference_m == pytest.approx(other.height_difference_m, abs=1e-6)
