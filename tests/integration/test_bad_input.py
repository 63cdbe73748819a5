"""Bad input is one clear line and exit code 2, or a stated *unknown*, and the drive goes on as usual."""

import random
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.cli import main
from camber.formats.drive.recording import Recorded
from camber.replay.short_drive import ANTENNA_HEIGHT_M, START_NS, short_drive_truth, write_short_drive
from camber.replay.surrogate_map import make_map
from camber.road_map.release import write_release
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.schemas.drive import Surrogates
from support import small_map
from support.running import Drive, camber, drive_s, in_one_process, recorded, replayed, summary_of

END_S = 48.0


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    """The folder of an undamaged drive."""
    folder = tmp_path_factory.mktemp("drive")
    write_short_drive(folder)
    return folder


@pytest.fixture
def drive(clean, tmp_path) -> Path:
    """A copy of it to be damaged."""
    return Path(shutil.copytree(clean, tmp_path / "drive"))


def run(drive: Path, out: Path, end_s: float) -> Path:
    """By real processes: where it matters what stands in a service's log."""
    return replayed(drive / "drive.toml", out, "--processes", "--set", f"end_s={end_s}")


def driven(drive: Path, folder: Path, *overrides: str, end_s: float = END_S) -> Drive:
    """By one process, which says what a replay says (tests/replay/test_short_drive.py)."""
    return in_one_process(drive / "drive.toml", folder, f"end_s={end_s}", *overrides)


def verdict_by_time(output: dict[str, list[Recorded[Any]]]) -> dict[float, str]:
    """The judge's word on each fix, by the time of the drive."""
    verdicts = [item.message for item in output["verdict"]]
    return {drive_s(v.time_ns): v.verdict for v in verdicts if v.fix_id is not None}


def reasons(drive: Drive) -> Counter[str]:
    return Counter(item.message.reason for item in drive.recorded["verdict"])


@pytest.fixture(scope="module")
def usual(clean, tmp_path_factory) -> dict[float, str]:
    """The words on the undamaged drive."""
    return verdict_by_time(driven(clean, tmp_path_factory.mktemp("usual")).recorded)


# --- what cannot be used at all ------------------------------------------------------------------------------------


