"""A drive comes as its files have it: in their order, late and repeated epochs too, byte for byte."""

import gzip
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.motion_csv import write_samples
from camber.formats.drive.truth_csv import TruthTable, read_truth
from camber.formats.errors import FormatError
from camber.formats.map_exchange.pcd import PointCloud, write_pcd
from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rinex.writer import StationHeader
from camber.replay.drive_inputs import Arrival, DriveInputs, prepare_drive
from camber.replay.lock_step.drive import ReceiverGreeting
from camber.replay.receiver_file import read_receiver_file, receive_times
from camber.replay.short_drive import START_NS, write_short_drive
from camber.replay.surrogates import true_motion
from camber.replay.sweep_files import SweepReader
from camber.road_map.release import read_release
from camber.schemas.drive import (
    DriveManifest,
    ImuFile,
    ManifestError,
    ReceiverFile,
    Surrogates,
    load_manifest,
)
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.motion import Imu
from support.gnss_files import observation_text, read_pos, recording
from support.nearest_surface import nearest_heights
from support.random_observations import random_epoch

NAGOYA = Path(__file__).parents[2] / "replay" / "nagoya.toml"
STEP_NS = 200_000_000


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_short_drive(tmp_path_factory.mktemp("drive"))


def lines_of(drive: Path, file: str = "receiver.pos") -> list[bytes]:
    return (drive.parent / file).read_bytes().splitlines(keepends=True)


def prepared(manifest: Path, folder: Path, **changes: Any) -> DriveInputs:
    return prepare_drive(load_manifest(manifest).model_copy(update=changes), folder / "work")


def rewritten(folder: Path, file: str, lines: list[bytes]) -> DriveInputs:
    """The short drive with other lines in one of its files."""
    manifest = write_short_drive(folder / "d")
    (folder / "d" / file).write_bytes(b"".join(lines))
    return prepared(manifest, folder)


def payload(inputs: DriveInputs) -> bytes:
    return b"".join(arrival.message.payload.tobytes() for arrival in inputs.receiver)


def test_all_bytes_of_the_receiver_arrive_in_the_order_of_the_file(drive: Path, tmp_path: Path) -> None:
    inputs = prepared(drive, tmp_path)
    assert payload(inputs) == (drive.parent / "receiver.pos").read_bytes()
    assert inputs.receiver[0].message.payload.tobytes().startswith(b"% (lat/lon/height=WGS84/ellipsoidal")


def test_a_drive_whose_only_folder_is_empty_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "sweeps").mkdir()
    manifest = tmp_path / "drive.toml"
    manifest.write_text('name = "try"\n[sweeps]\nfolder = "sweeps"\n')
    with pytest.raises(ManifestError, match=r"^try: no input has a sample, expected at least one$"):
        prepared(manifest, tmp_path)


def test_ticks_hold_everything_once_and_in_order(drive: Path, tmp_path: Path) -> None:
    inputs = prepared(drive, tmp_path)
    ticks = list(inputs.ticks())
    assert [tick.time_ns for tick in ticks] == sorted({tick.time_ns for tick in ticks})
    assert sum(len(tick.receiver) for tick in ticks) == len(inputs.receiver)
    assert sum(len(tick.motion) for tick in ticks) == len(inputs.motion)
    for tick in ticks:
        assert all(message.time_ns == tick.time_ns for message in (*tick.receiver, *tick.motion))


def test_late_and_repeated_epochs_arrive_where_they_stand_in_the_file(drive: Path, tmp_path: Path) -> None:
    lines = lines_of(drive)
    mixed = [*lines[:12], lines[7], lines[11], *lines[12:15], b"no position at all\n", *lines[15:]]
    inputs = rewritten(tmp_path, "receiver.pos", mixed)
    assert payload(inputs) == b"".join(mixed)
    times = [arrival.receive_time_ns for arrival in inputs.receiver]
    assert times == sorted(set(times))
    together = inputs.receiver[9].message.payload.tobytes()
    assert together == lines[11] + lines[7] + lines[11]
    assert inputs.receiver[9].receive_time_ns == START_NS + 9 * STEP_NS


