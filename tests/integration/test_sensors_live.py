"""`camber sensors` as a process: packets over UDP in real time, recordings of the same drive, a localizer beside it."""

import re
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.motion_csv import read_samples
from camber.formats.lidar_can.candump import CandumpDecoder
from camber.formats.lidar_can.pcap import PcapDecoder
from camber.formats.map_exchange.pcd import read_sweep
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.runtime.clock import SystemClock
from camber.runtime.query import query_once
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.runtime.subscription import Subscription
from camber.schemas.health import HealthRequest
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.simulator.output.lidar_packets import velodyne_packets
from support.running import camber, free_port, started, wait_until

pytestmark = [pytest.mark.timed, pytest.mark.slow]

CLOCK = SystemClock()
SECONDS = 4.0
ROUND_NS = round(SECONDS * 1e9)
AWAY_S = 2.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """Of some seconds, with its LiDAR's packets and its CAN bus."""
    folder = tmp_path_factory.mktemp("drive")
    scenario = folder / "scenario.toml"
    scenario.write_text(
        f'name = "packets"\nduration_s = {SECONDS}\n[place]\nkind = "canyon"\n'
        '[lidar]\npackets = "velodyne"\ntraffic = 0\n[satellites]\nstreams = false\n'
    )
    done = camber("simulate", scenario, "--out", folder / "drive", "--quiet", timeout_s=400.0)
    assert done.returncode == 0, done.stderr
    return folder / "drive"


@contextmanager
def router() -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with started("-m", "camber.cli", "router", "--listen", endpoint):
        yield endpoint


def health(endpoint: str, service: str = "sensors"):
    settings = ServiceSettings(vehicle="car", zenoh=ZenohSettings(mode="client", connect=[endpoint]))
    request = HealthRequest(time_ns=CLOCK.now_ns())
    return query_once(settings, "health", request, service=service, timeout_s=20.0)


def bus(endpoint: str) -> str:
    return f'vehicle = "car"\n[zenoh]\nmode = "client"\nconnect = ["{endpoint}"]\n'


def alike(sweep: Sweep, true: Sweep) -> None:
    """The same measurements but for what a Velodyne's packets round."""
    apart_m = np.linalg.norm(sweep.points_m - true.points_m, axis=1)
    assert (apart_m <= np.radians(0.0055) * np.linalg.norm(true.points_m, axis=1) + 2e-5).all()
    np.testing.assert_array_equal(sweep.intensity, true.intensity)


def test_recordings_give_the_sweeps_and_motion_of_the_drive(drive: Path, tmp_path: Path) -> None:
    """Dated now, so that they are accepted as live ones are; of sweeps a bus that is busy drops some, and no motion."""
    settings = (drive / "sensors.toml").read_text().replace('"lidar.pcap"', '"pcap"')
    settings = re.sub(
        r"(pcap:|candump:|\")(lidar\.pcap|can\.log|can\.dbc)", lambda m: f"{m[1]}{drive}/{m[2]}", settings
    )
    true = [read_sweep(path, "lidar") for path in sorted((drive / "sweeps").glob("*.pcd"))]
    moved = read_samples(drive / "motion.csv", Motion)
    sweeps: list[Sweep] = []
    motion: list[Motion] = []
    with router() as endpoint:
        config = tmp_path / "sensors.toml"
        config.write_text('recordings = "now"\n' + bus(endpoint) + settings)
        # Whatever its age: a machine may be busy with other things.
        listener = Subscription("sweep", "motion", vehicle="car", connect=[endpoint], live=False)
        with listener, started("-m", "camber.cli", "sensors", "--config", str(config)) as process:
            wait_until(lambda: answers(endpoint, "sensors"), timeout_s=60.0, why="no sensors")
            while (message := listener.next(10.0)) is not None:
                (sweeps if isinstance(message, Sweep) else motion).append(message)
                if len(sweeps) == len(true) and len(motion) == len(moved):
                    break
            report = health(endpoint)
            assert process.poll() is None
        refused = listener.refused
    assert {issue.code for issue in report.issues} <= {"lidar_ended", "can_ended", "sensor_silent"}
    assert report.counters["lidar.packets.lost"] == report.counters["lidar.packets.late"] == 0
    assert report.counters["lidar.sweeps.whole"] == len(true) == round(SECONDS * 10)
    assert not refused, refused
    print(f"{len(sweeps)} of {len(true)} sweeps, {len(motion)} of {len(moved)} motions")
    assert len(motion) == len(moved)
    assert len(sweeps) >= 0.25 * len(true)
    shift_ns = motion[0].time_ns - moved[0].time_ns
    for sweep in sweeps:
        recorded = min(true, key=lambda one: abs(one.time_ns + shift_ns - sweep.time_ns))
        alike(sweep, recorded)
        at_ns, true_ns = (one.time_ns + one.offset_ns.astype(np.int64) for one in (sweep, recorded))
        assert np.abs(at_ns - true_ns - shift_ns).max() <= 2000
    for made, row in zip(motion, moved, strict=True):
        assert abs(made.time_ns - row.time_ns - shift_ns) <= 2000
        for name, step in (
            ("wheel_speed_m_s", 0.003),
            ("yaw_rate_rad_s", 1e-4),
            ("steering_angle_rad", 1e-4),
        ):
            value, expected = getattr(made, name), getattr(row, name)
            assert (value is None) == (expected is None)
            assert value is None or abs(value - expected) <= step


