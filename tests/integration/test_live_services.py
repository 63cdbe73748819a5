"""The services as an operator runs them: real processes on the machine's clock, a router, a receiver, no feeder."""

import os
import pty
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib
import tty
from contextlib import ExitStack
from pathlib import Path

import pytest

from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.replay.short_drive import ANTENNA_HEIGHT_M, short_drive_truth, write_short_drive
from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.query import query_once
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.runtime.subscription import Subscription
from camber.schemas.channels import BY_NAME, SERVICES
from camber.schemas.health import HealthRequest
from camber.schemas.motion import Motion
from support.running import environment, kill, started, wait_until

pytestmark = pytest.mark.timed

PERIOD_S = 0.1
STOP_S = 2.0
_NS = 1_000_000_000
CLOCK = SystemClock()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def epoch(height_error_m: float = 0.0) -> bytes:
    """What a receiver at the start of the short drive's street says now."""
    truth = short_drive_truth()
    now_ns = CLOCK.now_ns() // 10_000_000 * 10_000_000
    solution = ReceiverSolution(
        time_ns=now_ns,
        latitude_rad=float(truth.latitude_rad[0]),
        longitude_rad=float(truth.longitude_rad[0]),
        height_m=float(truth.height_m[0]) + height_error_m,
        quality=SolutionQuality.FIX,
        satellites=14,
        covariance_enu_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4),
        age_s=0.5,
    )
    return format_rmc(solution) + format_gga(solution, geoid_separation_m=37.0) + format_gst(solution)


class Receiver(threading.Thread):
    """A receiver that serves NMEA over TCP to all that connect."""

    def __init__(self, port: int = 0) -> None:
        super().__init__(daemon=True)
        self.server = socket.create_server(("127.0.0.1", port))
        self.port = self.server.getsockname()[1]
        self.height_error_m = 0.0
        self.ended = threading.Event()

    def run(self) -> None:
        clients: list[socket.socket] = []
        while not self.ended.wait(PERIOD_S):
            if select.select([self.server], [], [], 0.0)[0]:
                clients.append(self.server.accept()[0])
            for client in list(clients):
                try:
                    client.sendall(epoch(self.height_error_m))
                except OSError:
                    clients.remove(client)
                    client.close()
        for client in clients:
            client.close()
        self.server.close()


class Wheels(threading.Thread):
    """The vehicle's own sensors: it stands."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(daemon=True)
        settings = ServiceSettings(vehicle="car", zenoh=ZenohSettings(mode="client", connect=[endpoint]))
        self.bus = Bus(open_session(settings.zenoh), settings, "vehicle", CLOCK)
        self.ended = threading.Event()

    def run(self) -> None:
        while not self.ended.wait(PERIOD_S):
            now_ns = CLOCK.now_ns()
            self.bus.publish("motion", Motion(time_ns=now_ns, wheel_speed_m_s=0.0, yaw_rate_rad_s=0.0))
        self.bus.close()


class Vehicle:
    """Router, services, receiver and wheels of one car."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.receiver = Receiver()

    def write_configs(self) -> None:
        write_short_drive(self.folder / "drive")
        pose = tomllib.loads((self.folder / "drive" / "drive.toml").read_text())["initial_pose"]
        usual = {
            "gnss": f'source = "tcp:127.0.0.1:{self.receiver.port}"\nprotocol = "nmea"\n',
            "map_server": f'release = "{self.folder / "drive" / "map"}"\n',
            "localizer": "[initial_pose]\n" + "".join(f"{key} = {value}\n" for key, value in pose.items()),
            "antenna_height": f"fixed_height_m = {ANTENNA_HEIGHT_M}\nfixed_sigma_m = 0.02\n",
        }
        for name in SERVICES:
            common = f'vehicle = "car"\nstate_dir = "{self.folder / "state" / name}"\n'
            bus = f'[zenoh]\nmode = "client"\nconnect = ["{self.endpoint}"]\n'
            self.config(name).write_text(common + usual.get(name, "") + bus)

    def config(self, name: str) -> Path:
        return self.folder / f"{name}.toml"

    def start(self, name: str) -> None:
        command = ["-m", "camber.cli", "router", "--listen", self.endpoint]
        if name != "router":
            command = ["-m", "camber.cli", name, "--config", str(self.config(name))]
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, *command],
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )

    def listen(self, *names: str) -> Subscription:
        return Subscription(*names, vehicle="car", connect=[self.endpoint])

    def end(self) -> None:
        self.receiver.ended.set()
        for process in self.processes.values():
            if process.poll() is None:
                process.kill()
            process.wait()


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    car = Vehicle(tmp_path_factory.mktemp("car"))
    with ExitStack() as ends:
        ends.callback(car.end)
        car.write_configs()
        car.receiver.start()
        for name in ("router", *SERVICES):
            car.start(name)
        wheels = Wheels(car.endpoint)
        ends.callback(wheels.join, 5.0)
        ends.callback(wheels.ended.set)
        wheels.start()
        with car.listen("verdict") as listener:
            wait_for(listener, "confirmed", timeout_s=90.0)  # seven processes start: nothing is timed yet
        yield car


def wait_for(listener: Subscription, kind: str, *, timeout_s: float):
    def wanted():
        verdict = listener.next(0.5)
        return verdict if verdict is not None and verdict.verdict == kind else None

    return wait_until(wanted, timeout_s=timeout_s, why=f"no verdict {kind}")