def test_a_fix_from_the_far_future_does_not_hold_up_the_rest(drive: Path, tmp_path: Path) -> None:
    lines = lines_of(drive)
    mixed = [*lines[:12], lines[12].replace(b"2024/", b"2089/"), *lines[13:]]
    inputs = rewritten(tmp_path, "receiver.pos", mixed)
    assert payload(inputs) == b"".join(mixed)
    assert inputs.tick_times_ns[-1] == START_NS + 600 * STEP_NS


def test_receive_times_never_fall() -> None:
    t, day = START_NS, 86_400 * 10**9
    assert receive_times([t, t + 5, t + 3, t + 5, t + 9]) == [t, t + 5, t + 5, t + 5, t + 9]
    assert receive_times([t + 20 * day, t, t + 1]) == [t, t, t + 1]
    assert receive_times([]) == []


def test_a_part_of_a_drive_begins_with_the_header(drive: Path, tmp_path: Path) -> None:
    inputs = prepared(drive, tmp_path, start_s=10.0, end_s=12.0)
    assert inputs.tick_times_ns == tuple(START_NS + k * STEP_NS for k in range(50, 61))
    results = PosDecoder("receiver.pos").feed(payload(inputs))
    assert [r.time_ns for r in results if isinstance(r, ReceiverSolution)] == list(inputs.tick_times_ns)
    assert len(results) == 11


def test_late_motion_arrives_late_and_keeps_its_time(drive: Path, tmp_path: Path) -> None:
    rows = lines_of(drive, "motion.csv")
    inputs = rewritten(tmp_path, "motion.csv", [*rows[:10], rows[5], *rows[10:]])
    late = inputs.motion[9]
    assert late.message.time_ns == START_NS + 4 * STEP_NS
    assert late.receive_time_ns == START_NS + 8 * STEP_NS


def test_inertial_samples_arrive_when_they_are_measured(drive: Path, tmp_path: Path) -> None:
    samples = [
        Imu(
            time_ns=START_NS + k * 5_000_000,
            angular_rate_rad_s=(0.0, 0.0, 0.1),
            specific_force_m_s2=(0.0, 0.0, 9.8),
        )
        for k in range(41)
    ]
    write_samples(tmp_path / "imu.csv", Imu, samples)
    table = ImuFile.model_construct(file=tmp_path / "imu.csv", imu_class="mems")
    inputs = prepared(drive, tmp_path, imu=table, end_s=0.1)
    assert inputs.channels == ("receiver_bytes", "motion", "imu")
    assert [arrival.message for arrival in inputs.imu] == samples[:21]
    assert [tick.time_ns for tick in inputs.ticks() if tick.imu] == [one.time_ns for one in samples[:21]]


@pytest.mark.parametrize(
    ("file", "line", "text", "expected"),
    [
        ("motion.csv", 1, b"t,v\n", "header is 't,v', expected time_ns,wheel_speed_m_s"),
        ("motion.csv", 3, b"1400000000200000000,fast,,\n", "wheel_speed_m_s is 'fast', expected a number"),
        ("motion.csv", 3, b"1400000000200000000,nan,,\n", "wheel_speed_m_s is 'nan'"),
        ("motion.csv", 3, b"12,1.0,,\n", "time_ns is '12'"),
        ("motion.csv", 3, b"12\n", "columns is '1 fields', expected 4 fields"),
        ("truth.csv", 1, b"time\n", "header is 'time'"),
        ("truth.csv", 3, b"0,0,0,0,0,0,0,0,0,0,0\n", "time, expected later than in the row before"),
        ("truth.csv", 3, b"0,x,0,0,0,0,0,0,0,0,0\n", "latitude_deg is 'x', expected a number"),
        ("truth.csv", 3, b"0,inf,0,0,0,0,0,0,0,0,0\n", "latitude_deg is 'inf', expected a finite"),
        ("truth.csv", 2, b"0,0,0,0,0,0,0,0,0,0,yes\n", "fix_wrong is 'yes', expected 0, 1 or nothing"),
    ],
)
def test_a_fault_in_a_file_is_one_line(
    drive: Path, tmp_path: Path, file: str, line: int, text: bytes, expected: str
) -> None:
    rows = lines_of(drive, file)
    rows[line - 1] = text
    with pytest.raises(FormatError) as caught:
        rewritten(tmp_path, file, rows)
    assert str(caught.value).startswith(f"{file}:{line}: {expected}")


def test_a_receiver_file_without_positions_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"receiver\.pos: epochs, expected at least one position"):
        rewritten(tmp_path, "receiver.pos", [b"% nothing\n"])


