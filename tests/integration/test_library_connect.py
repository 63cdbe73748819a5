"""Positions of a live vehicle by `camber.connect`: fresh ones as they come, then None, by `for` and by `async for`."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Iterator

import pytest

import camber
from camber.schemas.channels import BY_NAME
from camber.schemas.integrity import Position, Verdict
from support.running import CLOCK, bus_of, loopback_router

PERIOD_S = 0.05


def message_of(channel: str) -> Position | Verdict:
    """A message of now."""
    if channel == "verdict":
        return Verdict(time_ns=CLOCK.now_ns(), fix_id=1, verdict="unknown", reason="starting")
    return Position(time_ns=CLOCK.now_ns(), source="none", usable=False, alert_limit_m=1.5)


@contextlib.contextmanager
def published(channel: str) -> Iterator[tuple[str, threading.Event]]:
    """The endpoint of a vehicle that publishes until the event is set."""
    ended = threading.Event()
    with loopback_router() as endpoint:
        bus = bus_of(endpoint, "integrity")
        bus.announce()

        def publish() -> None:
            while not ended.wait(PERIOD_S):
                bus.publish(channel, message_of(channel))

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield endpoint, ended
        finally:
            ended.set()
            thread.join()
            bus.close()


@pytest.mark.parametrize("channel", ["position", "verdict"])
def test_after_the_last_fresh_message_comes_none(channel: str) -> None:
    with published(channel) as (endpoint, ended):
        vehicle = camber.connect("car", endpoints=[endpoint])
        with vehicle.positions() if channel == "position" else vehicle.verdicts() as messages:
            times_ns = []
            for message in messages:
                if message is None:
                    break
                times_ns.append(message.time_ns)
                if len(times_ns) == 5:
                    ended.set()
            silent_s = (CLOCK.now_ns() - times_ns[-1]) / 1e9
    limit_s = BY_NAME[channel].max_age_s
    assert limit_s is not None
    assert times_ns == sorted(set(times_ns))
    assert silent_s >= limit_s


def test_async_for_leaves_the_loop_free_and_stops_trusting_too() -> None:
    async def consume(endpoint: str, ended: threading.Event) -> tuple[list[Position | None], int]:
        received: list[Position | None] = []
        turns = 0

        async def count() -> None:
            nonlocal turns
            while True:
                await asyncio.sleep(0.01)
                turns += 1

        counting = asyncio.create_task(count())
        with camber.connect("car", endpoints=[endpoint]).positions() as positions:
            async for position in positions:
                received.append(position)
                if len(received) == 5:
                    ended.set()
                if position is None:
                    break
        counting.cancel()
        return received, turns

    with published("position") as (endpoint, ended):
        began_s = time.monotonic()
        received, turns = asyncio.run(asyncio.wait_for(consume(endpoint, ended), 60.0))
        lasted_s = time.monotonic() - began_s
    assert received[-1] is None
    assert None not in received[:-1]
    assert len(received) >= 6
    assert turns > 10.0 * lasted_s, "a tenth of what the loop could do"


def test_a_loop_that_is_cancelled_ends_at_once_without_a_vehicle() -> None:
    async def consume(endpoint: str) -> None:
        with camber.connect("nobody", endpoints=[endpoint]).positions() as positions:
            async for _ in positions:
                raise AssertionError("nobody publishes")

    with loopback_router() as endpoint, pytest.raises(TimeoutError):
        asyncio.run(asyncio.wait_for(consume(endpoint), 0.5))
