"""Small messages that follow one another at once all arrive, on a busy machine too."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from camber.runtime.subscription import Subscription
from camber.schemas.motion import Motion
from support.running import CLOCK, bus_of, loopback_router

# It makes its load itself: beside the other tests of processes and the fuzz a queue had to hold more than one epoch.
pytestmark = pytest.mark.timed

BURSTS = 100
MESSAGES = 12
PERIOD_S = 0.05


@contextmanager
def busy_processors(count: int) -> Iterator[None]:
    """As many processes that only compute."""
    with ExitStack() as stack:
        for _ in range(count):
            process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(process.wait)
            stack.callback(process.kill)
        yield


def test_no_message_of_a_burst_is_lost_on_a_busy_machine() -> None:
    with (
        loopback_router() as endpoint,
        Subscription("motion", vehicle="car", connect=[endpoint], live=False) as consumer,
    ):
        bus = bus_of(endpoint, "vehicle")
        bus.announce()
        while consumer.next(0.1) is None:  # the way is open
            bus.publish("motion", Motion(time_ns=CLOCK.now_ns(), yaw_rate_rad_s=0.0))
        begin_ns = CLOCK.now_ns()
        with busy_processors(4):
            for _ in range(BURSTS):
                for _ in range(MESSAGES):
                    bus.publish("motion", Motion(time_ns=CLOCK.now_ns(), yaw_rate_rad_s=0.0))
                time.sleep(PERIOD_S)
        received = 0
        while (message := consumer.next(1.0)) is not None:
            received += message.time_ns >= begin_ns
        bus.close()
    assert received == BURSTS * MESSAGES
