"""`camber feed`: what goes onto the bus is the drive, dated now; the way back is the way there in reverse gear."""

from __future__ import annotations

import math
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.motion_csv import write_samples
from camber.formats.map_exchange.pcd import write_sweep
from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.replay.drive_inputs import prepare_drive
from camber.replay.short_drive import write_short_drive
from camber.replay.sweep_files import SweepReader
from camber.runtime.session import NobodyThereError
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.drive import load_manifest
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion
from camber.tools.record import feed
from camber.tools.record.feed import Epoch, epochs_of, passes, reversed_drive
from support.fake_bus import FakeBus
from support.gnss_files import read_pos
from support.refusals import Refused

_NS = 1_000_000_000
_START_NS = 1_500_000_000 * _NS


@pytest.fixture(scope="module")
def epochs(blind: Path) -> tuple[Epoch, ...]:
    return epochs_of(prepare_drive(load_manifest(blind), blind.parent))


def motions(epochs: Any) -> list[Motion]:
    return [message for epoch in epochs for _, message in epoch.samples if isinstance(message, Motion)]


class FedBus(FakeBus):
    """Keeps what is published, and when."""

    def __init__(self) -> None:
        super().__init__(_START_NS)
        self.sent: list[tuple[int, str, Message]] = []

    def publish(self, name: str, message: Message) -> None:
        self.sent.append((self.time_ns, name, message))


class FakeStop(threading.Event):
    """Waiting moves the bus's clock; `sleeps` are waits from which the machine wakes later."""

    def __init__(self, bus: FedBus, sleeps: dict[int, float] | None = None) -> None:
        super().__init__()
        self.bus, self.sleeps, self.waits = bus, sleeps or {}, 0

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        self.bus.time_ns += math.ceil((timeout + self.sleeps.get(self.waits, 0.0)) * _NS)
        self.waits += 1
        return self.is_set()


def test_every_solution_and_every_sample_of_the_drive_is_fed(blind: Path, epochs: tuple[Epoch, ...]) -> None:
    native = [item for item in read_pos(blind.parent / "receiver.pos") if isinstance(item, ReceiverSolution)]
    assert [solution for epoch in epochs for solution in epoch.solutions] == native
    assert len(motions(epochs)) == len((blind.parent / "motion.csv").read_text().splitlines()) - 1


def test_each_message_can_be_decoded_alone_and_equals_the_solution(epochs: tuple[Epoch, ...]) -> None:
    offset_ns = 123_456 * 1_000_000
    for epoch in epochs:
        for name, message in epoch.moved(offset_ns).messages(SweepReader()):
            if not isinstance(message, ReceiverBytes):
                continue
            assert (name, message.protocol) == ("receiver_bytes", "pos")
            assert message.time_ns == epoch.time_ns + offset_ns
            (read,) = PosDecoder("fed").feed(message.payload.tobytes())
            (native,) = epoch.solutions
            assert isinstance(read, ReceiverSolution)
            assert read.time_ns == native.time_ns + offset_ns
            assert read.quality == native.quality
            assert read.latitude_rad == pytest.approx(native.latitude_rad, abs=1e-11)
            assert read.height_m == pytest.approx(native.height_m, abs=1e-4)


def test_the_reversed_drive_ends_where_the_drive_began(epochs: tuple[Epoch, ...]) -> None:
    back = reversed_drive(epochs)
    assert [epoch.time_ns for epoch in back] == sorted(epoch.time_ns for epoch in back)
    assert (back[0].time_ns, back[-1].time_ns) == (epochs[0].time_ns, epochs[-1].time_ns)
    assert back[-1].solutions[0].latitude_rad == epochs[0].solutions[0].latitude_rad
    there = [(m.wheel_speed_m_s, m.yaw_rate_rad_s, m.steering_angle_rad) for m in motions(epochs)]
    again = [(m.wheel_speed_m_s, m.yaw_rate_rad_s, m.steering_angle_rad) for m in motions(back)]
    assert again == [(-speed, -rate, steering) for speed, rate, steering in reversed(there)]  # type: ignore[operator]


