"""What Zenoh alone costs: small processes that pass bytes on along the same way as Camber's, and do nothing else.

    receiver ─▶ gnss ─ fix ─▶ localizer ◀─ question, answer ─▶ map_server
                                  └─ pose ─▶ integrity ─ verdict ─▶ observer (who also gets the fix)

Python, peers over TCP on the loopback, every message sent at once (express): as in Camber, without its table, codec,
barrier and mathematics.
"""

from __future__ import annotations

import json
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

import zenoh

STAGES = 6  # as many processes as Camber has services
_PATIENCE_S = 20.0


def open_peer(*, connect: str | None = None, listen: str = "tcp/127.0.0.1:0") -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("peer"))
    config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
    config.insert_json5("listen/endpoints", json.dumps([listen]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def pass_on(session: zenoh.Session, take: str, give: str, size: int) -> None:
    publisher = session.declare_publisher(give, express=True)
    subscriber = session.declare_subscriber(take)
    for sample in subscriber:
        publisher.put(sample.payload.to_bytes()[:8].ljust(size, b"\0"))


def localize(session: zenoh.Session, sizes: Mapping[str, int]) -> None:
    publisher = session.declare_publisher("bare/pose", express=True)
    querier = session.declare_querier("bare/elevation", express=True)
    subscriber = session.declare_subscriber("bare/fix")
    for sample in subscriber:
        number = sample.payload.to_bytes()[:8]
        for _ in querier.get(payload=number.ljust(sizes["question"], b"\0")):
            pass
        publisher.put(number.ljust(sizes["pose"], b"\0"))


def answer(session: zenoh.Session, size: int) -> None:
    queryable = session.declare_queryable("bare/elevation")
    for query in queryable:
        with query:
            query.reply("bare/elevation", b"\0" * size, express=True)


def role(name: str, endpoint: str, sizes: Mapping[str, int]) -> None:
    session = open_peer(connect=endpoint)
    if name == "gnss":
        pass_on(session, "bare/receiver", "bare/fix", sizes["fix"])
    elif name == "localizer":
        localize(session, sizes)
    elif name == "map_server":
        answer(session, sizes["answer"])
    elif name == "integrity":
        pass_on(session, "bare/pose", "bare/verdict", sizes["verdict"])
    else:
        stage = int(name)
        pass_on(session, f"bare/stage/{stage}", f"bare/stage/{stage + 1}", sizes["fix"])


@contextmanager
def processes(names: list[str], sizes: Mapping[str, int]) -> Iterator[zenoh.Session]:
    """The session of the observer, with the named roles beside it."""
    endpoint = free_endpoint()
    with ExitStack() as ends:
        session = open_peer(listen=endpoint)
        ends.callback(session.close)
        for name in names:
            child = subprocess.Popen([sys.executable, __file__, name, endpoint, json.dumps(sizes)])
            ends.callback(child.wait)
            ends.callback(child.kill)
        yield session


def latencies_ms(sizes: Mapping[str, int], *, rate_hz: float, stop: threading.Event) -> list[float]:
    """From a fix received to its verdict received, until `stop` is set."""
    arrived: dict[str, dict[int, float]] = {"bare/fix": {}, "bare/verdict": {}}

    def take(sample: zenoh.Sample) -> None:
        number = int.from_bytes(sample.payload.to_bytes()[:8], "little")
        arrived[str(sample.key_expr)].setdefault(number, time.perf_counter())

    with processes(["gnss", "localizer", "map_server", "integrity"], sizes) as session:
        subscribers = [session.declare_subscriber(key, take) for key in arrived]
        publisher = session.declare_publisher("bare/receiver", express=True)
        number = 0
        while not stop.wait(1.0 / rate_hz):
            number += 1
            publisher.put(number.to_bytes(8, "little").ljust(sizes["receiver"], b"\0"))
        time.sleep(0.2)
        for subscriber in subscribers:
            subscriber.undeclare()
    pairs = [(arrived["bare/fix"].get(n), t) for n, t in sorted(arrived["bare/verdict"].items())]
    latency_ms = [1e3 * (verdict - fix) for fix, verdict in pairs if fix is not None]
    return latency_ms[round(2 * rate_hz) :]  # the first seconds: connections are still being made


def lock_step_per_s(size: int, *, seconds: float) -> float:
    """Epochs a second through a ring of STAGES processes, one epoch at a time; the median of half-second parts."""
    back = threading.Semaphore(0)
    sizes = {"fix": size}
    with processes([str(stage) for stage in range(STAGES)], sizes) as session:
        subscriber = session.declare_subscriber(f"bare/stage/{STAGES}", lambda _: back.release())
        publisher = session.declare_publisher("bare/stage/0", express=True)
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            publisher.put(b"\0" * size)
            if back.acquire(timeout=0.2):
                break
            if time.monotonic() > deadline:
                raise RuntimeError(f"the ring was not closed within {_PATIENCE_S:.0f} s")
        time.sleep(0.5)
        while back.acquire(blocking=False):
            pass
        rates = []
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            began, n = time.perf_counter(), 0
            while time.perf_counter() - began < 0.5:
                publisher.put(b"\0" * size)
                if not back.acquire(timeout=5.0):
                    raise RuntimeError("an epoch was lost in the ring")
                n += 1
            rates.append(n / (time.perf_counter() - began))
        subscriber.undeclare()
    return statistics.median(rates)


if __name__ == "__main__":
    role(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
