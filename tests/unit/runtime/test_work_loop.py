"""The work loop works when something has come, and else now and then."""

from __future__ import annotations

import threading
from typing import Any, cast

import pytest
import zenoh

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.run import Loop
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings

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


@pytest.fixture
def service() -> Any:
    settings = ServiceSettings(log_level="error", period_s=10.0)
    bus = Bus(cast(zenoh.Session, None), settings, "gnss", SystemClock())
    service = Ports(settings, bus)
    loop = Loop(service, bus, SystemClock())
    thread = threading.Thread(target=loop.live)
    thread.start()
    yield service
    loop.stopping = True
    bus.wake()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def test_bytes_at_a_port_of_its_own_are_worked_on_at_once_not_at_the_end_of_the_period(
    service: Ports,
) -> None:
    for _ in range(5):  # five periods would be longer than we wait
        service.bus.wake()
        assert service.advanced.acquire(timeout=PATIENCE_S / 5.0)