def test_reversed_twice_is_the_drive(epochs: tuple[Epoch, ...]) -> None:
    assert reversed_drive(reversed_drive(epochs)) == epochs


def test_a_missing_reading_stays_missing_in_reverse() -> None:
    epoch = Epoch(time_ns=_START_NS, samples=(("motion", Motion(time_ns=_START_NS, wheel_speed_m_s=1.0)),))
    (back,) = motions(reversed_drive([epoch]))
    assert (back.wheel_speed_m_s, back.yaw_rate_rad_s) == (-1.0, None)


def test_inertial_samples_are_fed_and_in_reverse_turn_back_under_the_same_forces(tmp_path: Path) -> None:
    samples = [
        Imu(
            time_ns=_START_NS + k * 5_000_000,
            angular_rate_rad_s=(0.1, 0.2, k / 10),
            specific_force_m_s2=(k, 0.5, 9.8),
        )
        for k in range(3)
    ]
    write_samples(tmp_path / "imu.csv", Imu, samples)
    manifest = tmp_path / "drive.toml"
    manifest.write_text('name = "turns"\n[imu]\nfile = "imu.csv"\nclass = "phone"\n')
    epochs = epochs_of(prepare_drive(load_manifest(manifest), tmp_path))
    assert [sample for epoch in epochs for sample in epoch.samples] == [("imu", sample) for sample in samples]
    back = [message for epoch in reversed_drive(epochs) for _, message in epoch.samples]
    assert [one.time_ns for one in back] == [one.time_ns for one in samples]
    assert [one.angular_rate_rad_s for one in back] == [(-0.1, -0.2, -k / 10) for k in (2, 1, 0)]
    assert [one.specific_force_m_s2 for one in back] == [(k, 0.5, 9.8) for k in (2, 1, 0)]
    assert reversed_drive(reversed_drive(epochs)) == epochs


def test_without_loop_the_drive_is_fed_once_and_with_it_there_and_back(epochs: tuple[Epoch, ...]) -> None:
    assert [*passes(epochs, loop=False)] == [epochs]
    drive_passes = passes(epochs, loop=True)
    back = reversed_drive(epochs)
    assert [next(drive_passes) for _ in range(4)] == [epochs, back, epochs, back]


def fed(epochs: Sequence[Epoch], sleeps: dict[int, float] | None = None) -> tuple[FedBus, tuple[int, int]]:
    """The bus of a pass, and what the pass returned."""
    bus = FedBus()
    stop = FakeStop(bus, sleeps)
    ended = feed.feed_pass(epochs, bus, stop, start_ns=_START_NS, reader=SweepReader())  # type: ignore[arg-type]
    return bus, ended