def edit(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(drive: Path) -> None:
        path = drive / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return change


@pytest.mark.parametrize(
    ("damage", "output"),
    [
        (lambda drive: (drive / "receiver.pos").unlink(), "receiver.file"),
        (lambda drive: (drive / "motion.csv").unlink(), "motion.file"),
        (lambda drive: (drive / "truth.csv").unlink(), "truth.file"),
        (lambda drive: shutil.rmtree(drive / "map"), "map.release"),
        (lambda drive: (drive / "drive.toml").unlink(), "drive.toml"),
        (edit("drive.toml", "sigma_m = 0.02", "sigma_mm = 20"), "sigma_mm"),
        (edit("drive.toml", "height_m = 1.6", 'height_m = "1.6 m"'), "antenna_height.height_m"),
        (edit("drive.toml", "height_m = 1.6", "height_m = 1600.0"), "antenna_height.height_m"),
        (edit("drive.toml", "sigma_m = 0.02", "sigma_m = nan"), "antenna_height.sigma_m"),
        (edit("drive.toml", "[receiver]", "[receiver"), "not TOML"),
        (edit("motion.csv", "wheel_speed_m_s", "wheel_speed_km_h"), "motion.csv"),
        (edit("motion.csv", "1400000000200000000", "yesterday"), "motion.csv:3"),
        (edit("receiver.pos", "WGS84/ellipsoidal", "WGS84/geodetic"), "receiver.pos"),
        (lambda drive: (drive / "receiver.pos").write_bytes(bytes(range(256)) * 40), "receiver.pos"),
        (lambda drive: (drive / "receiver.pos").write_bytes(b""), "receiver.pos"),
    ],
)
def test_a_drive_that_cannot_be_used_is_one_line_and_exit_code_2(drive, tmp_path, capsys, damage, output):
    damage(drive)
    assert main(["replay", str(drive / "drive.toml"), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("camber replay: ")
    assert output in line


def test_a_shell_sees_that_line_and_that_exit_code(drive, tmp_path):
    (drive / "receiver.pos").unlink()
    done = camber("replay", drive / "drive.toml", "--out", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith("camber replay: ")
    assert "receiver.file" in line


# --- what is damaged here and there --------------------------------------------------------------------------------


def damaged_receiver_file(lines: list[bytes]) -> tuple[list[bytes], set[float]]:
    """The lines with faults in them, and the times of the epochs that are lost by these."""
    row = {round(place / 5, 1): line for place, line in enumerate(lines[2:])}  # no gap before 24 s
    noise = random.Random(5).randbytes(300).replace(b"\n", b"")
    changes = {
        12.0: [_with_field(row[12.0], 4, b"nan")],
        14.0: [row[14.0], row[14.0]],
        16.0: [row[16.2]],
        16.2: [row[16.0]],
        17.0: [row[17.0].replace(b"2024/", b"2089/")],
        18.0: [row[18.0].replace(b"2024/", b"2079/")],
        18.6: [row[18.6][:50] + b"\n"],
        19.0: [noise + b"\n", row[19.0]],
        19.4: [_with_field(row[19.4], 3, b"517.0")],
        22.4: [b"\0" * 5000 + b"\n", row[22.4]],
    }
    out = lines[:2]
    for time_s, line in row.items():
        out += changes.get(time_s, [line]) if time_s <= 23.8 else [line]
    return out, {12.0, 16.0, 17.0, 18.0, 18.6, 19.4}


def _with_field(line: bytes, place: int, value: bytes) -> bytes:
    fields = line.split()
    fields[place] = value
    return b" ".join(fields) + b"\n"


@pytest.mark.parametrize("mode", [(), ("--processes",)], ids=["one process", "processes"])
def test_a_value_that_a_service_refuses_is_its_one_line_at_once(drive, tmp_path, mode):
    wrong = ("--set", "antenna_height.sigma_m=5.0")
    done = camber("replay", drive / "drive.toml", *mode, "--out", tmp_path / "out", *wrong, timeout_s=120.0)
    assert done.returncode == 2
    line = done.stderr.splitlines()[-1]
    assert "antenna_height" in line
    assert line.endswith(": fixed_sigma_m: Input should be less than or equal to 1 (got '5.0')")


def test_damaged_lines_cost_their_epochs_and_no_other(drive, tmp_path, usual):
    path = drive / "receiver.pos"
    lines, lost_s = damaged_receiver_file(path.read_bytes().splitlines(keepends=True))
    path.write_bytes(b"".join(lines))
    out = run(drive, tmp_path / "out", END_S)
    verdicts = verdict_by_time(recorded(out))
    assert verdicts == {time_s: verdict for time_s, verdict in usual.items() if time_s not in lost_s}
    assert summary_of(out)["confirmed"]["wrong"] == 0
    log = (out / "logs" / "gnss.log").read_text()
    for issue in ("unreadable_input", "repeated_epoch", "out_of_order_epoch"):
        assert issue in log


@pytest.mark.parametrize("ahead", ["17:16:", "23:53:"], ids=["minutes", "hours"])
def test_one_epoch_whose_clock_runs_ahead_does_not_hold_up_the_rest(drive, tmp_path, usual, ahead):
    """As one does whose clock has taken leap seconds, a second base, or a bit, wrongly."""
    edit("receiver.pos", "16:53:32.000", f"{ahead}32.000")(drive)
    verdicts = verdict_by_time(driven(drive, tmp_path).recorded)
    assert verdicts == {time_s: verdict for time_s, verdict in usual.items() if time_s != 12.0}


def test_a_receiver_whose_clock_is_an_hour_off_all_along_is_never_confirmed(drive, tmp_path):
    path = drive / "receiver.pos"
    path.write_bytes(path.read_bytes().replace(b" 16:5", b" 17:5"))
    output = verdict_by_time(driven(drive, tmp_path, end_s=3700.0).recorded)
    assert "confirmed" not in output.values()


# --- the map -------------------------------------------------------------------------------------------------------


def test_without_a_surface_there_nothing_is_confirmed(drive, tmp_path):
    shutil.rmtree(drive / "map")
    small_map.write(drive / "map", [small_map.surface(1)])  # 20 km away
    output = driven(drive, tmp_path, end_s=20.0)
    assert set(verdict_by_time(output.recorded).values()) == {"unknown"}
    assert set(reasons(output)) <= {"road_unknown"}


def test_a_release_of_another_datum_is_not_compared_with(drive, tmp_path):
    output = driven(drive, tmp_path, "datum=JGD2011", end_s=20.0)
    assert set(verdict_by_time(output.recorded).values()) == {"unknown"}
    assert set(reasons(output)) == {"datum_mismatch"}
    assert any("WGS84" in issue.text for issue in output.issues if issue.service == "map_server")


RAISED = {"level": 1, **dict.fromkeys(("surface_id", "link_id", "start_node", "end_node"), 1_000_000)}
"""What is added to the columns of a road on the level above."""


def stacked(columns: RoadSurfaces | RoadLinks, by_m: float) -> Any:
    """Every road once more on a level above itself, with links of its own that nothing connects to the first."""
    raised = {name: value + RAISED[name] for name, value in vars(columns).items() if name in RAISED}
    if isinstance(columns, RoadSurfaces):
        raised["heights_m"] = [grid + by_m for grid in columns.heights_m]
    twice = {name: [*value, *raised.get(name, value)] for name, value in vars(columns).items()}
    return type(columns)(**twice)


def test_where_two_levels_are_possible_neither_is_guessed(drive, tmp_path):
    """The heights of the fixes must not select the road level: they are what is under test."""
    shutil.rmtree(drive / "map")
    errors = Surrogates(seed=1)
    surfaces, links = (
        stacked(columns, 6.0) for columns in make_map(short_drive_truth(), errors, ANTENNA_HEIGHT_M)
    )
    write_release(
        drive / "map",
        region="two-levels",
        map_version=1,
        datum="WGS84",
        epoch_year=2024.4,
        time_ns=START_NS,
        surfaces=surfaces,
        links=links,
    )
    output = driven(drive, tmp_path, end_s=20.0)
    assert set(verdict_by_time(output.recorded).values()) == {"unknown"}
    assert set(reasons(output)) == {"levels_ambiguous"}


def test_a_damaged_tile_makes_the_road_unknown_and_is_named(drive, tmp_path):
    for path in (drive / "map" / "blobs").glob("*/*"):
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 0xFF
        path.write_bytes(bytes(data))
    out = run(drive, tmp_path / "out", 20.0)
    assert set(verdict_by_time(recorded(out)).values()) == {"unknown"}
    assert "release_refused" in (out / "logs" / "map_server.log").read_text()


def test_motion_that_says_nothing_for_a_while_leaves_nothing_confirmed_on_an_old_pose(drive, tmp_path):
    path = drive / "motion.csv"
    head, *rows = path.read_text().splitlines(keepends=True)
    kept = [row for row in rows if not 36.0 <= drive_s(int(row.split(",")[0])) < 42.0]
    path.write_text(head + "".join(kept))
    replayed = driven(drive, tmp_path)
    output = verdict_by_time(replayed.recorded)
    inside = {verdict for time_s, verdict in output.items() if 36.4 <= time_s < 42.0}
    assert inside == {"unknown"}
    assert "pose_stale" in reasons(replayed)
    assert np.mean([verdict == "confirmed" for time_s, verdict in output.items() if time_s > 44.0]) > 0.9
    assert replayed.summary["confirmed"]["wrong"] == 0
