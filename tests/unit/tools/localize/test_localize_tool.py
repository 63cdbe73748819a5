"""`camber localize`: what it leaves behind, what it says, and one clear line for a drive that lacks something."""

from __future__ import annotations

import csv
import re
import shutil
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from camber import cli
from camber.localizer.settings import LocalizerSettings
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.schemas.codec import encode
from camber.schemas.drive import load_manifest
from camber.simulator.scenario import load_scenario
from camber.tools import simulate
from camber.tools.localize.command import localize_drive
from camber.tools.localize.drive_anchors import receiver_fixes
from camber.tools.localize.local_map_queries import LocalMapQueries, release_for
from camber.tools.localize.localizer_config import localizer_config
from camber.tools.localize.localizer_run import LocalizedDrive, localize
from support.refusals import Refused

STREET = (
    "duration_s=2.5",
    "satellites.systems=G",
    "satellites.streams=false",
    "lidar.beams=32",
    "lidar.traffic=0",
)
BLIND = ("--no-match-sweeps",)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of a street with a LiDAR: standing, then driving off."""
    folder = tmp_path_factory.mktemp("street") / "drive"
    simulate.simulate(load_scenario("canyon", STREET), folder, quiet=True)
    return folder / "drive.toml"


@pytest.fixture(scope="module")
def matched(street: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """What the command has left of that street, and its output."""
    out = tmp_path_factory.mktemp("matched")
    return out, localize_drive(load_manifest(street), out, pictures_s=(1.5, 99.0))


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) if row[name] else np.nan for row in rows])


def texts(path: Path) -> set[str | None]:
    return {element.text for element in ElementTree.parse(path).iter()}


# A street with a LiDAR


def test_every_sweep_has_a_row_and_every_motion_sample_a_pose(
    street: Path, matched: tuple[Path, str]
) -> None:
    out, _ = matched
    poses, matches = table(out / "poses.csv"), table(out / "matches.csv")
    sweeps = sorted(int(path.stem) for path in (street.parent / "sweeps").glob("*.pcd"))
    times = {int(row["time_ns"]) for row in matches}
    assert times <= set(sweeps)
    assert len(times) == len(matches) >= len(sweeps) - 1  # the motion up to the last one's end may be missing
    motion = table(street.parent / "motion.csv")
    assert [row["time_ns"] for row in poses] == [row["time_ns"] for row in motion]


def test_in_a_street_matches_hold_the_pose(matched: tuple[Path, str]) -> None:
    out, _ = matched
    poses = table(out / "poses.csv")[10:]
    assert {row["mode"] for row in poses} == {"scan_match"}
    assert np.nanmax(np.abs(column(poses, "error_cross_m"))) < 0.1
    assert np.nanmax(np.abs(column(poses, "error_yaw_deg"))) < 0.5
    assert np.nanmax(column(poses, "match_age_s")) < 0.3
    assert (column(poses, "covariance_ee_m2") > 0.0).all()
    matches = [row for row in table(out / "matches.csv") if row["status"] == "converged"]
    assert len(matches) > 15
    assert ((column(matches, "overlap") > 0.3) & (column(matches, "overlap") <= 1.0)).all()
    assert (column(matches, "layer_2_mean_distance_m") < 0.5).all()


def test_the_paragraph_says_what_the_tables_hold(matched: tuple[Path, str]) -> None:
    out, output = matched
    poses, matches = table(out / "poses.csv"), table(out / "matches.csv")
    assert output.startswith(f"canyon: {len(poses)} poses from ")
    assert f"{sum(row['mode'] == 'scan_match' for row in poses)} scan match (" in output
    assert f"{len(matches)} scan matches: " in output
    errors_m = np.hypot(column(poses, "error_along_m"), column(poses, "error_cross_m"))
    p50, p95 = np.nanquantile(errors_m, (0.5, 0.95))
    figures = re.search(r"horizontal p50 ([0-9.]+) m, p95 ([0-9.]+) m", output)
    assert figures is not None
    # The tables are rounded to millimetres.
    assert [float(value) for value in figures.groups()] == pytest.approx([p50, p95], abs=0.002)
    right = int((column(poses, "level") == 0.0).sum())
    assert f"level right at {right} of {right};" in output


def test_the_plot_and_the_pictures_are_whole(matched: tuple[Path, str]) -> None:
    out, output = matched
    assert "mean distance by layer [m]" in texts(out / "localize.svg")
    for name in ("match-worst.svg", "match-1.5s.svg"):
        assert str(out / name) in output
        images = [e for e in ElementTree.parse(out / name).iter() if e.tag.endswith("image")]
        assert len(images) >= 2
    assert "canyon: scan match at 1.5 s" in texts(out / "match-1.5s.svg")
    assert "No picture at 99 s: nothing was matched there." in output.splitlines()
    assert not (out / "match-99s.svg").exists()


def test_the_same_drive_gives_the_same_bytes(street: Path, matched: tuple[Path, str], tmp_path: Path) -> None:
    out, _ = matched
    localize_drive(load_manifest(street), tmp_path, pictures_s=(1.5, 99.0))
    for path in out.glob("*.*"):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_a_sweep_that_cannot_be_read_costs_itself_and_a_line(street: Path, tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    shutil.copytree(street.parent, drive)
    broken = sorted((drive / "sweeps").glob("*.pcd"))[7]
    broken.write_bytes(broken.read_bytes()[:5000])
    output = localize_drive(load_manifest(drive / "drive.toml"), tmp_path / "out")
    assert output.splitlines()[-1].startswith("1 sweep could not be read and left out, the first: ")
    assert broken.stem not in {row["time_ns"] for row in table(tmp_path / "out" / "matches.csv")}


# A drive without one


def drive_of(inputs: DriveInputs, **inputs_of: object) -> LocalizedDrive:
    assert inputs.map_release is not None
    settings = LocalizerSettings(match_sweeps=False, **localizer_config(inputs.manifest, inputs.initial_pose))
    options = settings.options(settings.initial_pose)
    at_hand = LocalMapQueries(release_for(inputs.map_release, inputs.manifest.datum))
    return localize(inputs, options, at_hand, **inputs_of)  # type: ignore[arg-type]


def test_motion_and_links_alone_need_no_sweeps(blind: Path, tmp_path: Path) -> None:
    output = localize_drive(load_manifest(blind), tmp_path, settings=BLIND)
    assert "601 dead reckoning (100.0%)" in output
    assert table(tmp_path / "matches.csv") == []
    assert not list(tmp_path.glob("match-*.svg"))


def test_anchors_hold_the_pose_and_are_named(blind: Path, tmp_path: Path) -> None:
    for anchors in ("truth", "right-fixes"):
        out = tmp_path / anchors
        output = localize_drive(load_manifest(blind), out, anchors=anchors, settings=BLIND)  # type: ignore[arg-type]
        assert f"Surrogate: anchors from {anchors}: an integrity judge without errors." in output
        poses = table(out / "poses.csv")
        error_m = np.hypot(column(poses, "error_along_m"), column(poses, "error_cross_m"))
        assert np.median(error_m) < 0.1
        assert {"confirmed"} == {row["provenance"] for row in poses[20:]}


def test_without_a_given_pose_fixes_start_it_provisionally(blind: Path, tmp_path: Path) -> None:
    manifest = load_manifest(blind).model_copy(update={"initial_pose": None})
    output = localize_drive(manifest, tmp_path, fixes=True, settings=BLIND)
    assert "provisional (" in output
    poses = table(tmp_path / "poses.csv")
    assert poses[0]["mode"] == "none"
    assert poses[0]["latitude_deg"] == poses[0]["covariance_ee_m2"] == ""
    assert {row["mode"] for row in poses} == {"none", "provisional"}


def test_with_a_given_pose_no_fix_changes_a_bit(blind: Path, tmp_path: Path) -> None:
    inputs = prepare_drive(load_manifest(blind), tmp_path)
    alone, with_fixes = drive_of(inputs), drive_of(inputs, fixes=receiver_fixes(inputs))
    # The independent position uses the heights of fixes.
    first, second = (
        [
            encode(pose.model_copy(update={"independent": None, "fix_run_begin_time_ns": None}))
            for pose in drive.poses
        ]
        for drive in (alone, with_fixes)
    )
    assert first == second


# What is missing, and what is wrong


@pytest.mark.parametrize(
    ("removed", "expected"),
    [
        ({"sweeps": None}, "no table sweeps with sweeps in it, expected one, or --no-match-sweeps"),
        ({"initial_pose": None}, "no initial_pose, expected one, or --fixes or --anchors to start from"),
        ({"map": None}, "no table map, expected one, or links and road_surfaces as surrogates"),
        (
            {"motion": None},
            "no table motion or imu, expected one, or wheel_speed and yaw_rate in surrogates.inputs",
        ),
    ],
)
def test_what_a_drive_lacks_is_one_line(
    removed: dict[str, None],
    expected: str,
    street: Path,
    tmp_path: Path,
    refused: Refused,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    manifest = load_manifest(street).model_copy(update=removed)
    monkeypatch.setattr("camber.tools.localize.command.load_manifest", lambda *_: manifest)
    line = refused(cli.main, "localize", street, "--out", tmp_path)
    assert line.startswith(f"camber localize: canyon: {expected}")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--set", "datum=JGD2011"], "datum is 'WGS84', expected JGD2011 as of the drive"),
        (["--set", "nothing=1"], "nothing is not known"),
        (["--antenna-x-m", "900"], "antenna_x_m: Input should be less than or equal to 50"),
        (["--no-such-thing"], "unrecognized arguments: --no-such-thing"),
    ],
)
def test_what_is_wrong_is_one_line(
    arguments: list[str], expected: str, blind: Path, tmp_path: Path, refused: Refused
) -> None:
    line = refused(cli.main, "localize", blind, "--out", tmp_path, "--no-match-sweeps", *arguments)
    assert line.startswith("camber localize: ")
    assert expected in line


def test_a_broken_file_is_named_with_its_line(blind: Path, tmp_path: Path, refused: Refused) -> None:
    drive = tmp_path / "drive"
    shutil.copytree(blind.parent, drive)
    lines = (drive / "motion.csv").read_text().splitlines()
    lines[40] = "1,2,three," + lines[40]
    (drive / "motion.csv").write_text("\n".join(lines) + "\n")
    out = tmp_path / "out"
    line = refused(cli.main, "localize", drive / "drive.toml", "--out", out, "--no-match-sweeps")
    assert line.startswith("camber localize: motion.csv:41: ")


def test_a_folder_that_cannot_be_written_is_named(blind: Path, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "out"
    line = refused(cli.main, "localize", blind, "--out", out, "--no-match-sweeps")
    assert line.startswith(f"camber localize: {tmp_path / 'file'}")
