"""`camber gnss solve`: what the engine makes of a drive's files, whatever their format, and where the base is."""

from __future__ import annotations

import gzip
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import camber
from camber import cli
from camber.formats.drive.truth_csv import TruthTable, read_truth
from camber.formats.observations import satellite_name, signal_name
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.rinex.writer import StationHeader, navigation_text
from camber.geodesy.ellipsoid import ecef_from_geodetic, ecef_from_geodetic_scalar
from camber.gnss.position.engine_settings import EngineSettings
from camber.schemas.drive import DriveManifest, ManifestError, load_manifest
from camber.simulator.satellites.atmosphere import KLOBUCHAR_ALPHA, KLOBUCHAR_BETA
from camber.simulator.scenario import load_scenario
from camber.tools import simulate
from camber.tools.gnss import solve as gnss_solve
from camber.tools.gnss.raw_recording import RawRecording, load_raw
from camber.tools.gnss.solve import run_engine
from camber.tools.gnss.solve_plot import SolvedDrive, solution_figure
from camber.validation.plots import svg_text
from support.gnss_files import observation_text, read_navigation, read_observations, read_pos
from support.refusals import Refused
from support.rinex2_writer import Cell, Epoch2, observation_text_2
from support.sbf_drive import sbf_of_ubx

NS = 1_000_000_000
Solve = Callable[..., tuple[str, list[ReceiverSolution]]]
"""The command's output and solutions, with further arguments."""
STREAMS = ("observations.rover_obs=rover.ubx", "observations.base_obs=base.rtcm")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("open-sky") / "drive"
    simulate.simulate(load_scenario("open-sky", ["duration_s=12.0"]), folder, quiet=True)
    return folder


def raw(drive: Path, *overrides: str) -> RawRecording:
    observations = load_manifest(drive / "drive.toml", list(overrides)).observations
    assert observations is not None
    files = observations.rover_obs, observations.base_obs, observations.ephemerides
    return load_raw(*files, base_ecef_m=observations.base_ecef_m)


