"""`camber status` over a real router, with real services: a service that does not answer is never shown as well."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from camber.schemas.motion import Motion
from support.running import (
    CLOCK,
    bus_of,
    camber,
    camber_started,
    free_endpoint,
    loopback_router,
    started,
    wait_until,
)

# A service whose work loop hangs, when a file is there, inside a call that holds the interpreter's lock: no thread of
# it works any more, and Zenoh goes on saying that it is there.
HANGING = """
import ctypes, os, sys
from camber.runtime.run import run
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
class Hanging(Service):
    NAME = "gnss"
    SETTINGS = ServiceSettings
    def advance(self, now_ns):
        if os.path.exists(HANG):
            ctypes.PyDLL(None).sleep(600)
HANG = sys.argv.pop(1)
raise SystemExit(run(Hanging))
"""


@pytest.fixture
def endpoint() -> Iterator[str]:
    with loopback_router() as endpoint:
        yield endpoint


def on(endpoint: str) -> list[str]:
    return ["--vehicle", "car", "--zenoh.mode", "client", "--zenoh.connect", json.dumps([endpoint])]


def antenna_height(stack: ExitStack, endpoint: str, folder: Path) -> subprocess.Popen[str]:
    log = stack.enter_context((folder / "antenna_height.log").open("a"))
    command = ["antenna_height", *on(endpoint), "--fixed-height-m", "1.5", "--fixed-sigma-m", "0.02"]
    return stack.enter_context(camber_started(*command, stdout=log))


def status(endpoint: str, *more: str) -> tuple[int, dict[str, Any]]:
    done = camber("status", "--vehicle", "car", "--connect", endpoint, "--json", *more)
    # 3: the router has not begun.
    return done.returncode, {} if done.returncode == 3 else json.loads(done.stdout)


def state_of(view: dict[str, Any], service: str) -> tuple[str, str]:
    (row,) = [row for row in view["services"] if row["service"] == service]
    return row["state"], row["why"]


def test_rates_ages_and_refusals_are_what_the_services_count(endpoint: str, tmp_path: Path) -> None:
    with ExitStack() as stack:
        antenna_height(stack, endpoint, tmp_path)
        bus = bus_of(endpoint, "vehicle")
        stack.callback(bus.close)

        def drive(seconds: float) -> None:
            for n in range(int(seconds / 0.05)):
                old_ns = 3_000_000_000 if n % 4 == 0 else 0
                now_ns = CLOCK.now_ns() - old_ns
                bus.publish("motion", Motion(time_ns=now_ns, wheel_speed_m_s=0.0, yaw_rate_rad_s=0.0))
                time.sleep(0.05)

        wait_until(
            lambda: status(endpoint, "--service", "antenna_height")[0] == 0, timeout_s=30.0, why="it is well"
        )
        over = ("--vehicle", "car", "--connect", endpoint, "--over", "2", "--service", "antenna_height")
        with camber_started("status", "--json", *over) as process:
            while process.poll() is None:
                drive(0.5)
            assert process.stdout is not None
            view = json.loads(process.stdout.read())
        assert process.returncode == 0
    channels = {row["channel"]: row for row in view["channels"]}
    assert 10.0 < channels["motion"]["rate_hz"] < 25.0
    assert channels["motion"]["refused"]["stale"] > 0
    assert channels["motion"]["consumers"] == ["antenna_height"]
    assert channels["antenna_height"]["age_s"] < 2.0
    (row,) = view["services"]
    assert row["health"]["gauges"]["memory_bytes"] > 1e7
    assert row["health"]["facts"]["process"].count(":") == 1
    issues = {issue["code"]: issue for issue in row["health"]["issues"]}
    assert issues["refused_input"]["last_time_ns"] is not None


def test_a_service_that_is_frozen_killed_or_not_there_is_not_answering(endpoint: str, tmp_path: Path) -> None:
    with ExitStack() as stack:
        process = antenna_height(stack, endpoint, tmp_path)
        of_it = ("--service", "antenna_height", "--timeout", "1", "--over", "0.2")
        wait_until(lambda: status(endpoint, *of_it)[0] == 0, timeout_s=30.0, why="it is well")
        os.kill(process.pid, signal.SIGSTOP)
        try:
            # At once, while Zenoh still has it as alive; and later, when it has not.
            for pause_s in (0.0, 3.0):
                time.sleep(pause_s)
                code, view = status(endpoint, *of_it)
                assert (code, state_of(view, "antenna_height")[0]) == (1, "not answering")
        finally:
            os.kill(process.pid, signal.SIGCONT)
        wait_until(lambda: status(endpoint, *of_it)[0] == 0, timeout_s=30.0, why="it is well again")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        code, view = status(endpoint, *of_it)
        assert (code, state_of(view, "antenna_height")[0]) == (1, "not answering")
        assert "not on the bus" in state_of(view, "antenna_height")[1]
        code, view = status(endpoint, "--over", "0.2")
        assert code == 1
        assert {row["state"] for row in view["services"]} == {"not answering"}
        assert len(view["services"]) == 5
        code, view = status(endpoint, "--over", "0.2", "--expect", "sensors")
        assert (code, state_of(view, "sensors")[0]) == (1, "not answering")


def test_a_service_whose_interpreter_hangs_is_not_answering_though_it_is_on_the_bus(
    endpoint: str, tmp_path: Path
) -> None:
    with ExitStack() as stack:
        log = stack.enter_context((tmp_path / "log").open("w"))
        hang = tmp_path / "hang"
        stack.enter_context(started("-c", HANGING, hang, *on(endpoint), stdout=log))
        of_it = ("--service", "gnss", "--timeout", "1", "--over", "0.2")
        wait_until(lambda: status(endpoint, *of_it)[0] == 0, timeout_s=30.0, why="it is well at first")
        hang.touch()
        _, view = wait_until(
            lambda: next((result for result in [status(endpoint, *of_it)] if result[0] == 1), None),
            timeout_s=30.0,
            why="it hangs",
        )
        state, why = state_of(view, "gnss")
        assert state == "not answering"
        assert why.startswith("on the bus, but its work loop does not answer")


def test_a_missing_router_is_one_clear_line(tmp_path: Path) -> None:
    done = camber("status", "--connect", free_endpoint(), "--timeout", "0.5")
    assert done.returncode == 3
    assert done.stderr.startswith("camber status: cannot join the bus")
