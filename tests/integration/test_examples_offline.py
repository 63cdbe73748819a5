"""The examples that need no running service print the documented results, and *unknown* where nothing is known."""

from __future__ import annotations

import json
import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from camber.cli import main
from camber.replay.short_drive import write_short_drive
from support import small_map
from support.running import python
from support.tree import ROOT

# About five and three times the largest errors of thirty seeds with both displacements below: 0.001 m and 0.006°.
SHIFT_TOLERANCE_M = 0.005
YAW_TOLERANCE_DEG = 0.02


def run_example(name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run an example as a user does, to its end."""
    return python(ROOT / "examples" / name, *arguments, timeout_s=120.0)


def printed_lines(name: str, *arguments: object) -> list[str]:
    """Run an example that must succeed and return the lines of its output."""
    completed = run_example(name, *arguments)
    assert (completed.returncode, completed.stderr) == (0, "")
    return completed.stdout.splitlines()


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of twelve replayed seconds of the short drive."""
    folder = tmp_path_factory.mktemp("replay")
    drive = write_short_drive(folder / "drive")
    assert main(["replay", str(drive), "--out", str(folder / "out"), "--set", "end_s=12", "--quiet"]) == 0
    return folder / "out"


@pytest.mark.slow
def test_the_counts_of_a_recording_are_those_of_its_summary(replayed: Path) -> None:
    verdicts = json.loads((replayed / "summary.json").read_text("utf-8"))["verdicts"]
    expected = [(str(row["count"]), row["verdict"], row["reason"]) for row in verdicts["by_reason"]]
    *rows, total = printed_lines("read_recording.py", replayed / "recording.mcap")
    assert [tuple(row.split()) for row in rows] == expected
    assert total.split() == [str(verdicts["count"]), "verdicts"]
    assert any(verdict == "confirmed" for _, verdict, _ in expected), "the drive has fixes to count"


@pytest.mark.slow
def test_a_topic_of_a_recording_is_printed_as_csv_in_utc(replayed: Path) -> None:
    fields = ("verdict", "height_difference_m", "nosuch.field")
    header, *rows = printed_lines(
        "recording_to_csv.py", replayed / "recording.mcap", "/integrity/verdict", *fields
    )
    assert header == "utc,verdict,height_difference_m,nosuch.field"
    assert rows[0].startswith("2024-05-17T16:53:02.000+00:00,unknown,0.36")
    assert len(rows) == json.loads((replayed / "summary.json").read_text("utf-8"))["verdicts"]["count"]
    source = (ROOT / "examples" / "recording_to_csv.py").read_text("utf-8")
    assert "import camber" not in source
    assert "from camber" not in source


@pytest.mark.slow
def test_a_cut_recording_is_reported_in_one_line(replayed: Path, tmp_path: Path) -> None:
    data = (replayed / "recording.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    completed = run_example("read_recording.py", cut)
    assert completed.returncode == 1
    assert completed.stderr.startswith("read_recording.py: cut.mcap")
    assert len(completed.stderr.splitlines()) == 1


def test_the_published_ambiguities_are_printed_and_fail_the_ratio_test() -> None:
    assert printed_lines("resolve_ambiguities.py") == [
        "(5, 3, 4) squared norm 0.21833",
        "(6, 4, 4) squared norm 0.30727",
        "ratio 1.407, threshold 3.000",
        "success rate of bootstrapping 0.032",
        "not resolved: 5.45, 3.1, 2.97",
    ]


def test_a_lower_threshold_resolves_the_published_ambiguities() -> None:
    assert printed_lines("resolve_ambiguities.py", "--least-ratio", 1.4)[-1] == "resolved: 5, 3, 4"


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """A release with a road that rises by 1 % to the east, and two decks at one place north of it."""
    rising = np.array([[50.0, 50.0], [50.2, 50.2]])
    rows = [
        small_map.surface(0, heights_m=rising),
        small_map.surface(1, 0.0, 100.0, link_id=2),
        small_map.surface(2, 0.0, 100.0, link_id=3, level=1, heights_m=56.0),
    ]
    small_map.write(tmp_path / "map", rows)
    return tmp_path / "map"


def degrees_at(east_m: float, north_m: float) -> tuple[float, float]:
    """Return latitude and longitude [°] of a point given in metres about the origin of the small map."""
    latitude_rad, longitude_rad = small_map.at(east_m, north_m)
    return math.degrees(latitude_rad), math.degrees(longitude_rad)


def test_elevation_slope_and_sigma_of_a_road_are_printed(release: Path) -> None:
    assert printed_lines("road_elevation.py", release, *degrees_at(0.0, 0.0)) == [
        "elevation 50.100 m (WGS84), sigma 0.030 m",
        "slope +1.00% to the east, +0.00% to the north",
    ]


@pytest.mark.parametrize(
    ("east_m", "north_m", "reason"), [(0.0, 50.0, "no_surface"), (0.0, 100.0, "levels_ambiguous")]
)
def test_the_elevation_is_unknown_without_a_road_and_on_ambiguous_decks(
    release: Path, east_m: float, north_m: float, reason: str
) -> None:
    lines = printed_lines("road_elevation.py", release, *degrees_at(east_m, north_m))
    assert lines == [f"unknown ({reason})"]


def test_a_release_without_its_tile_is_reported_in_one_line(release: Path) -> None:
    tiles = [path for path in (release / "blobs").rglob("*") if path.is_file()]
    (tile,) = (path for path in tiles if b"camber.SurfaceTile" in path.read_bytes())
    tile.unlink()
    check_release_error(release, tile.name)


def test_a_missing_release_is_reported_in_one_line(tmp_path: Path) -> None:
    check_release_error(tmp_path / "none", "none")


def check_release_error(release: Path, named: str) -> None:
    """Assert that the example prints no elevation, and one line that names the file."""
    completed = run_example("road_elevation.py", release, *degrees_at(0.0, 0.0))
    assert (completed.returncode, completed.stdout) == (2, "")
    (line,) = completed.stderr.splitlines()
    assert line.startswith("road_elevation.py: ")
    assert named in line


@pytest.mark.parametrize(("east_m", "north_m", "yaw_deg"), [(0.6, -0.4, 3.0), (-0.8, 0.5, -2.0)])
def test_the_registration_estimates_the_shift_and_yaw_of_the_truth(
    east_m: float, north_m: float, yaw_deg: float
) -> None:
    truth = ("--east-m", east_m, "--north-m", north_m, "--yaw-deg", yaw_deg)
    (line,) = printed_lines("register_clouds.py", *truth)
    match = re.fullmatch(r"east (\S+) m, north (\S+) m, yaw (\S+)°", line)
    assert match is not None, line
    east, north, yaw = map(float, match.groups())
    assert abs(east - east_m) < SHIFT_TOLERANCE_M
    assert abs(north - north_m) < SHIFT_TOLERANCE_M
    assert abs(yaw - yaw_deg) < YAW_TOLERANCE_DEG


def test_a_registration_without_correspondences_is_unknown() -> None:
    completed = run_example("register_clouds.py", "--east-m", 200)
    assert completed.returncode == 1
    assert completed.stdout.startswith("unknown: not converged")