@pytest.fixture
def solve(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Solve:
    def solved(*more: str) -> tuple[str, list[ReceiverSolution]]:
        code = cli.main(["gnss", "solve", str(drive / "drive.toml"), "--out", str(tmp_path), *more])
        output, err = capsys.readouterr()
        assert (code, err) == (0, "")
        solutions = list(read_pos(tmp_path / "engine.pos"))
        assert all(isinstance(item, ReceiverSolution) for item in solutions)
        return output, [item for item in solutions if isinstance(item, ReceiverSolution)]

    return solved


def errors_m(solutions: list[ReceiverSolution], truth: TruthTable) -> np.ndarray:
    """Distances in 3D; the truth is of the same times."""
    rows = np.searchsorted(truth.time_ns, [solution.time_ns for solution in solutions])
    assert truth.time_ns[rows].tolist() == [solution.time_ns for solution in solutions]
    result = ecef_from_geodetic(
        *np.array([(s.latitude_rad, s.longitude_rad, s.height_m) for s in solutions]).T
    )
    right = ecef_from_geodetic(truth.latitude_rad[rows], truth.longitude_rad[rows], truth.height_m[rows])
    distance: np.ndarray = np.linalg.norm(result - right, axis=1)
    return distance


def test_in_the_open_every_epoch_is_fixed_where_the_antenna_was(drive: Path, solve: Solve) -> None:
    output, solutions = solve()
    rover = read_observations(drive / "rover.obs").epochs
    assert [s.time_ns for s in solutions] == [epoch.time_ns for epoch in rover]
    assert Counter(s.quality for s in solutions) == {SolutionQuality.FIX: 121}
    distance_m = errors_m(solutions, read_truth(drive / "truth.csv", "camber"))
    assert np.quantile(distance_m, 0.95) < 0.02
    assert "open-sky: 121 epochs" in output
    assert "121 fixed (100.0%), 0 float" in output
    assert "120 continuous, 1 no evidence" in output
    assert "0 wrong by more than 0.5 m" in output
    assert f"p50 {np.quantile(distance_m, 0.5):.3f} m, p95 {np.quantile(distance_m, 0.95):.3f} m" in output
    assert output.count("\n") == 1
    # Standard deviations of what the phases say: neither nothing nor metres.
    sigma_m = np.sqrt([s.covariance_enu_m2[5] for s in solutions if s.covariance_enu_m2 is not None])
    assert len(sigma_m) == 121
    assert ((sigma_m > 1e-3) & (sigma_m < 0.1)).all()
    assert all(s.ratio is not None and s.ratio >= 3.0 and s.age_s == 0.0 for s in solutions)


def test_files_need_no_manifest(drive: Path, solve: Solve, tmp_path: Path) -> None:
    solve()
    expected = (tmp_path / "engine.pos").read_bytes()
    observations = load_manifest(drive / "drive.toml").observations
    assert observations is not None
    files = [observations.rover_obs, observations.base_obs, *observations.ephemerides]
    out = tmp_path / "of-files"
    assert gnss_solve.main([*map(str, files), "--out", str(out)]) == 0
    assert (out / "engine.pos").read_bytes() == expected
    columns = camber.solve(files[0], files[1], files[2:])
    solutions = [item for item in read_pos(out / "engine.pos") if isinstance(item, ReceiverSolution)]
    assert columns["time_ns"].tolist() == [solution.time_ns for solution in solutions]
    assert columns["latitude_rad"] == pytest.approx([s.latitude_rad for s in solutions], abs=1e-11)
    assert columns["height_m"] == pytest.approx([s.height_m for s in solutions], abs=1e-4)
    assert set(columns["quality"]) == {"fixed"}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["rover.obs", "base.obs"], "expected a manifest"),
        (["rover.obs", "base.obs", "nav", "--set", "start_s=1"], "expected a manifest"),
        (["rover.obs", "base.obs", "nav", "--base-ecef-m", "1,2,3"], "a place on the earth"),
        (["rover.obs", "base.obs", "nav", "--base-ecef-m", "x"], "a place on the earth"),
    ],
)
def test_files_that_are_not_enough_are_named(
    arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        gnss_solve.main(arguments)
    assert expected in capsys.readouterr().err


def test_a_file_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = str(tmp_path / "rover.obs")
    assert gnss_solve.main([missing, "base.obs", "nav", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "rover.obs" in error or "nav" in error
    assert error.count("\n") == 1


def test_streams_of_the_receiver_and_the_base_give_the_same_as_rinex(drive: Path, solve: Solve) -> None:
    (drive / "base.rtcm.gz").write_bytes(gzip.compress((drive / "base.rtcm").read_bytes()))
    output, from_streams = solve(
        "--set", STREAMS[0], "--set", "observations.base_obs=base.rtcm.gz",
        "--set", 'observations.ephemerides=["rover.ubx", "base.rtcm.gz"]',
    )  # fmt: skip
    assert "121 fixed" in output
    assert "Base position from RTCM 1005 or 1006 of station 1." in output
    _, from_rinex = solve()
    for a, b in zip(from_streams, from_rinex, strict=True):
        # RINEX has mm of the code, the streams their own steps, and other ionosphere.
        assert ecef_from_geodetic_scalar(a.latitude_rad, a.longitude_rad, a.height_m) == pytest.approx(
            ecef_from_geodetic_scalar(b.latitude_rad, b.longitude_rad, b.height_m), abs=0.005
        )


def test_sbf_of_the_receiver_gives_the_same_as_its_ubx(drive: Path, solve: Solve) -> None:
    near_ns = raw(drive, *STREAMS).rover[0].time_ns
    (drive / "rover.sbf").write_bytes(sbf_of_ubx((drive / "rover.ubx").read_bytes(), near_ns))
    ephemerides = 'observations.ephemerides=["rover.sbf"]'
    output, from_sbf = solve(
        "--set", "observations.rover_obs=rover.sbf", "--set", STREAMS[1], "--set", ephemerides
    )
    assert "121 fixed" in output
    _, from_ubx = solve(
        "--set", STREAMS[0], "--set", STREAMS[1], "--set", 'observations.ephemerides=["rover.ubx"]'
    )
    for a, b in zip(from_sbf, from_ubx, strict=True):
        assert ecef_from_geodetic_scalar(a.latitude_rad, a.longitude_rad, a.height_m) == pytest.approx(
            ecef_from_geodetic_scalar(b.latitude_rad, b.longitude_rad, b.height_m), abs=0.003
        )


def rinex_2_of(path: Path) -> str:
    """An observation file with the signals that RINEX 2 has types for, of GPS and Galileo."""
    kinds = {"pseudorange_m": "C", "carrier_phase_cycles": "L", "doppler_hz": "D", "cn0_dbhz": "S"}
    epochs = []
    for epoch in read_observations(path).epochs:
        satellites: dict[str, dict[str, Cell]] = {}
        for row, (satellite, signal) in enumerate(
            zip(epoch.satellite.tolist(), epoch.signal.tolist(), strict=True)
        ):
            name, band = satellite_name(satellite), signal_name(signal)[0]
            for column, kind in kinds.items() if name[0] in "GE" else ():
                value, flag = float(getattr(epoch, column)[row]), "1" if epoch.loss_of_lock[row] else " "
                if not np.isnan(value):
                    satellites.setdefault(name, {})[kind + band] = value, flag if kind == "L" else " ", " "
        epochs.append(Epoch2(time_ns=epoch.time_ns, satellites=satellites))
    types = sorted({name for epoch in epochs for cells in epoch.satellites.values() for name in cells})
    return observation_text_2(epochs, types)


def test_rinex_2_of_rover_and_base_gives_the_same_as_rinex_3(drive: Path, solve: Solve) -> None:
    for name in ("rover", "base"):
        (drive / f"{name}.05o").write_text(rinex_2_of(drive / f"{name}.obs"))
    position_m = ", ".join(map(str, read_observations(drive / "base.obs").header.position_ecef_m or ()))
    output, from_rinex_2 = solve(
        "--set", "observations.rover_obs=rover.05o", "--set", "observations.base_obs=base.05o",
        "--set", f"observations.base_ecef_m=[{position_m}]",
    )  # fmt: skip
    assert "121 fixed" in output
    _, from_rinex_3 = solve("--set", f"observations.base_ecef_m=[{position_m}]")
    for a, b in zip(from_rinex_2, from_rinex_3, strict=True):
        # With fewer satellites: the noise of phases.
        assert ecef_from_geodetic_scalar(a.latitude_rad, a.longitude_rad, a.height_m) == pytest.approx(
            ecef_from_geodetic_scalar(b.latitude_rad, b.longitude_rad, b.height_m), abs=0.03
        )


def test_one_port_may_carry_rover_and_corrections(drive: Path) -> None:
    (drive / "port.log").write_bytes((drive / "rover.ubx").read_bytes() + (drive / "base.rtcm").read_bytes())
    both = raw(drive, "observations.rover_obs=port.log", "observations.base_obs=port.log")
    apart = raw(drive, *STREAMS)
    for mine, theirs in ((both.rover, apart.rover), (both.base, apart.base)):
        assert [e.time_ns for e in mine] == [e.time_ns for e in theirs]
        assert all(
            np.array_equal(a.pseudorange_m, b.pseudorange_m) for a, b in zip(mine, theirs, strict=True)
        )
    assert not np.array_equal(both.rover[0].pseudorange_m, both.base[0].pseudorange_m)


# where the base is


def test_the_base_is_where_the_manifest_says_else_its_messages_else_its_header(drive: Path) -> None:
    header = read_observations(drive / "base.obs").header
    assert header.position_ecef_m is not None
    recording = raw(drive)
    assert recording.base_ecef_m == pytest.approx(header.position_ecef_m, abs=1e-4)
    assert "header" in recording.base_position_from
    recording = raw(drive, STREAMS[1])
    assert recording.base_ecef_m == pytest.approx(header.position_ecef_m, abs=2e-4)
    assert "1005" in recording.base_position_from
    near = [float(x) + 0.5 for x in header.position_ecef_m]
    recording = raw(drive, STREAMS[1], f"observations.base_ecef_m={near}")
    assert recording.base_ecef_m == pytest.approx(near, abs=1e-6)
    assert recording.base_position_from == "the caller"


def test_the_antenna_of_the_header_stands_above_its_marker(drive: Path) -> None:
    text = (drive / "base.obs").read_text()
    label = "ANTENNA: DELTA H/E/N"
    (line,) = [line for line in text.splitlines() if label in line]
    (drive / "moved.obs").write_text(
        text.replace(line, f"{1.5:14.4f}{-0.25:14.4f}{0.75:14.4f}{'':18}{label}")
    )
    recording = raw(drive, "observations.base_obs=moved.obs")
    position = read_observations(drive / "base.obs").header.position_ecef_m
    assert recording.base_ecef_m is not None
    assert position is not None
    moved_m = recording.base_ecef_m - np.array(position)
    assert np.linalg.norm(moved_m) == pytest.approx(np.sqrt(1.5**2 + 0.25**2 + 0.75**2), abs=1e-4)
    # Up is away from the earth's middle, but for the ellipsoid's flattening.
    assert moved_m @ np.array(position) / np.linalg.norm(position) == pytest.approx(1.5, abs=0.01)
    assert moved_m[2] > 0.75 * 0.8  # to the north and up: where this base stands both are towards the pole


def test_of_several_base_positions_the_most_frequent_is_used_and_noted(drive: Path) -> None:
    from camber.formats.rtcm.writer import format_reference_station

    right = raw(drive, STREAMS[1]).base_ecef_m
    assert right is not None
    wrong = (float(right[0]) + 12.0, float(right[1]), float(right[2]))
    content = format_reference_station(wrong, station_id=1) + (drive / "base.rtcm").read_bytes()
    (drive / "moving.rtcm").write_bytes(content)
    recording = raw(drive, "observations.base_obs=moving.rtcm")
    assert recording.base_ecef_m == pytest.approx(right)
    assert any("2 positions up to 12.000 m apart" in note for note in recording.notes)


def test_without_a_base_position_nothing_is_fixed_and_the_reason_is_given(drive: Path, solve: Solve) -> None:
    text = (drive / "base.obs").read_text().splitlines(keepends=True)
    (drive / "nowhere.obs").write_text("".join(line for line in text if "APPROX POSITION XYZ" not in line))
    output, solutions = solve("--set", "observations.base_obs=nowhere.obs")
    assert {s.quality for s in solutions} == {SolutionQuality.SINGLE}
    assert "121 no base position" in output
    assert "Base position from nothing." in output


# the engine's food


def test_a_base_of_one_epoch_a_second_is_given_once_each(drive: Path) -> None:
    recording = raw(drive)
    slow = [epoch for epoch in recording.base if epoch.time_ns % NS == 0]
    assert len(slow) == 13
    solved = run_engine(replace(recording, base=slow[::-1]), recording.rover, EngineSettings())
    assert np.isfinite(solved.age_s).all()
    assert "base_out_of_order" not in solved.warnings
    assert (solved.quality == "fixed").mean() > 0.9
    # What the base has not observed yet is not used: so it is while driving.
    assert np.nanmax(solved.age_s) == pytest.approx(0.9)
    assert np.nanmin(solved.age_s) == 0.0


def test_a_base_that_ends_is_reported_too_old(drive: Path) -> None:
    recording = raw(drive)
    options = EngineSettings(longest_base_age_s=3.0)
    solved = run_engine(replace(recording, base=recording.base[:21]), recording.rover, options)
    late = (solved.time_ns - recording.base[20].time_ns) > 3 * NS
    assert (solved.quality[late] == "single").all()
    assert solved.reasons["base_too_old"] == late.sum()
    assert np.isfinite(solved.position_ecef_m[late]).all()


def test_a_whole_day_of_ephemerides_does_not_push_out_those_in_use(drive: Path) -> None:
    recording = raw(drive)
    days_ns = [86_400 * NS + k * 7200 * NS for k in range(12)]
    day = [
        replace(e, toe_ns=e.toe_ns + later_ns, toc_ns=e.toc_ns + later_ns, transmission_ns=-1)
        for e in recording.ephemerides
        for later_ns in days_ns
    ]
    filled = replace(recording, ephemerides=[*recording.ephemerides, *day])
    alone, among_others = (run_engine(r, r.rover[:20], EngineSettings()) for r in (recording, filled))
    assert (among_others.quality == "fixed").all()
    assert among_others.position_ecef_m == pytest.approx(alone.position_ecef_m, abs=1e-3)


def test_the_ionosphere_of_the_navigation_file_reaches_the_engine(drive: Path) -> None:
    recording = raw(drive)
    assert recording.ionosphere == pytest.approx([*KLOBUCHAR_ALPHA, *KLOBUCHAR_BETA], rel=1e-3)
    without = navigation_text(read_navigation(drive / "brdc.nav").ephemerides)
    (drive / "plain.nav").write_text(without)
    assert raw(drive, 'observations.ephemerides=["plain.nav"]').ionosphere is None

    def single(ionosphere: np.ndarray | None) -> np.ndarray:
        alone = replace(recording, base=[], ionosphere=ionosphere)
        return run_engine(alone, recording.rover[:3], EngineSettings()).position_ecef_m

    assert np.linalg.norm(single(recording.ionosphere) - single(None), axis=1).min() > 0.1


def test_a_file_with_a_damaged_line_is_used_and_the_line_is_noted(drive: Path, solve: Solve) -> None:
    lines = (drive / "rover.obs").read_text().splitlines(keepends=True)
    at = [k for k, line in enumerate(lines) if line.startswith(">")][5]
    lines[at + 3] = lines[at + 3][:5] + "12a4" + lines[at + 3][9:]
    (drive / "damaged.obs").write_text("".join(lines))
    output, solutions = solve("--set", "observations.rover_obs=damaged.obs")
    assert f"\ndamaged.obs:{at + 4}: " in output
    assert len(solutions) == 121


# options


def test_options_reach_the_engine(solve: Solve) -> None:
    def mean_satellites(*more: str) -> float:
        return float(np.mean([s.satellites for s in solve(*more)[1] if s.satellites]))

    everything = mean_satellites()
    gps = mean_satellites("--systems", "g")
    assert gps < mean_satellites("--systems", "GE") < everything
    assert mean_satellites("--elevation-deg", "35") < everything
    assert mean_satellites("--cn0-dbhz", "44") < everything
    output, _ = solve("--ratio", "1000", "--no-partial")
    assert "121 ratio too low" in output
    output, solutions = solve("--set", "end_s=4")
    assert len(solutions) == 41


@pytest.mark.parametrize("systems", ["R", "", "JE"])
def test_systems_that_cannot_be_meant_are_refused(drive: Path, systems: str, refused: Refused) -> None:
    line = refused(cli.main, "gnss", "solve", drive / "drive.toml", "--systems", systems)
    assert f"argument --systems: '{systems}', expected" in line


@pytest.mark.parametrize(
    ("override", "output"),
    [
        ("observations.rover_obs=absent.obs", "there is no such file"),
        ("observations.rover_obs=brdc.nav", "brdc.nav: observations, expected at least one epoch"),
        ("observations.base_obs=motion.csv", "motion.csv: content is"),
        ('observations.ephemerides=["motion.csv"]', "motion.csv: content is"),
        ("observations.rover_obs=other.obs", "no epoch of the rover from start_s to end_s"),
        ("surrogates.nonsense=1", "is not known"),
    ],
)
def test_a_drive_that_cannot_be_solved_is_one_clear_line(
    drive: Path, tmp_path: Path, refused: Refused, override: str, output: str
) -> None:
    epoch = read_observations(drive / "rover.obs").epochs[0]
    station = StationHeader(marker="x", position_ecef_m=(-3.8e6, 3.5e6, 3.6e6))
    stray = [epoch, *(replace(epoch, time_ns=epoch.time_ns + 60 * NS) for _ in range(2))]
    (drive / "other.obs").write_text(observation_text(stray, station))
    manifest = (drive / "drive.toml").read_text()
    if "other" in override:
        manifest = 'name = "x"\nstart_s = 20.0\nend_s = 30.0\n' + manifest[manifest.index("[observations]") :]
        manifest = manifest[: manifest.index("[initial_pose]")]
    (drive / "changed.toml").write_text(manifest)
    argv = ("gnss", "solve", drive / "changed.toml", "--out", tmp_path / "out", "--set", override)
    line = refused(cli.main, *argv)
    assert output in line
    assert line.startswith("camber gnss solve: ")
    assert not (tmp_path / "out").exists()


def test_a_drive_without_raw_observations_is_refused(drive: Path, tmp_path: Path) -> None:
    manifest = load_manifest(drive / "drive.toml")
    without = DriveManifest.model_construct(**{**manifest.__dict__, "observations": None})
    with pytest.raises(ManifestError, match="no table observations"):
        gnss_solve.solve(without, EngineSettings(), tmp_path)


# the plot


def test_the_plot_has_a_key_with_the_number_of_each_quality(tmp_path: Path, solve: Solve) -> None:
    solve()
    texts = [
        text.text
        for text in ElementTree.parse(tmp_path / "engine.svg").iter("{http://www.w3.org/2000/svg}text")
    ]
    assert {"open-sky", "121 fixed", "height above the ellipsoid [m]"} <= set(texts)


def plotted(geodetic: np.ndarray, quality: list[str], name: str = "x") -> Figure:
    n = len(quality)
    none = np.full((n, 3, 3), np.nan)
    solved = SolvedDrive(
        time_ns=np.arange(n) * NS,
        quality=np.array(quality),
        continuity=np.full(n, "no_evidence"),
        position_ecef_m=none[:, 0],
        covariance_ecef_m2=none,
        satellites=np.full(n, 9),
        ratio=np.full(n, 5.0),
        age_s=np.zeros(n),
        reasons=Counter(),
        warnings=Counter(),
        epochs_per_s=None,
    )
    return solution_figure(name, solved, geodetic, 3.0)


def test_epochs_without_a_position_are_not_drawn_and_names_are_plain_text() -> None:
    figure = plotted(np.full((4, 3), np.nan), ["none"] * 4, 'a <script> & "b" $x$')
    assert not [line for axes in figure.axes for line in axes.lines if line.get_marker() == "."]
    texts = [element.text for element in ElementTree.fromstring(svg_text(figure)).iter()]
    assert 'a <script> & "b" $x$' in texts


def test_single_positions_do_not_set_the_scale_where_there_are_better_ones() -> None:
    geodetic = np.array([[0.6, 2.4, 50.0], [0.6 + 1e-7, 2.4, 50.1], [0.7, 2.4, 900.0]])
    track, heights, _, _ = plotted(geodetic, ["fixed", "float", "single"]).axes
    assert track.get_ylim()[1] < 10.0
    assert heights.get_ylim()[1] < 60.0
    labels = {str(line.get_label()) for line in track.lines}
    assert {label for label in labels if not label.startswith("_")} == {"single", "float", "fixed"}


# recordings


def test_rooftop_is_fixed_throughout(data: Path) -> None:
    folder = data / "rooftop-2024-06-24"
    recording = load_raw(folder / "rover.obs", folder / "base.obs", [folder / "base.nav"])
    assert "header" in recording.base_position_from
    solved = run_engine(recording, recording.rover, EngineSettings())
    assert (solved.quality == "fixed").all()

    def known(name: str) -> np.ndarray:
        latitude_deg, longitude_deg, height_m = map(
            float, (folder / name).read_text().replace(",", " ").split()
        )
        return np.array(
            ecef_from_geodetic_scalar(np.radians(latitude_deg), np.radians(longitude_deg), height_m)
        )

    assert recording.base_ecef_m is not None
    baseline_m = known("rover_position.txt") - known("base_position.txt")
    assert np.linalg.norm(solved.position_ecef_m - recording.base_ecef_m - baseline_m, axis=1).max() < 0.015
