"""What arrives while a service joins a replay is kept for the tick that it belongs to."""

import itertools

import pytest

from camber.replay.lock_step.barrier import Barrier, producers_for
from camber.schemas.channels import SERVICES, inputs_of
from camber.schemas.codec import Received
from camber.schemas.gnss import Fix
from camber.schemas.health import Done, Tick

NOW_NS = 1_400_000_000 * 1_000_000_000
STEP_NS = 200_000_000


def fix(number: int) -> Received[Fix]:
    message = Fix(
        time_ns=NOW_NS + number * STEP_NS,
        fix_id=number,
        origin="receiver",
        quality="fixed",
        latitude_rad=0.6,
        longitude_rad=2.4,
        height_m=40.0,
        covariance_enu_m2=None,
    )
    return Received(message=message, source="gnss", sequence=number)


def done(service: str, index: int, fixes: int = 0) -> Done:
    published = {"fix": fixes} if service == "gnss" else {}
    return Done(time_ns=NOW_NS, service=service, index=index, published=published)


def assembly() -> Tick:
    return Tick(time_ns=NOW_NS, index=0, participants={}, working=(), published={})


def tick(index: int, *, without: str = "", returned: str = "") -> Tick:
    there = {name: -1 if name == returned else index - 1 for name in SERVICES if name != without}
    working = tuple(name for name in ("gnss", "integrity") if name != without)
    return Tick(
        time_ns=NOW_NS + index * STEP_NS, index=index, participants=there, working=working, published={}
    )


def listening() -> Barrier:
    barrier = Barrier("integrity", inputs_of("integrity"))
    for producer in producers_for("integrity"):
        barrier.add_done(done(producer, -1))
    return barrier


def taken(barrier: Barrier) -> list[int]:
    assert barrier.ready(), barrier.missing()
    return [received.sequence for _, received in barrier.take()[1]]


ORDERS = [
    order
    for order in itertools.permutations(("assembly", "fix", "done", "tick"))
    if order.index("assembly") < order.index("tick")  # the feeder's own messages keep their order
]


@pytest.mark.parametrize("order", ORDERS, ids=" ".join)
def test_nothing_of_the_first_tick_is_lost_in_whatever_order_things_arrive(order):
    """The feeder's and a service's messages come over different connections: a call to assemble may be late."""
    barrier = listening()
    for what in order:
        if what == "assembly":
            barrier.add_tick(assembly())
            if not barrier.participates():
                barrier.skip()
        elif what == "fix":
            barrier.add_message("fix", fix(0))
        elif what == "done":
            barrier.add_done(done("gnss", 0, fixes=1))
        else:
            barrier.add_tick(tick(0))
    assert taken(barrier) == [0]


def test_one_that_returns_begins_with_the_tick_that_it_is_on_the_list_of():
    barrier = listening()
    for number in range(3):
        barrier.add_message("fix", fix(number))
        barrier.add_done(done("gnss", number, fixes=number + 1))
    barrier.add_message("fix", fix(3))  # of the next tick, and here already
    barrier.add_tick(tick(2, without="integrity"))
    assert not barrier.participates()
    barrier.skip()
    barrier.add_done(done("gnss", 3, fixes=4))
    barrier.add_done(done("localizer", 2))
    barrier.add_tick(tick(3, returned="integrity"))
    assert taken(barrier) == [3]
