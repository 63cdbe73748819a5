"""Faults within a vehicle, one after the other, on one drive through real processes in real time.

Three fixes in twenty are wrong all along: whatever fails, none of them is confirmed, and while an input is missing
nothing is. Recovery is measured and kept (`make faults`), never judged: how long it takes is the machine's affair.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh

from camber.runtime.session import open_session
from camber.schemas.channels import BY_NAME, SERVICES, VEHICLE_SERVICES
from camber.schemas.integrity import Verdict
from support import stepped_clock
from support.fault_figures import LONG, measured
from support.live_drive import TRUSTED
from support.live_vehicle import LiveVehicle, Witness, driving, now_ns
from support.running import client_of, free_endpoint, started, wait_until
from support.small_disk import SmallDisk, small_disk

pytestmark = pytest.mark.slow

_NS = 1_000_000_000
YEAR_S = 365.0 * 86_400.0
RETURN_S = 180.0  # of a service that is started again on a busy machine
BEYOND_S = 10.0 if LONG else 3.0  # how much longer than its last word may be used a service is away
DISK_BYTES = 8_000_000  # more than all uploads of the rows before take, in the long form too
AGE_S = {
    "gnss": BY_NAME["fix"].max_age_s,
    # The localizer asks for the road two seconds ahead.
    "map_server": 2.0 + BY_NAME["elevation"].max_age_s + BY_NAME["pose"].max_age_s,
    "localizer": BY_NAME["pose"].max_age_s,
    "antenna_height": BY_NAME["antenna_height"].max_age_s,
    "integrity": 0.0,
}
"""For how long a verdict may rest on the last message of a service."""

SLOW_CONSUMER = """
import sys, time
from camber.runtime.bus import direct
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
session = open_session(ZenohSettings(mode="client", connect=[sys.argv[1]]))
def slowly(sample):
    print(len(sample.payload.to_bytes()), flush=True)
    time.sleep(1.0)
subscribers = [session.declare_subscriber(key, direct(slowly)) for key in ("camber/v1/**", "bulk")]
time.sleep(600.0)
"""


@dataclass
class Here:
    vehicle: LiveVehicle
    witness: Witness
    clock: Path
    disks: dict[str, SmallDisk]


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> Iterator[Here]:
    folder = tmp_path_factory.mktemp("vehicle")
    with ExitStack() as ends:
        disks = {
            name: ends.enter_context(small_disk(folder / "state" / name, DISK_BYTES))
            for name in ("integrity", "map_update")
        }
        clock = stepped_clock.make(folder / "clock")
        vehicle = LiveVehicle(
            folder,
            free_endpoint(),
            services=SERVICES,
            launcher={name: ["-m", "support.stepped_clock", str(clock), name] for name in VEHICLE_SERVICES},
        )
        witness = ends.enter_context(driving(vehicle))
        yield Here(vehicle, witness, clock, disks)


@pytest.fixture(autouse=True)
def promised(here: Here) -> Iterator[None]:
    """Of every fault: no service dies of it, and no wrong fix is passed on from its begin to the end of its row."""
    began_s = time.monotonic()
    here.witness.wait_for_trust(began_s, timeout_s=RETURN_S)
    yield
    assert not here.witness.wrong_but_trusted(began_s), here.witness.verdict_counts(began_s)
    assert here.vehicle.ended() == {}


def trusted_of(witness: Witness, from_s: float, after_ns: int, before_ns: int) -> list[Verdict]:
    """Trusted verdicts since then, on fixes measured in that time."""
    verdicts = witness.messages(Verdict, from_s)
    return [
        verdict
        for verdict in verdicts
        if verdict.verdict in TRUSTED and after_ns < verdict.time_ns < before_ns
    ]


@dataclass
class Away:
    """While a service was away: `by_s` is when it was taken away; of fixes after `limit_ns` nothing can be known."""

    by_s: float
    limit_ns: int


@contextmanager
def without(here: Here, service: str, fault: str) -> Iterator[Away]:
    """The body takes a service away; on leaving it is away for long enough, and nothing was passed on meanwhile."""
    began_s, began_ns = time.monotonic(), now_ns()
    away = Away(began_s, began_ns)
    yield away
    away.limit_ns = limit_ns = now_ns() + round(AGE_S[service] * _NS)
    time.sleep(AGE_S[service] + BEYOND_S)
    assert trusted_of(here.witness, began_s, limit_ns, now_ns()) == []
    late = [v for v in here.witness.messages(Verdict, began_s) if v.time_ns > limit_ns]
    assert {verdict.verdict for verdict in late} <= {"unknown"}, fault
    if service != "integrity":
        wait_until(
            lambda: [v for v in here.witness.messages(Verdict, began_s) if v.time_ns > limit_ns],
            timeout_s=20.0,
            why=f"{fault}: the judge is silent, expected unknown",
        )
    assert began_ns < limit_ns


@pytest.mark.parametrize("service", VEHICLE_SERVICES)
def test_killed(here: Here, service: str) -> None:
    with without(here, service, f"{service} killed"):
        here.vehicle.kill(service)
    here.vehicle.start(service)
    after_s = here.witness.wait_for_new_trust(timeout_s=RETURN_S)
    measured(f"{service} killed", confirmed_after_start_s=after_s)


@pytest.mark.parametrize("service", VEHICLE_SERVICES)
def test_frozen(here: Here, service: str) -> None:
    try:
        with without(here, service, f"{service} frozen") as away:
            here.vehicle.freeze(service)
    finally:
        here.vehicle.resume(service)
    back_ns = now_ns()
    after_s = here.witness.wait_for_new_trust(timeout_s=RETURN_S)
    # What it says on waking of the time that it has missed is passed on by nobody.
    assert trusted_of(here.witness, away.by_s, away.limit_ns, back_ns - _NS) == []
    measured(f"{service} frozen", confirmed_after_going_on_s=after_s)


def test_router_killed(here: Here) -> None:
    here.vehicle.kill("router")
    began_s, gone_ns = time.monotonic(), now_ns()
    time.sleep(1.0 + BEYOND_S)
    back_ns = now_ns()
    here.vehicle.start("router")
    after_s = here.witness.wait_for_new_trust(timeout_s=RETURN_S)
    # Measurements of the time without a bus are never published later as if they were new.
    assert trusted_of(here.witness, began_s, gone_ns + _NS, back_ns - _NS) == []
    measured("router killed", confirmed_after_start_s=after_s)


def test_a_consumer_that_does_not_keep_up_holds_up_nobody_else(here: Here) -> None:
    session = open_session(client_of(here.vehicle.endpoint).zenoh)
    ended = threading.Event()

    def much() -> None:
        publisher = session.declare_publisher("bulk", congestion_control=zenoh.CongestionControl.DROP)
        while not ended.wait(0.02):
            publisher.put(bytes(256_000))

    with started("-c", SLOW_CONSUMER, here.vehicle.endpoint) as consumer:
        assert consumer.stdout is not None
        assert consumer.stdout.readline(), "it has received nothing"
        thread = threading.Thread(target=much)
        thread.start()
        try:
            began_s, began_ns = time.monotonic(), now_ns()
            time.sleep(60.0 if LONG else 4.0)
            after_s = here.witness.wait_for_trust(
                time.monotonic(), timeout_s=RETURN_S, dated_after_ns=began_ns
            )
        finally:
            ended.set()
            thread.join()
            session.close()
        verdict_counts = here.witness.verdict_counts(began_s)
        assert verdict_counts["right", "confirmed"] > 0
        measured("slow consumer", confirmed_while_it_lasts_s=after_s)


@pytest.mark.parametrize(
    "offset_s", [60.0, -60.0, YEAR_S, -YEAR_S], ids=["forward", "back", "a year forward", "a year back"]
)
def test_the_clock_is_set_wrong_and_right_again(here: Here, offset_s: float) -> None:
    """Of all services; the receiver goes on by the satellites' time."""
    stepped_clock.step(here.clock, offset_s)
    began_s, limit_ns = time.monotonic(), now_ns() + _NS // 2
    try:
        time.sleep(1.5 + BEYOND_S)
        assert trusted_of(here.witness, began_s, limit_ns, now_ns()) == []
    finally:
        stepped_clock.step(here.clock, 0.0)
    after_s = here.witness.wait_for_new_trust(timeout_s=RETURN_S)
    measured(f"clock {offset_s:+.0f} s", confirmed_after_it_is_right_s=after_s)


