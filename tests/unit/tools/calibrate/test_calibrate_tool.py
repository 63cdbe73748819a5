"""`camber calibrate`: the summary and the TOML of a drive, and one clear line for a drive that lacks something."""

from __future__ import annotations

import math
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from camber import cli
from camber.geodesy.local_frame import LocalFrame
from camber.integrity.learning.residuals import ReferenceKey
from camber.schemas.drive import load_manifest
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose
from camber.tools.calibrate import command as tool
from camber.tools.calibrate.calibration import calibrate_horizontal, estimate_antenna_height, pair
from camber.tools.calibrate.command import calibrate
from support import judging
from support.refusals import Refused

FRAME = LocalFrame(judging.LATITUDE_RAD, judging.LONGITUDE_RAD, judging.ROAD_M)
LEVER_M, BASE_M = (0.4, -0.3), (0.7, 0.2, 0.1)
SEED = 20261122


def drive(
    seconds: float = 120.0, *, mode: str = "scan_match", turns: bool = True
) -> tuple[list[Fix], list[Pose]]:
    """Fixes and poses of a drive round blocks at 10 m/s; a pose is where the lever arm as set puts the antenna."""
    print(f"seed {SEED}")
    rng, east_m, north_m = np.random.default_rng(SEED), 0.0, 0.0
    fixes, poses = [], []
    for epoch in range(int(seconds * 5)):
        yaw_rad = 0.5 * math.pi * (epoch // 75) % (2.0 * math.pi) if turns else 0.0
        east_m, north_m = east_m + 2.0 * math.cos(yaw_rad), north_m + 2.0 * math.sin(yaw_rad)
        place = FRAME.geodetic_from_east_north(east_m, north_m, judging.ROAD_M)[:2]
        at_place = {"latitude_rad": place[0], "longitude_rad": place[1], "yaw_rad": yaw_rad}
        poses.append(judging.pose(epoch, mode=mode, sigma_m=0.05, **at_place))
        forward, left = LEVER_M
        east = forward * math.cos(yaw_rad) - left * math.sin(yaw_rad) + BASE_M[0] + rng.normal(0.0, 0.03)
        north = forward * math.sin(yaw_rad) + left * math.cos(yaw_rad) + BASE_M[1] + rng.normal(0.0, 0.03)
        at = FRAME.geodetic_from_east_north(east_m + east, north_m + north, judging.ROAD_M)[:2]
        up_m = BASE_M[2] + rng.normal(0.0, 0.02)
        fixes.append(judging.fix(epoch, up_m=up_m, latitude_rad=at[0], longitude_rad=at[1]))
    return fixes, poses


def test_lever_arm_base_and_height_follow_from_fixes_and_poses() -> None:
    paired = pair(*drive())
    result, height = calibrate_horizontal(paired.pairs), estimate_antenna_height(paired.cells)
    assert result is not None
    assert height is not None
    assert result.separable
    assert result.lever_m == pytest.approx(LEVER_M, abs=0.02)
    assert result.base_m == pytest.approx(BASE_M[:2], abs=0.02)
    assert height.value_m == pytest.approx(judging.ANTENNA_M + BASE_M[2], abs=0.02)


def test_only_fixed_positions_with_a_pose_of_their_time_count() -> None:
    fixes, poses = drive(20.0)
    assert pair([fix.model_copy(update={"quality": "float"}) for fix in fixes], poses).fixes == 0
    late = [fix.model_copy(update={"time_ns": fix.time_ns + 10**12}) for fix in fixes]
    assert (len(pair(late, poses).pairs.time_ns), len(pair(late, poses).cells)) == (0, 0)
    assert len(pair(fixes, []).pairs.time_ns) == 0


def test_poses_that_are_no_scan_match_give_heights_alone() -> None:
    paired = pair(*drive(mode="dead_reckoning"))
    assert len(paired.pairs.time_ns) == 0
    assert estimate_antenna_height(paired.cells) is not None


def test_of_roads_that_are_not_known_or_of_another_datum_no_height_is_estimated() -> None:
    fixes, poses = drive(20.0)
    for road in (judging.road(datum="JGD2011"), judging.road(status="unknown", elevation_m=None)):
        paired = pair(fixes, [pose.model_copy(update={"road": road}) for pose in poses])
        assert paired.cells == ()
        assert estimate_antenna_height(paired.cells) is None


def test_a_stretch_belongs_to_no_antenna_or_base() -> None:
    assert {cell.key for cell in pair(*drive(20.0)).cells} == {ReferenceKey()}


# The command


def test_without_scan_matches_it_estimates_the_height_alone(blind: Path) -> None:
    summary, snippet = calibrate(load_manifest(blind))
    assert "not estimated, expected a minute of fixes with scan matches" in summary
    manifest = load_manifest(blind)
    table = tomllib.loads(snippet)
    assert table["antenna_height"]["height_m"] == pytest.approx(manifest.antenna_height.height_m, abs=0.05)
    assert table["lever_arms"]["antenna"]["x_m"] == pytest.approx(manifest.lever_arms.antenna.x_m)


def calibrated(
    monkeypatch: pytest.MonkeyPatch, blind: Path, fixes: list[Fix], poses: list[Pose]
) -> tuple[str, str]:
    """The command's summary and TOML of these."""
    monkeypatch.setattr(tool, "_calibration_data", lambda *_, **__: pair(fixes, poses))
    return calibrate(load_manifest(blind))


def test_the_setting_and_the_estimate_are_both_in_the_result(
    monkeypatch: pytest.MonkeyPatch, blind: Path
) -> None:
    summary, snippet = calibrated(monkeypatch, blind, *drive())
    assert "Base offset: +0.7" in summary
    table = tomllib.loads(snippet)
    arm = load_manifest(blind).lever_arms.antenna
    assert table["lever_arms"]["antenna"]["x_m"] == pytest.approx(arm.x_m + LEVER_M[0], abs=0.02)
    assert table["lever_arms"]["antenna"]["y_m"] == pytest.approx(arm.y_m + LEVER_M[1], abs=0.02)
    assert "# The base's coordinates put fixes +0.7" in snippet


def test_without_turns_the_summary_has_both_cases(monkeypatch: pytest.MonkeyPatch, blind: Path) -> None:
    summary, snippet = calibrated(monkeypatch, blind, *drive(turns=False))
    assert "Too few turns to separate lever arm and base offset" in summary
    assert "# if the base is correct" in snippet


def test_without_roads_the_height_stays_as_it_was_set(monkeypatch: pytest.MonkeyPatch, blind: Path) -> None:
    fixes, poses = drive()
    unknown = judging.road(status="unknown", elevation_m=None)
    summary, snippet = calibrated(
        monkeypatch, blind, fixes, [pose.model_copy(update={"road": unknown}) for pose in poses]
    )
    assert "Antenna height: not estimated" in summary
    assert "antenna_height" not in tomllib.loads(snippet)


def test_a_height_that_changed_during_the_drive_is_reported(
    monkeypatch: pytest.MonkeyPatch, blind: Path
) -> None:
    fixes, poses = drive()
    sinking = [fix.model_copy(update={"height_m": fix.height_m - 0.0005 * n}) for n, fix in enumerate(fixes)]
    assert "It changed by 0.29 m" in calibrated(monkeypatch, blind, sinking, poses)[0]


def test_it_writes_the_toml_to_the_file_given(
    blind: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tool, "_calibration_data", lambda *_, **__: pair(*drive()))
    out = tmp_path / "new" / "car.toml"
    assert cli.main(["calibrate", str(blind), "--out", str(out), "--quiet"]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"Written: {out}.")
    assert "lever_arms" in tomllib.loads(out.read_text())
    assert cli.main(["calibrate", str(blind), "--quiet"]) == 0
    assert "[lever_arms.antenna]" in capsys.readouterr().out
    (tmp_path / "file").write_text("")
    assert cli.main(["calibrate", str(blind), "--out", str(tmp_path / "file" / "car.toml")]) == 2


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ("receiver", "no table receiver, expected"),
        ("motion", "no table motion"),
        ("initial_pose", "no initial_pose"),
        ("map", "no table map"),
    ],
)
def test_what_is_missing_is_one_line_and_code_2(
    blind: Path, tmp_path: Path, refused: Refused, table: str, expected: str
) -> None:
    folder = tmp_path / "drive"
    shutil.copytree(blind.parent, folder)
    lines, kept, inside = (folder / blind.name).read_text().splitlines(), [], False
    for line in lines:
        if line.startswith("["):
            inside = line.strip("[]").split(".")[0] == table
        if not inside:
            kept.append(line)
    (folder / blind.name).write_text("\n".join(kept))
    assert expected in refused(cli.main, "calibrate", folder / blind.name, "--quiet")


def test_a_drive_without_fixes_is_one_line(
    blind: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tool, "_calibration_data", lambda *_, **__: pair([], []))
    assert "0 fixes" in refused(cli.main, "calibrate", blind)
    refused(cli.main, "calibrate", "nowhere.toml")

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(tool, "_calibration_data", interrupted)
    assert cli.main(["calibrate", str(blind)]) == 130
