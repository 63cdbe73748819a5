"""Messages of the barrier of a replay may be lost while the bus comes up: they are repeated.

Four services that only pass on what they have seen, over real sessions, in threads of this process; one tick or one
*done* does not arrive. What each of them publishes depends on all that it was handed and in which order.
"""

import hashlib
import threading
import time
from collections import defaultdict
from contextlib import ExitStack
from random import Random

import pytest

from camber.replay.lock_step import feeder as feeding
from camber.replay.lock_step.feeder import Feeder
from camber.replay.lock_step.service_loop import LockStepBus, LockStepLoop
from camber.runtime.clock import ReplayClock
from camber.runtime.service import Service
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.schemas.channels import BY_NAME, FEEDER, inputs_of, outputs_of
from camber.schemas.codec import decode, encode
from camber.schemas.health import Done, Tick
from support.messages import build
from support.running import free_endpoint

START_NS = 1_300_000_000 * 1_000_000_000
STEP_NS = 100_000_000
TICKS = 18
NAMES = ("gnss", "localizer", "antenna_height", "integrity")
FED = {"suspension": 1, "receiver_bytes": 7, "sweep": 8}
"""Channel of the vehicle → every how many ticks there is something on it."""
LOST_S = 0.1


class PassOn(Service[ServiceSettings]):
    """Publishes on each of its channels a message made from all that it has seen so far."""

    SETTINGS = ServiceSettings

    def __init__(self, name, bus):
        super().__init__(bus.settings, bus)
        self.NAME = name
        self.seen = hashlib.sha256()

    def handlers(self):
        return {channel.name: self.see for channel in inputs_of(self.NAME)}

    def see(self, message):
        self.seen.update(encode(message))

    def advance(self, now_ns):
        self.seen.update(str(now_ns).encode())
        for channel in outputs_of(self.NAME):
            message = build(channel.message, Random(self.seen.hexdigest()))
            self.bus.publish(channel.name, message.model_copy(update={"time_ns": now_ns}))


class Loss:
    """What a sender says of one tick is lost, on whatever key it comes, until some time after the first."""

    def __init__(self, sender, index):
        self.what = (sender, index)
        self.since = None

    def takes(self, what):
        if what != self.what:
            return False
        self.since = self.since or time.monotonic()
        return time.monotonic() < self.since + LOST_S


class Lossy(LockStepBus):
    """A bus on which something is lost."""

    loss = None

    def pop(self, name):
        item = super().pop(name)
        if item is None or self.loss is None:
            return item
        if name == "tick" or name.startswith("done."):
            return None if self.loss.takes(published(item.data)) else item
        lost = item.attachment and self.loss.takes(published(item.attachment))
        return item._replace(attachment=None) if lost else item


def published(data):
    """Sender and index of a tick or a done."""
    try:
        tick = decode(Tick, data).message
        return (FEEDER, tick.index) if tick.participants else (FEEDER, -1)  # −1: a call to assemble
    except ValueError:
        done = decode(Done, data).message
        return done.service, done.index


def replay(endpoint, receiver="", loss=None):
    """Feed a drive; `receiver` suffers the loss. Returns the bytes of all keys."""
    recording = defaultdict(list)
    zenoh = ZenohSettings(mode="client", connect=[endpoint], listen=[])
    settings = ServiceSettings(vehicle="lossy", zenoh=zenoh, clock="replay")
    with ExitStack() as stack:
        feeder = stack.enter_context(
            Feeder(settings, FED, observer=lambda key, data, _ns: recording[key].append(data))
        )
        if receiver == FEEDER:
            add = feeder._add_done
            feeder._add_done = lambda done: None if loss.takes((done.service, done.index)) else add(done)
        for name in NAMES:
            bus = Lossy(open_session(settings.zenoh), settings, name, ReplayClock())
            stack.callback(bus.close)
            if name == receiver:
                bus.loss = loss
            loop = LockStepLoop(PassOn(name, bus), bus, bus._clock)
            loop.declare()
            thread = threading.Thread(target=loop.work)
            stack.callback(thread.join)
            stack.callback(bus.wake)
            stack.callback(setattr, loop, "stopping", True)
            thread.start()
        feeder.assemble(NAMES, time_ns=START_NS)
        for number in range(TICKS):
            time_ns = START_NS + number * STEP_NS
            for name, every in FED.items():
                if number % every == 0:
                    message = build(BY_NAME[name].message, Random(number))
                    feeder.publish(name, message.model_copy(update={"time_ns": time_ns}))
            feeder.tick(time_ns, last=number == TICKS - 1)
    return recording


@pytest.fixture(scope="module")
def endpoint():
    address = free_endpoint()
    router = open_session(ZenohSettings(mode="router", connect=[], listen=[address]))
    yield address
    router.close()


@pytest.fixture(scope="module")
def undisturbed(endpoint):
    return replay(endpoint)


@pytest.mark.parametrize(
    ("receiver", "sender", "index"),
    [
        pytest.param("integrity", "gnss", 7, id="a done of a service that works on the tick"),
        pytest.param("localizer", "integrity", 7, id="a done for a loop"),
        pytest.param(
            "localizer", "integrity", 6, id="a done for a loop, of a tick that was not the hearer's"
        ),
        pytest.param("antenna_height", "localizer", 8, id="a done of a service in the middle"),
        pytest.param(FEEDER, "localizer", 8, id="a done for the feeder"),
        pytest.param(FEEDER, "integrity", TICKS - 1, id="the last done"),
        pytest.param("gnss", FEEDER, 0, id="the first tick"),
        pytest.param("antenna_height", FEEDER, 7, id="a tick, the next one arrives"),
    ],
)
def test_lost_messages_are_repeated_and_the_bytes_are_the_same(
    endpoint, undisturbed, monkeypatch, receiver, sender, index
):
    monkeypatch.setattr(feeding, "RESEND_S", 0.3)
    loss = Loss(sender, index)
    assert replay(endpoint, receiver, loss) == undisturbed
    assert loss.since is not None, "nothing was lost"