def swept(folder: Path) -> Path:
    """The short drive with sweeps of one point that end with its second, third and fourth epoch."""
    manifest = write_short_drive(folder)
    (folder / "sweeps").mkdir()
    for k in (1, 2, 3):
        cloud = PointCloud(points_m=np.full((1, 3), k, np.float32))
        write_pcd(folder / "sweeps" / f"{START_NS + k * STEP_NS}.pcd", cloud)
    manifest.write_text(manifest.read_text() + '\n[sweeps]\nfolder = "sweeps"\n')
    return manifest


def test_sweeps_come_at_the_time_of_their_end_and_are_not_read_before(tmp_path: Path) -> None:
    inputs = prepared(swept(tmp_path / "d"), tmp_path)
    assert "sweep" in inputs.channels
    at = {tick.time_ns: tick.sweeps for tick in inputs.ticks() if tick.sweeps}
    assert list(at) == [START_NS + k * STEP_NS for k in (1, 2, 3)]
    (file,) = at[START_NS + 2 * STEP_NS]
    write_pcd(file.path, PointCloud(points_m=np.full((1, 3), 9.0, np.float32)))
    assert file.read().points_m.tolist() == [[9.0, 9.0, 9.0]]


def test_sweeps_outside_of_the_part_of_a_drive_are_left_out(tmp_path: Path) -> None:
    inputs = prepared(swept(tmp_path / "d"), tmp_path, end_s=0.5)
    assert [file.time_ns for file in inputs.sweeps] == [START_NS + k * STEP_NS for k in (1, 2)]


def test_a_point_cloud_whose_name_is_no_time_is_left_out_and_named(tmp_path: Path) -> None:
    manifest = swept(tmp_path / "d")
    (tmp_path / "d" / "sweeps" / "first.pcd").write_bytes(b"")
    inputs = prepared(manifest, tmp_path)
    assert len(inputs.sweeps) == 3
    assert inputs.notes == (
        "a sweep is left out: first.pcd: name, expected the GPS time of the sweep's end in ns, then .pcd",
    )


def test_sweeps_that_are_damaged_or_gone_cost_themselves_and_one_line(tmp_path: Path) -> None:
    inputs = prepared(swept(tmp_path / "d"), tmp_path)
    reader = SweepReader()
    assert len(list(reader.read(inputs.sweeps))) == 3
    assert reader.notes() == ()
    first, second, third = inputs.sweeps
    first.path.write_bytes(b"no cloud")
    third.path.unlink()
    assert [sweep.time_ns for sweep in reader.read(inputs.sweeps)] == [second.time_ns]
    (line,) = reader.notes()
    assert line.startswith(f"2 sweeps could not be read and left out, the first: {first.path.name}:1: header")


def raw(folder: Path, *, receiver: bool = True) -> Path:
    """The short drive with raw observations at its first ten epochs, and a base that began earlier."""
    manifest = write_short_drive(folder)
    rng = np.random.default_rng(3)
    times = [START_NS + k * STEP_NS for k in range(10)]
    for name, first in (("rover", times), ("base", [START_NS - 10**9, *times])):
        station = StationHeader(marker=name, position_ecef_m=(-3_850_000.0, 3_430_000.0, 3_740_000.0))
        text = observation_text([random_epoch(rng, t, satellites=4) for t in first], station)
        (folder / f"{name}.obs.gz").write_bytes(gzip.compress(text.encode("ascii")))
    (folder / "brdc.nav").write_text(
        "     3.04           N: GNSS NAV DATA".ljust(60) + "RINEX VERSION / TYPE\n" * 4000
    )
    table = (
        '\n[observations]\nrover_obs = "rover.obs.gz"\nbase_obs = "base.obs.gz"\nephemerides = ["brdc.nav"]\n'
    )
    text = manifest.read_text() + table
    if not receiver:
        text = text.replace('[receiver]\nformat = "pos"\nfile = "receiver.pos"\n', "")
    manifest.write_text(text)
    return manifest


def stream_arrivals(
    inputs: DriveInputs, stream: str, protocol: str = "rinex"
) -> list[Arrival[ReceiverBytes]]:
    return [a for a in inputs.receiver if (a.message.stream, a.message.protocol) == (stream, protocol)]