@pytest.mark.parametrize("service", ["integrity", "map_update"])
def test_a_full_disk(here: Here, service: str) -> None:
    """What is judged meanwhile waits in memory or in the vehicle, and is in the cloud once there is room, once each."""
    began_s, began_ns = time.monotonic(), now_ns()
    here.disks[service].fill()
    try:
        time.sleep(60.0 if LONG else 4.0)
        health = wait_until(lambda: here.vehicle.health(service), timeout_s=60.0, why=f"{service} is silent")
        wait_until(
            lambda: met(here, service, ("upload_not_stored", "store_unavailable", "disk")),
            timeout_s=60.0,
            why=f"{service} does not say that its disk is full: {health.issues}",
        )
        meanwhile = here.witness.wait_for_trust(time.monotonic(), timeout_s=RETURN_S, dated_after_ns=began_ns)
    finally:
        here.disks[service].free()
    free_s, free_ns = time.monotonic(), now_ns()
    sent = {v.time_ns for v in here.witness.messages(Verdict, began_s, free_s) if v.verdict == "confirmed"}
    sent = {time_ns for time_ns in sent if began_ns < time_ns < free_ns}
    assert sent
    wait_until(
        lambda: sent <= set(here.vehicle.stored_ns()),
        timeout_s=RETURN_S,
        why="uploads of the time without a disk",
    )
    after_s = time.monotonic() - free_s
    times = here.vehicle.stored_ns()
    assert len(times) == len(set(times))
    measured(f"disk of {service} full", confirmed_meanwhile_s=meanwhile, uploads_in_the_cloud_after_s=after_s)


def met(here: Here, service: str, verdict_counts: tuple[str, ...]) -> bool:
    """Does the service say something of the kind?"""
    health = here.vehicle.health(service)
    issues = [] if health is None else [f"{issue.code} {issue.text}" for issue in health.issues]
    return any(name in issue for name in verdict_counts for issue in issues)
