"""The replay barrier: counts decide, never the order of arrival, so the same drive gives the same bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import permutations
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.replay.lock_step.barrier import Barrier, producers_for
from camber.schemas.channels import CHANNELS, SERVICES, Channel, inputs_of
from camber.schemas.codec import Received
from camber.schemas.health import Done, HealthRequest, Tick

NS = 1_300_000_000 * 1_000_000_000
STEP_NS = 100_000_000
ORDER = {channel.name: position for position, channel in enumerate(CHANNELS)}


def barrier_of(service: str) -> Barrier:
    return Barrier(service=service, inputs=inputs_of(service))


@pytest.fixture
def barrier() -> Barrier:
    return barrier_of("localizer")


def message(sequence: int, tick: int = 0, *, late_ns: int = 0) -> Received[HealthRequest]:
    """A message of a tick; the barrier looks only at its time and its number."""
    request = HealthRequest(time_ns=NS + tick * STEP_NS - late_ns)
    return Received(message=request, source="any", sequence=sequence)


def tick(index: int, participants: dict[str, int], working: Iterable[str], **published: int) -> Tick:
    time_ns = NS + index * STEP_NS
    return Tick(
        time_ns=time_ns, index=index, participants=participants, working=tuple(working), published=published
    )


def done(service: str, index: int, **published: int) -> Done:
    return Done(time_ns=NS + max(index, 0) * STEP_NS, service=service, index=index, published=published)


def numbers(barrier: Barrier) -> list[tuple[str, int]]:
    """Channel and number of what is handed out for the oldest tick, which must be ready."""
    assert barrier.ready(), barrier.missing()
    return [(name, received.sequence) for name, received in barrier.take()[1]]


ALL = {"gnss": -1, "localizer": -1, "integrity": -1}


def test_producers_are_those_of_the_table_without_the_vehicle() -> None:
    assert producers_for("localizer") == ("gnss", "integrity")
    assert producers_for("gnss") == ()
    for service in SERVICES:
        assert set(producers_for(service)) == {
            channel.producers[0] for channel in inputs_of(service) if channel.producers != ("vehicle",)
        }


def test_nobody_waits_for_the_dead(barrier: Barrier) -> None:
    barrier.add_message("motion", message(0))
    barrier.add_tick(tick(0, ALL, ALL, motion=1))
    assert barrier.missing() == ["gnss"]
    barrier.add_tick(tick(0, {"localizer": -1, "integrity": -1}, ("localizer", "integrity"), motion=1))
    assert len(barrier.ticks) == 1
    assert numbers(barrier) == [("motion", 0)]


def test_a_tick_that_is_done_is_not_done_again_when_somebody_has_died(barrier: Barrier) -> None:
    barrier.add_tick(tick(0, ALL, ("localizer",)))
    numbers(barrier)
    barrier.add_tick(tick(0, {"localizer": -1}, ("localizer",)))
    assert not barrier.ticks


def test_messages_of_a_service_that_died_are_still_taken(barrier: Barrier) -> None:
    barrier.add_message("fix", message(0))
    barrier.add_tick(tick(0, {"localizer": -1}, ("localizer",)))
    assert numbers(barrier) == [("fix", 0)]


def test_a_service_that_is_not_on_the_list_must_be_seen_again(barrier: Barrier) -> None:
    barrier.add_done(done("gnss", -1))
    barrier.add_done(done("integrity", -1))
    assert barrier.producers_seen == {"gnss", "integrity"}
    barrier.forget_absent(tick(0, {"localizer": -1, "integrity": -1}, ("localizer",)))
    assert barrier.producers_seen == {"integrity"}


def test_a_producer_that_returns_counts_from_zero(barrier: Barrier) -> None:
    barrier.add_tick(tick(0, ALL, ALL))
    for sequence in range(5):
        barrier.add_message("fix", message(sequence))
    barrier.add_done(done("gnss", 0, fix=5))
    assert len(numbers(barrier)) == 5
    barrier.add_message("fix", message(5, 1))  # its last words, never counted
    barrier.add_done(done("gnss", -1, fix=0))
    barrier.add_tick(tick(2, ALL | {"localizer": 0, "integrity": 0}, ("gnss", "localizer")))
    barrier.add_done(done("gnss", 2, fix=1))
    assert barrier.missing() == ["fix", "integrity"]
    barrier.add_done(done("integrity", 0, verdict=0))
    assert barrier.missing() == ["fix"]
    barrier.add_message("fix", message(0, 2))
    assert numbers(barrier) == [("fix", 0)]


def test_a_producer_that_says_again_that_it_listens_loses_nothing(barrier: Barrier) -> None:
    barrier.add_done(done("gnss", -1, fix=0))
    barrier.add_message("fix", message(0))
    barrier.add_done(done("gnss", -1, fix=0))
    barrier.add_tick(tick(0, ALL, ("gnss", "localizer")))
    barrier.add_done(done("gnss", 0, fix=1))
    assert numbers(barrier) == [("fix", 0)]


def test_who_is_not_on_the_list_listens(barrier: Barrier) -> None:
    barrier.add_tick(tick(4, {"gnss": 3}, ("gnss",), motion=40))
    assert not barrier.participates()
    barrier.skip()
    assert not barrier.ticks


def test_a_joiner_counts_from_what_was_published_before_it_came(barrier: Barrier) -> None:
    barrier.add_message("motion", message(39, 4))
    barrier.add_tick(tick(4, {"gnss": 3}, ("gnss",), motion=40))
    barrier.skip()
    barrier.add_done(done("gnss", 4, fix=31))
    barrier.add_tick(tick(5, {"gnss": 4, "localizer": -1}, ("gnss", "localizer"), motion=41))
    assert barrier.participates()
    assert set(barrier.missing()) == {"motion", "gnss"}
    barrier.add_message("motion", message(40, 5))
    barrier.add_message("fix", message(31, 5))
    barrier.add_done(done("gnss", 5, fix=32))
    assert numbers(barrier) == [("motion", 40), ("fix", 31)]


def test_a_joiner_that_nobody_publishes_for_does_not_wait_for_the_past(barrier: Barrier) -> None:
    barrier.add_tick(tick(4, {"gnss": 3}, ("gnss",), motion=40))
    barrier.skip()
    barrier.add_done(done("gnss", 4, fix=31))
    barrier.add_tick(tick(5, {"gnss": 4, "localizer": -1}, ("gnss", "localizer"), motion=40))
    barrier.add_done(done("gnss", 5, fix=31))
    assert numbers(barrier) == []


def test_a_joiner_keeps_what_has_come_of_the_tick_that_it_joins_on(barrier: Barrier) -> None:
    barrier.add_message("motion", message(39, 4))
    barrier.add_message("motion", message(40, 5))
    barrier.add_message("verdict", message(12, 3))
    barrier.add_tick(tick(4, {"gnss": 3, "integrity": 3}, ("gnss",), motion=40))
    barrier.skip()
    barrier.add_done(done("gnss", 4, fix=31))
    barrier.add_done(done("integrity", 4, verdict=13))
    barrier.add_tick(tick(5, {"localizer": -1, "integrity": 4}, ("localizer",), motion=41))
    assert numbers(barrier) == [("motion", 40)]


def test_a_joiner_is_not_put_back_by_a_tick_that_it_has_listened_to(barrier: Barrier) -> None:
    """When somebody dies just after a joiner was put on the list, the feeder says the ticks before again."""
    before = tick(4, {"gnss": 3, "integrity": 3}, ("gnss", "integrity"))
    barrier.add_tick(before)
    barrier.skip()
    barrier.add_tick(tick(5, {"localizer": -1}, ("localizer",), motion=1))
    barrier.add_tick(tick(4, {"gnss": 3}, ("gnss",)))
    barrier.add_message("motion", message(0, 5))
    assert numbers(barrier) == [("motion", 0)]
    barrier.add_message("motion", message(1, 6))
    barrier.add_tick(tick(6, {"localizer": 5}, ("localizer",), motion=2))
    assert [waiting.index for waiting in barrier.ticks] == [6]
    assert numbers(barrier) == [("motion", 1)]


ORDERS = [
    order
    for order in permutations(("assembly", "fix", "done", "tick"))
    if order.index("assembly") < order.index("tick")  # the feeder's own messages keep their order
]


@pytest.mark.parametrize("order", ORDERS, ids=" ".join)
def test_nothing_of_the_first_tick_is_lost_in_whatever_order_things_arrive(order: tuple[str, ...]) -> None:
    """The feeder's and a service's messages come over different connections: a call to assemble may be late."""
    barrier = barrier_of("integrity")
    for producer in producers_for("integrity"):
        barrier.add_done(done(producer, -1))

    def assemble() -> None:
        barrier.add_tick(tick(0, {}, ()))
        if not barrier.participates():
            barrier.skip()

    arrivals: dict[str, Callable[[], object]] = {
        "assembly": assemble,
        "fix": lambda: barrier.add_message("fix", message(0)),
        "done": lambda: barrier.add_done(done("gnss", 0, fix=1)),
        "tick": lambda: barrier.add_tick(tick(0, dict.fromkeys(SERVICES, -1), ("gnss", "integrity"))),
    }
    for name in order:
        arrivals[name]()
    assert numbers(barrier) == [("fix", 0)]


def test_one_that_returns_begins_with_the_tick_that_it_is_on_the_list_of() -> None:
    barrier = barrier_of("integrity")
    for producer in producers_for("integrity"):
        barrier.add_done(done(producer, -1))
    for number in range(3):
        barrier.add_message("fix", message(number, number))
        barrier.add_done(done("gnss", number, fix=number + 1))
    barrier.add_message("fix", message(3, 3))  # of the next tick, and here already
    others = {name: 1 for name in SERVICES if name != "integrity"}
    barrier.add_tick(tick(2, others, ("gnss",)))
    assert not barrier.participates()
    barrier.skip()
    barrier.add_done(done("gnss", 3, fix=4))
    barrier.add_done(done("localizer", 2))
    barrier.add_tick(tick(3, dict.fromkeys(others, 2) | {"integrity": -1}, ("gnss", "integrity")))
    assert numbers(barrier) == [("fix", 3)]


def test_old_counts_are_forgotten(barrier: Barrier) -> None:
    for index in range(10_000):
        barrier.add_done(done("gnss", index, fix=index))
    assert sum(len(counts) for counts in barrier._done.values()) <= 100


@dataclass
class Script:
    """What happens in a drive, seen by one service: what each channel brings, and what must be handed out."""

    service: str
    streams: dict[str, list[tuple[str, object]]] = field(default_factory=dict)
    expected: list[tuple[int, list[tuple[str, int]]]] = field(default_factory=list)


def write_script(service: str, random: Random, ticks: int) -> Script:
    """Draw who works on which tick and what it publishes; who gets something from before works too."""
    script = Script(service)
    channels = inputs_of(service)
    producers = producers_for(service)
    script.streams = {name: [] for name in ["tick", *producers, *(channel.name for channel in channels)]}
    published = dict.fromkeys((channel.name for channel in channels), 0)
    at_last_work: dict[str, dict[str, int]] = {}
    worked = dict.fromkeys((*producers, service), -1)
    taken = dict(published)
    times: dict[tuple[str, int], int] = {}

    def publish(channel: Channel, index: int) -> int:
        count = random.choice([0, 1, 1, 2])
        for _ in range(count):
            number = published[channel.name]
            item = message(number, index, late_ns=random.choice([0, 0, 1, STEP_NS, 3 * STEP_NS]))
            times[channel.name, number] = item.message.time_ns
            script.streams[channel.name].append(("message", item))
            published[channel.name] += 1
        return count

    def hand_out(index: int, limits: dict[str, int]) -> None:
        items = []
        for name, limit in limits.items():
            items += [
                (times[name, number], ORDER[name], number, name) for number in range(taken[name], limit)
            ]
            taken[name] = max(taken[name], limit)
        script.expected.append((index, [(name, number) for _, _, number, name in sorted(items)]))

    has_sweeps = random.random() < 0.7
    for index in range(ticks):
        beat = index % 7 == 0
        working = {producer for producer in producers if beat or random.random() < 0.6}
        fed = sum(publish(channel, index) for channel in channels if channel.producers == ("vehicle",))
        plain = {channel.producers[0] for channel in channels if not channel.looped}
        works = beat or fed > 0 or bool(working & plain)
        limits = {}
        for channel in channels:
            producer = channel.producers[0]
            if channel.made_from == "sweep" and not has_sweeps:
                continue
            if channel.looped:
                limits[channel.name] = at_last_work.get(producer, {}).get(channel.name, 0)
            elif producer in working:
                publish(channel, index)
            if producer == "vehicle" or (producer in working and not channel.looped):
                limits[channel.name] = published[channel.name]
        if works:
            hand_out(index, limits)
            of_vehicle = {c.name: published[c.name] for c in channels if c.producers == ("vehicle",)}
            of_vehicle |= {"sweep": 0} if has_sweeps and "sweep" not in of_vehicle else {}
            names = (*sorted(working), service)
            script.streams["tick"].append(("tick", tick(index, dict(worked), names, **of_vehicle)))
            worked[service] = index
        for channel in channels:
            if channel.looped and channel.producers[0] in working and (has_sweeps or not channel.made_from):
                publish(channel, index)
        for producer in sorted(working):
            if not has_sweeps and all(c.made_from for c in channels if c.producers == (producer,)):
                worked[producer] = index  # no input, no done
                continue
            counts = {c.name: published[c.name] for c in channels if c.producers == (producer,)}
            script.streams[producer].append(("done", done(producer, index, **counts)))
            at_last_work[producer] = counts
            worked[producer] = index
    return script


def play(script: Script, random: Random, lost: float) -> list[tuple[int, list[tuple[str, int]]]]:
    """Let the streams arrive in any interleaving, each of them in its own order, and work as the loop does.

    A share `lost` of the ticks and dones comes only after everything else, once more and in any order.
    """
    barrier = barrier_of(script.service)
    again = []
    streams = {name: deque(items) for name, items in script.streams.items() if items}
    weights = {name: random.choice([1, 1, 5, 50]) for name in streams}
    handed_out = []
    while streams:
        (name,) = random.choices(list(streams), [weights[name] for name in streams])
        for _ in range(random.choice([1, 1, 10])):
            if not streams[name]:
                break
            kind, item = streams[name].popleft()
            if kind == "message":
                barrier.add_message(name, item)  # type: ignore[arg-type]
            elif name != "again" and random.random() < lost:
                again.append((kind, item))
            elif kind == "tick":
                barrier.add_tick(item)  # type: ignore[arg-type]
            else:
                barrier.add_done(item)  # type: ignore[arg-type]
            while barrier.ready():
                taken_tick, messages = barrier.take()
                handed_out.append((taken_tick.index, [(channel, got.sequence) for channel, got in messages]))
        if not streams[name]:
            del streams[name]
        if not streams and again:
            random.shuffle(again)
            streams["again"], weights["again"], again = deque(again), 1, []
    return handed_out


@pytest.mark.parametrize("service", SERVICES)
@pytest.mark.parametrize("lost", [0.0, 0.2])
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), arrival=st.integers(0, 2**32 - 1))
def test_any_interleaving_of_arrivals_hands_out_the_same(
    service: str, lost: float, seed: int, arrival: int
) -> None:
    script = write_script(service, Random(seed), ticks=30)
    assert play(script, Random(arrival), lost) == script.expected


def test_a_tick_that_brings_nothing_new_asks_for_earlier_dones() -> None:
    barrier = barrier_of("antenna_height")
    participants = {"antenna_height": -1, "localizer": -1}
    first = tick(0, participants, ("antenna_height",))
    assert not barrier.add_tick(first)
    assert barrier.add_tick(first)
    numbers(barrier)
    assert barrier.add_tick(first)
    assert barrier.add_tick(tick(1, participants | {"antenna_height": 0}, ("localizer",)))
    assert not barrier.add_tick(tick(0, {"localizer": -1}, ("localizer",)))
    assert not barrier.ticks


def test_the_scripts_bring_what_they_should() -> None:
    script = write_script("localizer", Random(1), ticks=200)
    names = {name for _, messages in script.expected for name, _ in messages}
    assert names == {channel.name for channel in inputs_of("localizer")}
    assert 100 < len(script.expected) <= 200