def joined(arrivals: list[Arrival[ReceiverBytes]]) -> bytes:
    return b"".join(arrival.message.payload.tobytes() for arrival in arrivals)


@pytest.mark.parametrize("receiver", [True, False])
def test_raw_observations_come_epoch_by_epoch_with_the_receivers_solutions(
    tmp_path: Path, receiver: bool
) -> None:
    inputs = prepared(raw(tmp_path / "d", receiver=receiver), tmp_path)
    rover, base = stream_arrivals(inputs, "rover"), stream_arrivals(inputs, "base")
    assert joined(rover) == gzip.decompress((tmp_path / "d" / "rover.obs.gz").read_bytes())
    assert [a.receive_time_ns for a in rover] == [START_NS + k * STEP_NS for k in range(10)]
    # What the base sent before the drive began is left out, but for its header.
    assert [a.receive_time_ns for a in base] == [a.receive_time_ns for a in rover]
    assert joined(base).startswith(b"     3.04           OBSERVATION DATA")
    assert bool(stream_arrivals(inputs, "rover", "pos")) == receiver
    first = next(inputs.ticks())
    order = [(m.stream, m.protocol) for m in first.receiver]
    whole = [("ephemerides", "rinex")] * 2
    assert order == [*whole, ("base", "rinex"), ("rover", "rinex"), *([("rover", "pos")] if receiver else [])]
    assert all(len(m.payload) <= 64_000 for m in first.receiver[:2])
    assert joined(stream_arrivals(inputs, "ephemerides")) == (tmp_path / "d" / "brdc.nav").read_bytes()


def test_a_client_that_connects_later_gets_headers_and_ephemerides(tmp_path: Path) -> None:
    inputs = prepared(raw(tmp_path / "d"), tmp_path)
    parts = {(m.stream, m.protocol): m.payload.tobytes() for m in inputs.greeting}
    assert set(parts) == {
        ("ephemerides", "rinex"), ("base", "rinex"), ("rover", "rinex"), ("rover", "pos")
    }  # fmt: skip
    assert parts["rover", "rinex"].splitlines()[-1].rstrip().endswith(b"END OF HEADER")
    assert parts["rover", "pos"].startswith(b"%")
    greeting = ReceiverGreeting(inputs)
    everybody, nobody = frozenset({"gnss"}), frozenset[str]()
    assert list(greeting.messages(START_NS, everybody)) == []
    assert list(greeting.messages(START_NS, nobody)) == []
    again = list(greeting.messages(START_NS + 7, everybody))
    assert [m.payload.tobytes() for m in again] == [m.payload.tobytes() for m in inputs.greeting]
    assert {m.time_ns for m in again} == {START_NS + 7}
    assert list(greeting.messages(START_NS + 8, everybody)) == []


def noted(folder: Path, rows: list[str]) -> DriveInputs:
    """The short drive, whose receiver's file has arrivals noted down."""
    manifest = write_short_drive(folder / "d")
    (folder / "d" / "arrivals.csv").write_text(
        "arrival_time_ns,end_byte\n" + "".join(f"{row}\n" for row in rows)
    )
    text = manifest.read_text()
    manifest.write_text(
        text.replace('file = "receiver.pos"\n', 'file = "receiver.pos"\narrivals = "arrivals.csv"\n')
    )
    return prepared(manifest, folder)


def test_bytes_arrive_when_their_recorder_noted_them_down(drive: Path, tmp_path: Path) -> None:
    data = (drive.parent / "receiver.pos").read_bytes()
    header = len(b"".join(line for line in lines_of(drive) if line.startswith(b"%")))
    ends = [10, header + 5, header + 700, len(data)]
    rows = [f"{START_NS + 40 * k},{end}" for k, end in enumerate(ends)]
    inputs = noted(tmp_path, rows)
    arrived = [(a.receive_time_ns - START_NS, len(a.message.payload)) for a in inputs.receiver]
    assert arrived == [(40, header + 5), (80, 695), (120, len(data) - ends[2])]
    assert payload(inputs) == data


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (["x,5"], "arrivals.csv:2: row is 'x,5', expected two whole numbers"),
        ([f"{START_NS},5,6"], "arrivals.csv:2: row is"),
        ([f"{START_NS},50", f"{START_NS - 1},60"], "arrivals.csv:3: arrival_time_ns is"),
        (["5,50"], "arrivals.csv:2: arrival_time_ns is '5,50', expected a GPS time in ns"),
        ([f"{START_NS},50", f"{START_NS},50"], "arrivals.csv:3: end_byte is"),
        ([f"{START_NS},5000000"], "arrivals.csv:2: end_byte is"),
        ([f"{START_NS},50"], "arrivals.csv: end_byte is '50', expected the file's"),
        ([], "arrivals.csv: end_byte is '0', expected the file's"),
    ],
)
def test_arrivals_that_do_not_fit_the_file_are_one_line(
    tmp_path: Path, rows: list[str], expected: str
) -> None:
    with pytest.raises(FormatError) as caught:
        noted(tmp_path, rows)
    assert str(caught.value).startswith(expected)