class Sensor(threading.Thread):
    """The simulated LiDAR on the network: its packets to a port of the loopback, stamped now, each at its time.

    With `rounds` the same packets come again, behind one another.
    """

    def __init__(self, drive: Path, port: int, rounds: int = 1) -> None:
        super().__init__(daemon=True)
        self.true = [read_sweep(path, "lidar") for path in sorted((drive / "sweeps").glob("*.pcd"))]
        self.port = port
        self.shift_ns = 0
        self.made = list(velodyne_packets(self.true))
        self.packets = 0
        self.rounds = rounds
        self.ended = threading.Event()

    def run(self) -> None:
        self.shift_ns = 1000 * ((CLOCK.now_ns() + 50_000_000 - self.made[0][0]) // 1000)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number in range(self.rounds):
                shift_ns = self.shift_ns + number * ROUND_NS
                for time_ns, payload in self.made:
                    if self.ended.wait(max((time_ns + shift_ns - CLOCK.now_ns()) / 1e9, 0.0)):
                        return
                    stamp_us = int.from_bytes(payload[1200:1204], "little") + shift_ns // 1000
                    stamped = (
                        payload[:1200] + (stamp_us % 3_600_000_000).to_bytes(4, "little") + payload[1204:]
                    )
                    sender.sendto(stamped, ("127.0.0.1", self.port))
                    self.packets += 1

    def off_s(self, sweep: Sweep) -> float:
        """How far the time of a sweep is from when it was measured, if it is one of those that were."""
        since_ns = sweep.time_ns - self.shift_ns - self.true[0].time_ns
        nearest_ns = min(
            (
                number * ROUND_NS + one.time_ns - self.true[0].time_ns
                for number in range(self.rounds)
                for one in self.true
            ),
            key=lambda measured_ns: abs(since_ns - measured_ns),
        )
        return (since_ns - nearest_ns) / 1e9


def test_a_live_lidar_with_a_localizer(drive: Path, tmp_path: Path) -> None:
    port = free_port()
    sensor = Sensor(drive, port)
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        lidar = f'[lidar]\nsource = "udp:127.0.0.1:{port}"\nmodel = "HDL-32E"\nstamps = "utc_hour"\n'
        # So much a machine that is busy may take to hand a packet on.
        lidar += "most_clock_error_s = 1.0\n"
        for name, settings in (("sensors", lidar), ("localizer", "")):
            (tmp_path / f"{name}.toml").write_text(bus(endpoint) + settings)
        listener = stack.enter_context(Subscription("sweep", vehicle="car", connect=[endpoint], live=False))
        for name in ("localizer", "sensors"):
            config = str(tmp_path / f"{name}.toml")
            stack.enter_context(started("-m", "camber.cli", name, "--config", config))
        for name in ("localizer", "sensors"):
            wait_until(lambda name=name: answers(endpoint, name), timeout_s=90.0, why=f"no {name}")
        sensor.start()
        sweeps: list[Sweep] = []
        ages_s: list[float] = []
        while len(sweeps) < len(sensor.true) - 1:
            message = listener.next(10.0)
            if message is None:
                break
            sweeps.append(message)
            ages_s.append((CLOCK.now_ns() - message.time_ns) / 1e9)
        sensor.join()
        wait_until(
            lambda: read_or_lost(health(endpoint)) >= sensor.packets,
            timeout_s=20.0,
            why="packets that are neither read nor lost",
        )
        report, localizer = health(endpoint), health(endpoint, "localizer")
    lost = report.counters.get("lidar.lost_in_kernel", 0)
    assert sweeps, report
    print(
        f"{len(sweeps)} of {len(sensor.true)} sweeps, median age {np.median(ages_s) * 1e3:.0f} ms, lost {lost}"
    )
    assert read_or_lost(report) == sensor.packets
    # The last turn waits for the next one, which does not come; of sweeps a bus that is busy drops some.
    assert report.counters["lidar.sweeps.whole"] >= len(sensor.true) - 1 or lost
    whole = {round((one.time_ns - sensor.shift_ns - sensor.true[0].time_ns) / 1e8): one for one in sweeps}
    assert len(whole) >= 0.25 * len(sensor.true)
    for number, sweep in whole.items():
        if lost == 0:
            alike(sweep, sensor.true[number])
        assert abs(sweep.time_ns - sensor.shift_ns - sensor.true[number].time_ns) < 1_000_000
    assert localizer.counters.get("sweep.undecodable", 0) == 0
    assert localizer.status != "failing"


@pytest.mark.parametrize(
    ("fault", "stamps"), [("killed", "utc_hour"), ("frozen", "utc_hour"), ("frozen", "arrival")]
)
def test_sensors_that_were_away_go_on_and_say_nothing_old_as_if_it_were_new(
    drive: Path, tmp_path: Path, fault: str, stamps: str
) -> None:
    """What the kernel kept meanwhile comes with the times at which it was measured: consumers refuse it for its age."""
    sensor = Sensor(drive, free_port(), rounds=50)
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        config = tmp_path / "sensors.toml"
        lidar = f'[lidar]\nsource = "udp:127.0.0.1:{sensor.port}"\nmodel = "HDL-32E"\nstamps = "{stamps}"\n'
        # Less than the service is away: a packet's arrival is when the kernel had it, not when it was read.
        config.write_text(bus(endpoint) + lidar + f"most_clock_error_s = {AWAY_S / 2}\n")
        listener = stack.enter_context(Subscription("sweep", vehicle="car", connect=[endpoint], live=False))
        stack.callback(sensor.ended.set)
        process = stack.enter_context(started("-m", "camber.cli", "sensors", "--config", str(config)))
        wait_until(lambda: answers(endpoint, "sensors"), timeout_s=90.0, why="no sensors")
        sensor.start()
        received: list[Sweep] = []

        def received_since(time_ns: int) -> bool:
            message = listener.next(0.2)
            received.extend([] if message is None else [message])
            return bool(received) and received[-1].time_ns > time_ns

        wait_until(lambda: received_since(0), timeout_s=60.0, why="no sweeps")
        if fault == "killed":
            process.kill()
            process.wait()
        else:
            process.send_signal(signal.SIGSTOP)
        away_ns = CLOCK.now_ns()
        time.sleep(AWAY_S)
        if fault == "killed":
            stack.enter_context(started("-m", "camber.cli", "sensors", "--config", str(config)))
        else:
            process.send_signal(signal.SIGCONT)
        back_ns = CLOCK.now_ns()
        wait_until(lambda: received_since(back_ns), timeout_s=90.0, why="no new sweeps")
        report = health(endpoint)
    sensor.join()
    off_s = [sensor.off_s(sweep) for sweep in received]
    late = sum(away_ns < sweep.time_ns < back_ns - round(0.2e9) for sweep in received)
    print(
        f"{len(received)} sweeps, {late} of the time away; times off by {min(off_s):+.4f} to {max(off_s):+.4f} s"
    )
    assert np.abs(off_s).max() < (0.001 if stamps == "utc_hour" else 0.01)
    assert all(first.time_ns < then.time_ns for first, then in pairwise(received))
    assert late == 0 or fault == "frozen"
    assert report.status != "failing"


def read_or_lost(report) -> int:
    return report.counters["lidar.packets.read"] + report.counters.get("lidar.lost_in_kernel", 0)


def answers(endpoint: str, service: str) -> bool:
    try:
        return health(endpoint, service).service == service
    except RuntimeError:
        return False


def test_the_recordings_are_what_other_programs_would_read(drive: Path) -> None:
    """Times of the network and of the bus are those of a machine whose clock is right."""
    packets = PcapDecoder("lidar.pcap").feed((drive / "lidar.pcap").read_bytes())
    frames = CandumpDecoder("can.log").feed((drive / "can.log").read_bytes())
    first = read_sweep(min((drive / "sweeps").glob("*.pcd")), "lidar")
    begin_ns = unix_ns_from_gps_ns(first.time_ns + int(first.offset_ns[0]))
    assert 0 < packets[0].time_ns - begin_ns < 1_000_000
    assert abs(frames[0].time_ns - begin_ns) < 500_000_000
