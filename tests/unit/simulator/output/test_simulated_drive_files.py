"""A simulated drive is native files with the truth next to them: consistent, repeatable, with the faults asked for."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.motion_csv import read_samples
from camber.formats.drive.recording import read_recording
from camber.formats.drive.truth_csv import TruthTable, read_truth
from camber.formats.map_exchange.pcd import read_sweep
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.rtcm.reader import RtcmDecoder
from camber.geodesy.local_frame import LocalFrame
from camber.map_server.elevation_queries import ElevationMap
from camber.replay.drive_inputs import prepare_drive
from camber.road_map.release import read_release
from camber.schemas.drive import load_manifest
from camber.schemas.motion import Imu, Motion, Ranging, Suspension
from camber.simulator.scenario import load_scenario
from camber.tools import simulate as tool
from support.gnss_files import read_pos

NS = 1_000_000_000


def make(folder: Path, name: str, *overrides: str) -> Path:
    tool.simulate(load_scenario(name, [*overrides]), folder, quiet=True)
    return folder


def digest(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def solutions(folder: Path) -> list[ReceiverSolution]:
    return [item for item in read_pos(folder / "receiver.pos") if isinstance(item, ReceiverSolution)]


def errors_m(folder: Path, truth: TruthTable) -> dict[int, np.ndarray]:
    """By time: solution less truth, east, north, up."""
    place = {t: k for k, t in enumerate(truth.time_ns.tolist())}
    errors = {}
    for solution in solutions(folder):
        k = place.get(solution.time_ns)
        if k is None:
            continue
        frame = LocalFrame(float(truth.latitude_rad[k]), float(truth.longitude_rad[k]), 0.0)
        east, north = frame.east_north_from_geodetic(solution.latitude_rad, solution.longitude_rad, 0.0)
        errors[solution.time_ns] = np.array([east, north, solution.height_m - truth.height_m[k]])
    return errors


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("city") / "drive", "city", "duration_s=12.0", "lidar.beams=32")


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def fault(kind: str, onset_s: float, end_s: float, **more: Any) -> str:
        values = ", ".join(f"{key} = {json.dumps(value)}" for key, value in more.items())
        return f'{{kind = "{kind}", onset_s = {onset_s}, end_s = {end_s}{", " + values if values else ""}}}'

    faults = ",".join(
        [
            fault("wrong_base", 5.0, 8.0, east_m=12.0, up_m=-4.0),
            fault("time_jump", 10.0, 11.0, offset_s=3.5),
            fault("repeated_epochs", 13.0, 14.0),
            fault("missing_epochs", 16.0, 18.0),
            fault("spoofing", 20.0, 24.0, north_m_s=1.0),
            fault("wheel_slip", 20.0, 24.0, factor=1.5),
            fault("wrong_map", 0.0, 30.0, offset_m=0.7),
        ]
    )
    folder = tmp_path_factory.mktemp("faulty") / "drive"
    return make(folder, "open-sky", "duration_s=30.0", f"faults=[{faults}]")


def test_every_file_can_be_read_by_its_reader(city: Path) -> None:
    manifest = load_manifest(city / "drive.toml")
    assert manifest.simulated
    assert len(solutions(city)) > 100
    assert len(read_samples(city / "motion.csv", Motion)) == pytest.approx(120, abs=2)
    assert len(read_samples(city / "suspension.csv", Suspension)) == pytest.approx(120, abs=2)
    assert len(read_samples(city / "ranging.csv", Ranging)) == pytest.approx(119, abs=6)
    sweeps = sorted((city / "sweeps").iterdir())
    assert len(sweeps) == 120
    sweep = read_sweep(sweeps[60], "lidar")
    assert len(sweep.points_m) > 5000
    assert read_release(city / "map").manifest.surrogate.startswith("simulated survey")
    assert (city / "rover.obs").read_text().startswith("     3.04           OBSERVATION DATA")
    decoder = RtcmDecoder(load_scenario("city").start_ns)
    assert len(decoder.feed((city / "base.rtcm").read_bytes())) > 120
    assert (decoder.failed_checks, decoder.malformed) == (0, 0)


def test_the_truth_is_consistent(city: Path) -> None:
    truth = read_truth(city / "truth.csv", "camber")
    assert len(truth) == 121
    assert truth.height_m == pytest.approx(
        truth.more["road_height_m"] + truth.more["antenna_height_m"], abs=1e-3
    )
    frame = LocalFrame(float(truth.latitude_rad[0]), float(truth.longitude_rad[0]), 0.0)
    place_m = frame.east_north_from_geodetic_array(truth.latitude_rad, truth.longitude_rad, truth.height_m)
    velocity = truth.velocity_enu_m_s[:, :2]
    driven_m = np.cumsum(0.05 * (velocity[1:] + velocity[:-1]), axis=0)
    # Trapezia of 0.1 s: the antenna swings by some centimetres within them.
    assert driven_m == pytest.approx(place_m[1:] - place_m[0], abs=0.03)


def test_the_measured_tilt_is_near_the_truth_and_not_the_truth(city: Path) -> None:
    truth = read_truth(city / "truth.csv", "camber")
    rows = [(m.time_ns, m.pitch_rad, m.roll_rad) for m in read_samples(city / "motion.csv", Motion)]
    rows = [row for row in rows if None not in row]
    assert len(rows) > 100
    at = np.array([time_ns for time_ns, *_ in rows]) - truth.time_ns[0]
    measured = np.array([angles for _, *angles in rows], np.float64)
    for column, true in zip(measured.T, (truth.pitch_rad, truth.roll_rad), strict=True):
        off = column - np.interp(at, truth.time_ns - truth.time_ns[0], true)
        assert np.abs(off).max() < np.radians(1.5)
        assert off.std() > np.radians(0.05)


def test_right_fixes_are_near_the_truth_and_the_flag_marks_those_that_are_not(city: Path) -> None:
    truth = read_truth(city / "truth.csv", "camber")
    assert truth.fix_state is not None
    states = dict(zip(truth.time_ns.tolist(), truth.fix_state.tolist(), strict=True))
    errors = errors_m(city, truth)
    quality = {solution.time_ns: solution.quality for solution in solutions(city)}
    for time_ns, error in errors.items():
        fixed = quality[time_ns] == SolutionQuality.FIX
        assert states[time_ns] == (2 if not fixed else int(np.linalg.norm(error) > 0.5)), time_ns


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    short = ("duration_s=4.0", "lidar.beams=32", "lidar.traffic=2")
    first = digest(make(tmp_path / "a", "overpass", *short))
    assert digest(make(tmp_path / "b", "overpass", *short)) == first
    other = digest(make(tmp_path / "a", "overpass", "seed=2", *short))
    same = {name for name in first.keys() & other.keys() if first[name] == other[name]}
    # When its lines were sent, and how long they are, does not depend on their content.
    assert same <= {"receiver_arrivals.csv"}


def test_an_inertial_unit_adds_its_file_and_leaves_all_others_as_they_are(tmp_path: Path) -> None:
    short = ("duration_s=6.0", "lidar.beams=32", "lidar.traffic=2")
    plain = digest(make(tmp_path / "a", "overpass", *short))
    folder = make(
        tmp_path / "b", "overpass", *short, "imu.class=phone", "imu.rate_hz=100", "imu.yaw_deg=90.0"
    )
    with_unit = digest(folder)
    described = {"drive.toml", "scenario.json"}
    assert with_unit.keys() - plain.keys() == {"imu.csv"}
    assert {name for name in plain if plain[name] != with_unit[name]} == described
    manifest = load_manifest(folder / "drive.toml")
    assert manifest.imu is not None
    mounted = manifest.imu.model_dump(exclude={"file"})
    assert mounted == {
        **{"imu_class": "phone", "x_m": 0.2, "y_m": -0.1, "z_m": 0.4},
        **{"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 90.0},
    }
    samples = read_samples(manifest.imu.file, Imu)
    assert len(samples) == pytest.approx(601, abs=2)
    # Its y looks backwards: the vehicle speeds up from its rest of one second on.
    forces = np.array([sample.specific_force_m_s2 for sample in samples])
    assert forces[:, 2].mean() == pytest.approx(9.8, abs=0.9)
    assert forces[250:400, 1].mean() - forces[:90, 1].mean() < -0.5
    inputs = prepare_drive(manifest, tmp_path)
    assert len(inputs.imu) == len(samples)


def test_a_vehicle_without_wheel_speed_has_no_motion_and_all_else(tmp_path: Path) -> None:
    short = ("duration_s=4.0", "satellites.streams=false", "imu.class=tactical")
    plain = digest(make(tmp_path / "a", "open-sky", *short))
    folder = make(tmp_path / "b", "open-sky", *short, "motion=false")
    without = digest(folder)
    assert plain.keys() - without.keys() == {"motion.csv"}
    assert {name for name in without if plain[name] != without[name]} == {"drive.toml", "scenario.json"}
    manifest = load_manifest(folder / "drive.toml")
    assert manifest.motion is None
    assert manifest.imu is not None


def test_a_wrong_base_moves_all_fixes_alike_and_the_stations_message(faulty: Path) -> None:
    truth = read_truth(faulty / "truth.csv", "camber")
    wrong = truth.more["fault_wrong_base"] == 1.0
    errors = errors_m(faulty, truth)
    moved = np.array([errors[t] for t in truth.time_ns[wrong].tolist()])
    assert wrong.sum() == 30
    assert moved == pytest.approx(np.tile([12.0, 0.0, -4.0], (30, 1)), abs=0.1)
    assert truth.fix_state is not None
    assert (truth.fix_state[wrong] == 1).all()
    assert truth.more["fix_wrong_since_s"][wrong] == pytest.approx(5.0)
    # It is the station that is wrong, not the integers.
    assert (truth.more["fix_integers_wrong"][wrong] == 0.0).all()
    decoder = RtcmDecoder(int(truth.time_ns[0]))
    items = decoder.feed((faulty / "base.rtcm").read_bytes())
    stations = {item.position_ecef_m for item in items if hasattr(item, "position_ecef_m")}
    assert len(stations) == 2
    a, b = (np.array(place) for place in stations)
    assert np.linalg.norm(a - b) == pytest.approx(np.hypot(12.0, 4.0), abs=1e-3)


def test_a_clock_that_jumps_repeats_and_stops_is_in_the_receivers_file(faulty: Path) -> None:
    start_ns = load_scenario("open-sky").start_ns
    reported_s = [(solution.time_ns - start_ns) / NS for solution in solutions(faulty)]
    # Ten epochs twice each, and the ten of a second that is dated 3.5 s late: five of them fall into this one.
    assert sum(13.0 <= s < 14.0 for s in reported_s) == 25
    assert not [s for s in reported_s if 16.0 <= s < 18.0]
    # What is sent at 10 s is dated 13.5 s, and comes before what is sent at 11 s.
    assert reported_s.index(13.5) < reported_s.index(11.0)


def test_output_of_a_receiver_arrives_when_it_is_sent_whatever_its_clock(
    faulty: Path, tmp_path: Path
) -> None:
    start_ns = load_scenario("open-sky").start_ns
    inputs = prepare_drive(load_manifest(faulty / "drive.toml"), tmp_path)
    decoder = PosDecoder("receiver")
    received: dict[int, list[int]] = {}
    observed: dict[int, bytes] = {}
    for arrival in inputs.receiver:
        tenths = round((arrival.receive_time_ns - start_ns) / 1e8)
        data = arrival.message.payload.tobytes()
        if arrival.message.protocol == "pos":
            read = [item for item in decoder.feed(data) if isinstance(item, ReceiverSolution)]
            received[tenths] = [round((solution.time_ns - start_ns) / 1e8) for solution in read]
        elif arrival.message.stream == "rover":
            observed[tenths] = data
    # Its clock is 3.5 s ahead for a second from 10 s on: received when sent, and at once in order again.
    for tenths in range(90, 130):
        off = 35 if 100 <= tenths < 110 else 0
        assert received[tenths] == [tenths + off]
        assert observed[tenths].startswith(f"> 2026 03 20 01 30 {(tenths + off) / 10:10.7f}".encode())
    assert received[130] == [130, 130]
    assert not [tenths for tenths in received if 160 <= tenths < 180]


def test_spoofing_leads_away_and_the_wheels_slip_where_the_truth_has_it(faulty: Path) -> None:
    truth = read_truth(faulty / "truth.csv", "camber")
    errors = errors_m(faulty, truth)
    led = [t for t, on in zip(truth.time_ns.tolist(), truth.more["fault_spoofing"], strict=True) if on]
    drift = np.array([errors[t][1] for t in led])
    assert drift[-1] - drift[0] == pytest.approx(1.0 * (led[-1] - led[0]) / NS, abs=0.1)
    slips = (truth.more["fault_wheel_slip"] == 1.0) & (truth.more["speed_m_s"] > 3.0)
    middle = np.flatnonzero(slips)[8:-8]
    ratio = truth.more["wheel_speed_m_s"][middle] / truth.more["speed_m_s"][middle]
    assert ratio == pytest.approx(1.5, rel=0.02)


def test_a_wrong_map_is_wrong_where_the_vehicle_drives(faulty: Path) -> None:
    truth = read_truth(faulty / "truth.csv", "camber")
    assert set(truth.more["map_wrong_m"].tolist()) == {0.7}
    release = read_release(faulty / "map")
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum="WGS84", map_version=1)
    roads = the_map.roads(truth.latitude_rad, truth.longitude_rad)
    off_m = roads.elevation_m - truth.more["road_height_m"][roads.known]
    assert len(roads.known) > 250
    assert np.median(off_m) == pytest.approx(0.7, abs=0.1)


def test_a_fleet_is_a_map_a_recording_of_uploads_and_the_truth(tmp_path: Path) -> None:
    folder = make(tmp_path / "fleet", "fleet", "fleet.vehicles=8", "fleet.drives_each=2", "duration_s=60.0")
    batches = list(read_recording(folder / "uploads.mcap"))
    records = sum(len(item.message.surface_id) for item in batches)
    assert records == pytest.approx(8 * 2 * 300, rel=0.02)
    assert {item.message.vehicle for item in batches} == {f"car{k:05d}" for k in range(8)}
    assert len((folder / "vehicles.csv").read_text().splitlines()) == 9
    assert len((folder / "changes.csv").read_text().splitlines()) > 2


def test_a_folder_that_holds_something_else_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    assert tool.main(["open-sky", "--out", str(tmp_path)]) == 2
    assert "not empty, expected a new folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]


def test_a_fault_that_does_not_fit_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fault = '{kind = "wheel_slip", onset_s = 5.0, end_s = 5.2, factor = 1.2}'
    code = tool.main(["open-sky", "--out", str(tmp_path / "x"), "--set", f"faults=[{fault}]"])
    assert code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "wheel_slip" in line


def test_epochs_that_are_missing_have_no_fix_in_the_truth(faulty: Path) -> None:
    truth = read_truth(faulty / "truth.csv", "camber")
    assert truth.fix_state is not None
    missing = truth.more["fault_missing_epochs"] == 1.0
    assert missing.sum() == 20
    assert (truth.fix_state[missing] == 2).all()


def test_a_robot_is_as_long_as_it_is_and_any_description_can_be_read_back(tmp_path: Path) -> None:
    text = 'a "bad" street, C:\\\\roads'
    folder = make(tmp_path / "robot", "open-sky", "vehicle=robot", "duration_s=5.0", f"description='{text}'")
    manifest = load_manifest(folder / "drive.toml")
    assert manifest.description == text
    assert manifest.surrogates.wheelbase_m == pytest.approx(0.55)
    assert manifest.antenna_height.way == "fixed"
    assert manifest.suspension is None
    assert not (folder / "suspension.csv").exists()


def test_a_receiver_without_output_is_one_line_and_leaves_an_earlier_drive_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make(tmp_path / "drive", "open-sky", "duration_s=4.0", "satellites.streams=false")
    before = digest(folder)
    fault = '{kind = "missing_epochs", onset_s = 0.0}'
    code = tool.main(
        ["open-sky", "--out", str(folder), "--set", "duration_s=4.0", "--set", f"faults=[{fault}]"]
    )
    assert code == 2
    assert "the receiver says nothing" in capsys.readouterr().err
    assert digest(folder) == before
