"""The work loop works when something has come, and else now and then."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from typing import Any, cast

import pytest
import zenoh

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.run import STOP_LIMIT_S, Loop
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from support.running import free_port

PATIENCE_S = 20.0


class Ports(Service[ServiceSettings]):
    """A service that reads ports of its own."""

    NAME = "gnss"
    SETTINGS = ServiceSettings

    def __init__(self, settings: ServiceSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self.advanced = threading.Semaphore(0)

    def advance(self, now_ns: int) -> None:
        self.advanced.release()


def working(period_s: float) -> tuple[Ports, Loop]:
    settings = ServiceSettings(log_level="error", period_s=period_s)
    service = Ports(settings, Bus(cast(zenoh.Session, None), settings, "gnss", SystemClock()))
    return service, Loop(service, service.bus, SystemClock())


@pytest.fixture
def service() -> Any:
    service, loop = working(10.0)
    thread = threading.Thread(target=loop.work)
    thread.start()
    yield service
    loop.stopping = True
    service.bus.wake()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def test_bytes_at_a_separate_port_are_worked_on_at_once_not_at_the_end_of_the_period(service: Ports) -> None:
    for _ in range(5):  # five periods would be longer than we wait
        service.bus.wake()
        assert service.advanced.acquire(timeout=PATIENCE_S / 5.0)


def test_what_is_due_by_the_clock_is_done_however_much_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    service, loop = working(0.1)
    bus = service.bus

    def more_comes(_: object) -> bool:
        time.sleep(0.02)
        bus.wake()
        return False

    monkeypatch.setattr(loop, "_event", more_comes)
    thread = threading.Thread(target=loop.work)
    bus.wake()
    thread.start()
    try:
        for _ in range(3):
            assert service.advanced.acquire(timeout=PATIENCE_S / 4.0)
    finally:
        loop.stopping = True
        thread.join(PATIENCE_S)


NEVER_ENDING = """
import sys, time
from camber.runtime.run import run
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
class Settings(ServiceSettings):
    'Those of all.'
    SERVICE = "gnss"
class Slow(Service[Settings]):
    NAME = "gnss"
    SETTINGS = Settings
    def advance(self, now_ns):
        print("begins", flush=True)
        time.sleep(60.0)
    def close(self):
        raise OSError("a disk that is gone")
sys.exit(run(Slow, ["--zenoh.connect", "[]", "--log-level", "error", *sys.argv[1:]]))
"""


def test_a_service_ends_on_request_also_in_the_midst_of_long_work() -> None:
    with subprocess.Popen([sys.executable, "-c", NEVER_ENDING], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"begins\n"
        began_s = time.monotonic()
        process.terminate()
        assert process.wait(PATIENCE_S) == -signal.SIGALRM
        assert time.monotonic() - began_s >= STOP_LIMIT_S - 0.1


def test_a_service_that_cannot_close_leaves_the_bus_and_says_so() -> None:
    quick = NEVER_ENDING.replace("time.sleep(60.0)", "time.sleep(0.0)")
    with subprocess.Popen(
        [sys.executable, "-c", quick], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout.readline() == b"begins\n"
        process.terminate()
        _, message = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 70
        assert b"a disk that is gone" in message


def test_a_service_that_finds_no_router_says_so() -> None:
    nowhere = f'["tcp/127.0.0.1:{free_port()}"]'
    texts = ["--zenoh.connect", nowhere, "--zenoh.mode", "client", "--log-level", "warning"]
    with subprocess.Popen([sys.executable, "-c", NEVER_ENDING, *texts], stderr=subprocess.PIPE) as process:
        message = process.stderr.readline().decode()
        process.kill()
    assert "waits_for_the_bus" in message
    assert nowhere.strip('[]"') in message


def test_where_a_round_takes_longer_than_its_period_what_has_come_does_not_pile_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As a worker that waits for its queue in each round, and asks for the next one."""
    service, loop = working(0.05)
    bus = service.bus
    rounds = 0

    def long_round(_: int) -> None:
        nonlocal rounds
        rounds += 1
        bus.wake()
        time.sleep(0.06)
        loop.stopping = rounds == 4

    monkeypatch.setattr(service, "advance", long_round)
    for _ in range(40):
        bus.wake()
    loop.work()
    waiting = 0
    while bus.next_event(0.0) is not None:
        waiting += 1
    assert waiting <= 1
