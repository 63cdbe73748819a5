"""A question in a replay is answered at the asker's time, an upload too."""

from __future__ import annotations

from typing import Any, cast

import pytest
import zenoh

from camber.runtime.bus import Bus
from camber.runtime.clock import ReplayClock
from camber.runtime.run import Loop
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.runtime.uploads.received import ReceivedUpload
from camber.schemas.health import HealthRequest

NOW_NS, ASKED_NS = 1_400_000_000_000_000_000, 1_400_000_000_200_000_000


class Answering(Service[ServiceSettings]):
    """Answers with the time that it is then."""

    NAME = "map_update"
    SETTINGS = ServiceSettings

    def answers(self) -> dict[str, Any]:
        return {"upload_batch": lambda requests: [self.bus.now_ns() for _ in requests]}


@pytest.mark.parametrize("wrapped", [False, True], ids=["a question", "an upload"])
def test_it_is_answered_at_the_time_of_the_one_who_asks(wrapped: bool) -> None:
    clock, settings = ReplayClock(), ServiceSettings(log_level="error")
    clock.set(NOW_NS)
    bus = Bus(cast(zenoh.Session, None), settings, "map_update", clock)
    loop = Loop(Answering(settings, bus), bus, clock)
    asked: Any = HealthRequest(time_ns=ASKED_NS)
    request = ReceivedUpload("car", asked) if wrapped else asked
    assert loop._replies("upload_batch", [request]) == [ASKED_NS]
    assert clock.now_ns() == NOW_NS