def test_a_right_position_is_confirmed_and_a_wrong_one_is_not(vehicle):
    with vehicle.listen("verdict", "position") as listener:
        verdict = wait_for(OnlyVerdicts(listener), "confirmed", timeout_s=10.0)
        assert verdict.height_m is not None
        vehicle.receiver.height_error_m = 1.0
        try:
            wait_for(OnlyVerdicts(listener), "erroneous", timeout_s=10.0)
            lines = {
                verdict.verdict
                for verdict in (OnlyVerdicts(listener).next(1.0) for _ in range(20))
                if verdict
            }
        finally:
            vehicle.receiver.height_error_m = 0.0
        assert lines == {"erroneous"}
        wait_for(OnlyVerdicts(listener), "confirmed", timeout_s=10.0)


class OnlyVerdicts:
    """Of a listener to several channels."""

    def __init__(self, listener: Subscription) -> None:
        self.listener = listener

    def next(self, timeout_s: float):
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0.0:
            message = self.listener.next(left_s)
            if message is not None and hasattr(message, "verdict"):
                return message
        return None


@pytest.mark.parametrize("service", SERVICES)
def test_every_service_says_how_it_is(vehicle, service):
    settings = ServiceSettings(vehicle="car", zenoh=ZenohSettings(connect=[vehicle.endpoint]))
    health = query_once(
        settings, "health", HealthRequest(time_ns=CLOCK.now_ns()), service=service, timeout_s=5.0
    )
    assert health.service == service
    assert health.status == "ok", health.issues
    assert health.loop_age_s < 1.0


def test_a_frozen_localizer_makes_the_judge_say_unknown_within_the_age_limit_of_a_pose(vehicle):
    limit_s = BY_NAME["pose"].max_age_s
    pid = vehicle.processes["localizer"].pid
    with vehicle.listen("pose", "verdict") as listener:
        wait_for(OnlyVerdicts(listener), "confirmed", timeout_s=10.0)
        received = [listener.next(0.5) for _ in range(10)]
        kill(pid, signal.SIGSTOP)
        try:
            deadline = time.monotonic() + 1.5
            while time.monotonic() < deadline:
                received.append(listener.next(0.2))
        finally:
            kill(pid, signal.SIGCONT)
        last_pose_ns = max(m.time_ns for m in received if m is not None and not hasattr(m, "verdict"))
        verdicts = [m for m in received if m is not None and hasattr(m, "verdict")]
        late = [v for v in verdicts if v.time_ns > last_pose_ns + limit_s * _NS]
        assert len(late) >= 5
        assert {(v.verdict, v.reason) for v in late} == {("unknown", "pose_stale")}
        wait_for(OnlyVerdicts(listener), "confirmed", timeout_s=15.0)


def test_when_the_router_is_killed_and_started_again_everybody_is_back(vehicle):
    with vehicle.listen("verdict") as listener:
        wait_for(listener, "confirmed", timeout_s=10.0)
        vehicle.processes["router"].kill()
        vehicle.processes["router"].wait()
        while listener.next(1.0) is not None:  # what was on its way
            pass
        vehicle.start("router")
        wait_for(listener, "confirmed", timeout_s=15.0)


def test_a_receiver_that_reboots_is_read_again(vehicle):
    before = vehicle.receiver
    with vehicle.listen("verdict") as listener:
        wait_for(listener, "confirmed", timeout_s=10.0)
        before.ended.set()
        before.join()
        wait_until(
            lambda: (v := listener.next(1.0)) is not None and v.reason == "gnss_stale",
            timeout_s=5.0,
            why="not stale",
        )
        vehicle.receiver = Receiver(before.port)
        vehicle.receiver.start()
        wait_for(listener, "confirmed", timeout_s=15.0)


def test_a_receiver_on_a_serial_line_is_read(vehicle, tmp_path):
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    config = tmp_path / "gnss.toml"
    config.write_text(
        f'vehicle = "tram"\nsource = "serial:{os.ttyname(theirs)}:460800"\nprotocol = "nmea"\n'
        f'[zenoh]\nmode = "client"\nconnect = ["{vehicle.endpoint}"]\n'
    )
    try:
        with (
            started("-m", "camber.cli", "gnss", "--config", config, stdout=subprocess.DEVNULL),
            Subscription("fix", vehicle="tram", connect=[vehicle.endpoint]) as listener,
        ):

            def wanted():
                os.write(ours, epoch())
                return listener.next(PERIOD_S)

            fix = wait_until(wanted, timeout_s=15.0, why="no fix from the serial line")
    finally:
        os.close(ours)
        os.close(theirs)
    assert fix.quality == "fixed"
    assert fix.latitude_rad == pytest.approx(float(short_drive_truth().latitude_rad[0]), abs=1e-9)


def test_sigterm_ends_each_service_and_the_router(vehicle):
    """The last test of this file: nothing runs after it."""
    for name in (*SERVICES, "router"):
        process = vehicle.processes[name]
        assert process.poll() is None, (
            f"{name} has ended: {(vehicle.folder / f'{name}.log').read_text()[-500:]}"
        )
        asked = time.monotonic()
        process.terminate()
        try:
            code = process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{name} has not ended {STOP_S} s after SIGTERM")
        assert code == 0, f"{name} ended with {code} after {time.monotonic() - asked:.2f} s"
