"""`camber log-level` against a real work loop on a real router."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.run import Loop
from camber.runtime.service import Service
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.tools.operate import log_level as tool
from support.refusals import Refused
from support.running import wait_until


class Plain(Service[ServiceSettings]):
    """A service that does nothing."""

    NAME = "gnss"
    SETTINGS = ServiceSettings


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    settings = ServiceSettings(
        vehicle="v7", log_level="error", zenoh=ZenohSettings(mode="client", connect=[endpoint])
    )
    bus = Bus(open_session(settings.zenoh), settings, "gnss", SystemClock())
    loop = Loop(Plain(settings, bus), bus, SystemClock())
    loop.declare()
    thread = threading.Thread(target=loop.work)
    thread.start()
    yield bus
    loop.stopping = True
    bus.wake()
    thread.join(20.0)
    bus.close()


def request(endpoint: str, *arguments: str) -> int:
    return tool.main([*arguments, "--vehicle", "v7", "--connect", endpoint])


def test_it_logs_at_that_level_and_falls_back_by_itself(
    endpoint: str, bus: Bus, capsys: pytest.CaptureFixture[str]
) -> None:
    assert request(endpoint, "gnss", "debug", "--for", "2s") == 0
    assert "gnss: debug for 2 s, was error" in capsys.readouterr().out
    assert bus.log_level == "debug"
    wait_until(lambda: bus.log_level == "error", timeout_s=20.0, why="it falls back")


def test_the_last_request_holds(endpoint: str, bus: Bus) -> None:
    assert request(endpoint, "gnss", "debug", "--for", "1h") == 0
    assert request(endpoint, "gnss", "warning", "--for", "1h") == 0
    assert bus.log_level == "warning"


@pytest.mark.parametrize("name", ["integrity", "sensors"])
def test_an_absent_service_is_reported(endpoint: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert request(endpoint, name, "debug") == 1
    assert f"{name}: no answer: absent" in capsys.readouterr().err


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("10m", 600.0), ("1.5h", 5400.0)])
def test_durations(text: str, seconds: float) -> None:
    assert tool.duration_s(text) == seconds


@pytest.mark.parametrize(
    "arguments",
    [["gnss", "loud"], *(["gnss", "debug", "--for", time] for time in ("10", "25h"))],
)
def test_wrong_usage_is_code_2(arguments: list[str], refused: Refused) -> None:
    assert ": error: " in refused(tool.main, *arguments)
