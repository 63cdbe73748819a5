"""The services as an operator runs them: real processes on the machine's clock, a router, a receiver, no feeder."""

import os
import pty
import subprocess
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
from camber.runtime.subscription import Subscription
from camber.schemas.channels import BY_NAME, SERVICES
from camber.schemas.integrity import Verdict
from camber.schemas.motion import Motion
from camber.schemas.pose import Pose
from support.hostile_caster import HostileCaster, Peer
from support.running import (
    CLOCK,
    Processes,
    bus_of,
    camber_started,
    free_endpoint,
    health_of,
    settings_file,
    wait_until,
)

pytestmark = pytest.mark.timed

PERIOD_S = 0.1
STOP_S = 2.0
_NS = 1_000_000_000


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


class Receiver(HostileCaster):
    """A receiver that serves NMEA over TCP to all that connect."""

    def __init__(self, port: int = 0) -> None:
        super().__init__(self.script, port=port)
        self.height_error_m = 0.0

    def script(self, peer: Peer) -> None:
        while True:
            peer.say(epoch(self.height_error_m))
            peer.wait(PERIOD_S)


class Wheels(threading.Thread):
    """The vehicle's own sensors: it stands."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(daemon=True)
        self.bus = bus_of(endpoint, "vehicle")
        self.ended = threading.Event()

    def run(self) -> None:
        while not self.ended.wait(PERIOD_S):
            now_ns = CLOCK.now_ns()
            self.bus.publish("motion", Motion(time_ns=now_ns, wheel_speed_m_s=0.0, yaw_rate_rad_s=0.0))
        self.bus.close()


class Vehicle(Processes):
    """Router, services, receiver and wheels of one car."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.endpoint = free_endpoint()
        self.receiver = Receiver()
        self.receiver.start()

    def assemble(self) -> None:
        write_short_drive(self.folder / "drive")
        pose = tomllib.loads((self.folder / "drive" / "drive.toml").read_text())["initial_pose"]
        lines = {
            "gnss": [f'source = "tcp:127.0.0.1:{self.receiver.port}"', 'protocol = "nmea"'],
            "map_server": [f'release = "{self.folder / "drive" / "map"}"'],
            "localizer": ["[initial_pose]", *(f"{key} = {value}" for key, value in pose.items())],
            "antenna_height": [f"fixed_height_m = {ANTENNA_HEIGHT_M}", "fixed_sigma_m = 0.02"],
        }
        self.start("router", "-m", "camber.cli", "router", "--listen", self.endpoint)
        for name in SERVICES:
            state = f'state_dir = "{self.folder / "state" / name}"'
            config = settings_file(self.folder / f"{name}.toml", self.endpoint, state, *lines.get(name, []))
            self.start(name, "-m", "camber.cli", name, "--config", config)

    def listen(self, *names: str) -> Subscription:
        return Subscription(*names, vehicle="car", connect=[self.endpoint])

    def end(self) -> None:
        self.receiver.end()
        super().end()


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    car = Vehicle(tmp_path_factory.mktemp("car"))
    with ExitStack() as ends:
        ends.callback(car.end)
        car.assemble()
        wheels = Wheels(car.endpoint)
        ends.callback(wheels.join, 5.0)
        ends.callback(wheels.ended.set)
        wheels.start()
        with car.listen("verdict") as listener:
            wait_for(listener, "confirmed", timeout_s=90.0)  # seven processes start: nothing is timed yet
        yield car


def wait_for(listener: Subscription, kind: str, *, timeout_s: float) -> Verdict:
    def wanted():
        verdict = listener.next(0.5)
        return verdict if isinstance(verdict, Verdict) and verdict.verdict == kind else None

    return wait_until(wanted, timeout_s=timeout_s, why=f"no verdict {kind}")


def test_a_right_position_is_confirmed_and_a_wrong_one_is_not(vehicle):
    with vehicle.listen("verdict") as listener:
        verdict = wait_for(listener, "confirmed", timeout_s=10.0)
        assert verdict.height_m is not None
        vehicle.receiver.height_error_m = 1.0
        try:
            wait_for(listener, "erroneous", timeout_s=10.0)
            verdicts = [listener.next(1.0) for _ in range(20)]
        finally:
            vehicle.receiver.height_error_m = 0.0
        assert {verdict.verdict for verdict in verdicts if verdict} == {"erroneous"}
        wait_for(listener, "confirmed", timeout_s=10.0)


@pytest.mark.parametrize("service", SERVICES)
def test_every_service_says_how_it_is(vehicle, service):
    health = health_of(vehicle.endpoint, service)
    assert health.service == service
    assert health.status == "ok", health.issues
    assert health.loop_age_s < 1.0


def test_a_frozen_localizer_makes_the_judge_say_unknown_within_the_age_limit_of_a_pose(vehicle):
    with vehicle.listen("pose", "verdict") as listener:
        wait_for(listener, "confirmed", timeout_s=10.0)
        received = [listener.next(0.5) for _ in range(10)]
        vehicle.freeze("localizer")
        try:
            deadline = time.monotonic() + 1.5
            while time.monotonic() < deadline:
                received.append(listener.next(0.2))
        finally:
            vehicle.resume("localizer")
        last_pose_ns = max(m.time_ns for m in received if isinstance(m, Pose))
        limit_ns = last_pose_ns + BY_NAME["pose"].max_age_s * _NS
        late = [m for m in received if isinstance(m, Verdict) and m.time_ns > limit_ns]
        assert len(late) >= 5
        assert {(v.verdict, v.reason) for v in late} == {("unknown", "pose_stale")}
        wait_for(listener, "confirmed", timeout_s=15.0)


def test_a_receiver_that_reboots_is_read_again(vehicle):
    before = vehicle.receiver
    with vehicle.listen("verdict") as listener:
        wait_for(listener, "confirmed", timeout_s=10.0)
        before.end()
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
    line = (f'source = "serial:{os.ttyname(theirs)}:460800"', 'protocol = "nmea"')
    config = settings_file(tmp_path / "gnss.toml", vehicle.endpoint, *line, vehicle="tram")
    try:
        with (
            camber_started("gnss", "--config", config, stdout=subprocess.DEVNULL),
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
    assert vehicle.ended() == {}
    for name in (*SERVICES, "router"):
        process = vehicle.running[name]
        asked = time.monotonic()
        process.terminate()
        try:
            code = process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{name} has not ended {STOP_S} s after SIGTERM")
        assert code == 0, f"{name} ended with {code} after {time.monotonic() - asked:.2f} s"