def test_a_surrogate_map_is_written_and_says_how_it_was_made(drive: Path, tmp_path: Path) -> None:
    surrogates = Surrogates(inputs=("links", "road_surfaces", "initial_pose"))
    inputs = prepared(drive, tmp_path, map=None, initial_pose=None, surrogates=surrogates)
    assert inputs.map_release == tmp_path / "work" / "map"
    assert "made from the drive's own truth, seed 1" in read_release(inputs.map_release).manifest.surrogate
    assert inputs.initial_pose is not None


def test_nmea_is_cut_into_epochs_across_midnight(tmp_path: Path) -> None:
    """Over midnight UTC: epochs of three sentences, one without a position, a damaged line."""
    write_short_drive(tmp_path / "d")
    solutions = [s for s in read_pos(tmp_path / "d" / "receiver.pos") if isinstance(s, ReceiverSolution)][:8]
    midnight_ns = 1_400_025_618_000_000_000  # 2024-05-18T00:00:00 UTC
    times = [midnight_ns + (k - 4) * STEP_NS for k in range(8)]
    lines: list[bytes] = []
    for time_ns, solution in zip(times, solutions, strict=True):
        moved = replace(solution, time_ns=time_ns, satellites=9)
        lines += [format_rmc(moved), format_gga(moved, geoid_separation_m=37.0), format_gst(moved)]
    lines.insert(7, b"$GNGGA,damaged\r\n")
    path = tmp_path / "receiver.nmea"
    path.write_bytes(b"".join(lines))
    receiver = ReceiverFile.model_construct(format="nmea", file=path, utc_date=None)
    preamble, epochs = read_receiver_file(receiver)
    assert preamble == b""
    assert [epoch.time_ns for epoch in epochs] == times
    assert b"".join(epoch.payload for epoch in epochs) == b"".join(lines)
    assert epochs[0].payload == b"".join(lines[:3])


@pytest.fixture(scope="module")
def nagoya() -> DriveManifest:
    recording("nagoya-2023-07-11")
    return load_manifest(NAGOYA)


@pytest.fixture(scope="module")
def reference(nagoya: DriveManifest) -> TruthTable:
    return read_truth(nagoya.truth.file, nagoya.truth.format)


def test_nagoya_stands_still_quietly_and_reverses_once_at_the_end(reference: TruthTable) -> None:
    motion = true_motion(reference, 2.7)
    speed = motion.wheel_speed_m_s
    standing = np.abs(speed) < 0.02
    assert standing.sum() > 2500
    assert np.rad2deg(np.std(motion.yaw_rate_rad_s[standing])) < 0.03
    backwards = np.flatnonzero(speed < -0.1)
    assert (len(backwards) > 80, backwards[0] > 5900) == (True, True)
    assert speed.min() > -1.0


def test_nagoya_is_prepared_with_a_surrogate_map_under_every_epoch(
    nagoya: DriveManifest, tmp_path: Path
) -> None:
    inputs = prepare_drive(nagoya, tmp_path)
    assert (len(inputs.truth), len(inputs.motion), len(inputs.receiver)) == (6151, 6151, 5395)
    # 185 epochs of the receiver lie a few milliseconds beside those of the reference.
    assert len(inputs.tick_times_ns) == 6151 + 185
    surfaces = read_release(inputs.map_release).road_surfaces()
    _, outside_m = nearest_heights(surfaces, inputs.truth.latitude_rad, inputs.truth.longitude_rad)
    assert (outside_m == 0.0).all()
    assert (surfaces.level == 0).all()