def test_messages_go_out_when_they_are_due_and_are_dated_so(epochs: tuple[Epoch, ...]) -> None:
    bus, ended = fed(epochs[:50])
    assert max(abs(at - message.time_ns) for at, _, message in bus.sent) <= 1_000_000
    times = [message.time_ns for _, name, message in bus.sent if name == "motion"]
    assert times == [_START_NS + n * _NS // 5 for n in range(50)]
    assert ended == (_START_NS + 10 * _NS, 0)


def test_what_a_machine_was_too_late_for_is_left_out_and_nothing_is_moved(epochs: tuple[Epoch, ...]) -> None:
    """As a vehicle drives on: its wheels turned, so it is further."""
    bus, ended = fed(epochs[:50], {20: 3.05})
    times = [message.time_ns for _, name, message in bus.sent if name == "motion"]
    # The one that was waited for would be 3.05 s late, and twelve more would be by over half a second.
    published = [n for n in range(50) if not 20 <= n < 33]
    assert times == [_START_NS + n * _NS // 5 for n in published]
    assert ended == (_START_NS + 10 * _NS, 13)
    assert max(at - message.time_ns for at, _, message in bus.sent) <= _NS // 2


def test_after_a_machine_slept_for_long_the_drive_goes_on_from_where_it_was(
    epochs: tuple[Epoch, ...],
) -> None:
    bus, ended = fed(epochs[:50], {20: 90.0})
    moved = [message for _, name, message in bus.sent if name == "motion"]
    assert len(moved) == 50
    assert max(at - message.time_ns for at, _, message in bus.sent) < 1_000_000
    assert moved[-1].time_ns > _START_NS + 99 * _NS
    assert ended[1] == 0


def test_passes_that_a_machine_was_late_for_are_reported(epochs: tuple[Epoch, ...], capsys) -> None:
    bus = FedBus()
    feed.feed_passes(iter([epochs[:50]]), bus, FakeStop(bus, {20: 3.05}), drive="drive")  # type: ignore[arg-type]
    expected = "camber feed: this machine was too slow: 13 of 50 epochs were not published"
    assert expected in capsys.readouterr().err


def test_it_stops_on_request(epochs: tuple[Epoch, ...]) -> None:
    bus = FedBus()
    stop = FakeStop(bus)
    stop.set()
    feed.feed_passes(passes(epochs, loop=True), bus, stop, drive="drive")  # type: ignore[arg-type]
    assert bus.sent == []


def test_nmea_sentences_are_fed_in_their_epoch(blind: Path, tmp_path: Path) -> None:
    items = read_pos(blind.parent / "receiver.pos")
    native = [item for item in items if isinstance(item, ReceiverSolution)][:40]
    sentences = [format_rmc(s) + format_gst(s) + format_gga(s, geoid_separation_m=37.0) for s in native]
    (tmp_path / "receiver.nmea").write_bytes(b"".join(sentences))
    manifest = tmp_path / "drive.toml"
    manifest.write_text(
        'name = "sentences"\nvehicle = "demo"\nsimulated = true\ndatum = "WGS84"\n'
        '[receiver]\nformat = "nmea"\nfile = "receiver.nmea"\n'
        '[antenna_height]\nway = "fixed"\nheight_m = 1.6\nsigma_m = 0.02\n'
    )
    epochs = epochs_of(prepare_drive(load_manifest(manifest), tmp_path))
    times = [(epoch.time_ns, solution.time_ns) for epoch in epochs for solution in epoch.solutions]
    # The first epoch shows which sentence is an epoch's last; from then on none waits for the next.
    assert all(fed_ns == solution_ns for fed_ns, solution_ns in times[2:])
    assert len(times) >= len(native) - 1


SWEEP_NS = 100_000_000


@pytest.fixture
def swept(blind: Path, tmp_path: Path) -> tuple[Epoch, ...]:
    """The short drive's first 50 epochs, with sweeps of three points that end 0.3, 0.4, 0.5 s after its start."""
    write_short_drive(tmp_path)
    (tmp_path / "sweeps").mkdir()
    start_ns = epochs_of(prepare_drive(load_manifest(blind), tmp_path))[0].time_ns
    for k in (3, 4, 5):
        points = np.arange(9, dtype=np.float32).reshape(3, 3) + k
        offset_ns = np.array([1 - SWEEP_NS, -SWEEP_NS // 4, 0], np.int32)
        time_ns = start_ns + k * SWEEP_NS
        values = {"points_m": points, "intensity": points[:, 0], "offset_ns": offset_ns}
        write_sweep(tmp_path / "sweeps", Sweep(time_ns=time_ns, sensor="lidar", **values))
    text = (tmp_path / "drive.toml").read_text()
    (tmp_path / "drive.toml").write_text(text + '\n[sweeps]\nfolder = "sweeps"\n')
    return epochs_of(prepare_drive(load_manifest(tmp_path / "drive.toml"), tmp_path))[:50]


def sweeps_of(bus: FedBus) -> list[tuple[int, Sweep]]:
    return [(at, message) for at, _, message in bus.sent if isinstance(message, Sweep)]


def test_sweeps_go_out_at_their_time_and_are_dated_so(swept: tuple[Epoch, ...]) -> None:
    sweeps = sweeps_of(fed(swept)[0])
    assert [sweep.time_ns - _START_NS for _, sweep in sweeps] == [k * SWEEP_NS for k in (3, 4, 5)]
    assert all(abs(at - sweep.time_ns) <= 1_000_000 for at, sweep in sweeps)
    assert [float(sweep.points_m[0, 0]) for _, sweep in sweeps] == [3.0, 4.0, 5.0]


def test_in_reverse_a_sweep_turns_the_opposite_direction(swept: tuple[Epoch, ...]) -> None:
    sweeps = sweeps_of(fed(reversed_drive(swept))[0])
    span_ns = swept[-1].time_ns - swept[0].time_ns
    # A turn from 0.4 to 0.5 s is one from span − 0.5 to span − 0.4 s, but for the nanosecond of the first point.
    ends = [span_ns - 4 * SWEEP_NS - 1, span_ns - 3 * SWEEP_NS - 1]
    assert [sweep.time_ns - _START_NS for _, sweep in sweeps] == ends
    assert all(abs(at - sweep.time_ns) <= 1_000_000 for at, sweep in sweeps)
    first = sweeps[0][1]
    assert first.points_m[:, 0].tolist() == [11.0, 8.0, 5.0]
    assert first.intensity.tolist() == [11.0, 8.0, 5.0]
    assert first.offset_ns.tolist() == [1 - SWEEP_NS, 1 - SWEEP_NS * 3 // 4, 0]


def test_a_damaged_sweep_costs_itself_and_one_line(
    swept: tuple[Epoch, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = next(epoch for epoch in swept if epoch.sweeps).sweeps[0].file.path
    damaged.write_bytes(damaged.read_bytes()[:-1])
    bus = FedBus()
    feed.feed_passes(passes(swept, loop=False), bus, FakeStop(bus), drive="drive")  # type: ignore[arg-type]
    assert len(sweeps_of(bus)) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "sweep" in line]
    assert f"1 sweep could not be read and left out, the first: {damaged.name}" in line


def test_a_drive_that_cannot_be_used_is_one_line_and_code_2(tmp_path: Path, refused: Refused) -> None:
    assert refused(feed.main, tmp_path / "none.toml").startswith("camber feed: ")


def with_surrogate_map(folder: Path) -> Path:
    """The drive with a map of its own in `folder`/map, and a manifest that has one made instead."""
    write_short_drive(folder)
    text = (folder / "drive.toml").read_text().replace('[map]\nrelease = "map"\n', "")
    text += '\n[surrogates]\ninputs = ["links", "road_surfaces"]\n'
    (folder / "drive.toml").write_text(text)
    return folder / "drive.toml"


def test_the_map_of_the_drive_stays_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest = with_surrogate_map(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.setattr(feed, "join_bus", lambda *_: None)
    assert feed.main([str(manifest)]) == 0
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_where_nothing_can_be_written_it_is_one_line_and_code_2(
    blind: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/proc/nowhere")
    assert refused(feed.main, blind).startswith("camber feed: /proc/nowhere/")


def test_what_is_no_endpoint_is_not_waited_for(blind: Path, refused: Refused) -> None:
    line = refused(feed.main, blind, "--connect", "127.0.0.1:7447", code=3)
    assert "expected what Zenoh takes, protocol/address of an endpoint, got ['127.0.0.1:7447']" in line


@pytest.mark.parametrize(
    ("expected", "named"), [(["--vehicle", "a b"], "vehicle:"), (["--connect", "tls/router:7447"], "tls_ca")]
)
def test_wrong_settings_of_the_bus_are_one_line_and_code_2(
    blind: Path, expected: list[str], named: str, refused: Refused
) -> None:
    assert named in refused(feed.main, blind, *expected)


def test_a_router_that_is_not_there_is_asked_for_in_peace(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[float] = []
    bus = FedBus()
    stop = FakeStop(bus)

    def nobody(_: object, *, timeout_s: float) -> None:
        asked.append(timeout_s)
        if len(asked) == 20:
            stop.set()
        raise NobodyThereError("cannot join the bus (client, tcp/away:1): no such host")

    monkeypatch.setattr(feed, "open_session", nobody)
    assert feed.join_bus(ServiceSettings(), stop, "camber feed") is None
    assert bus.time_ns - _START_NS >= 19 * _NS // 2, "at most two a second, however quickly they fail"
    assert capsys.readouterr().err.count("; waiting\n") == 1
