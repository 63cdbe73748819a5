"""Metrics of a service for Prometheus: the latest health of its work loop, and its age.

A thread beside the work loop serves them over HTTP, so that a loop that is frozen is seen: its words stay, and
`camber_said_age_seconds` grows. A process that is frozen as a whole answers nothing.

No more than a few connections are served at once, each for a short time, and new ones are taken up at a bounded pace:
any client of the port can keep others from reading metrics, and cannot hold up the service.
"""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from functools import partial
from http import HTTPStatus

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector

from camber.schemas.health import Health

_Family = GaugeMetricFamily | CounterMetricFamily
REFUSALS = ("undecodable", "stale", "future", "repeated", "out_of_order", "overflow")
_STATUSES = ("starting", "ok", "degraded", "failing")
_MOST_CONNECTIONS = 16  # chosen: more than any scraper opens
_CONNECTION_LIMIT_S = 3.0  # chosen: a slow client must not hold a connection
_BETWEEN_CONNECTIONS_S = 0.005  # chosen: bounds the processor time of clients
_MOST_HEAD_BYTES = 8192  # chosen: largest HTTP request head


class HealthCollector(Collector):
    """The latest health; set by the work loop, read by the thread that serves it."""

    def __init__(self, service: str, vehicle: str) -> None:
        self._labels = {"service": service, "vehicle": vehicle}
        self._last: tuple[Health | None, float] = (None, time.monotonic())
        self._gauge = partial(self._filled, GaugeMetricFamily)
        self._counter = partial(self._filled, CounterMetricFamily)

    def say(self, health: Health) -> None:
        """This is how the service is now."""
        self._last = (health, time.monotonic())

    def collect(self) -> Iterator[Metric]:
        """All families; before the loop has begun only that it says nothing."""
        health, reported_s = self._last
        age_s = time.monotonic() - reported_s
        yield self._gauge("said_age_seconds", "since the work loop last reported its health", [({}, age_s)])
        status = "starting" if health is None else health.status
        states = [({"status": each}, float(each == status)) for each in _STATUSES]
        yield self._gauge("status", "1 for the present status", states)
        if health is not None:
            yield from self._health_metrics(health, age_s)

    def _health_metrics(self, health: Health, age_s: float) -> Iterator[Metric]:
        facts = {name.replace(".", "_"): text for name, text in health.facts.items()}
        info = InfoMetricFamily("camber_service", "what runs here", labels=list(self._labels))
        info.add_metric(list(self._labels.values()), {"version": health.version, **facts})
        yield info
        yield self._gauge("uptime_seconds", "since the service began", [({}, health.uptime_s + age_s)])
        issues = [({"code": issue.code}, float(issue.count)) for issue in health.issues]
        yield self._counter("issues", "problems met, by code (docs/runbook.md)", issues)
        uses = [({"channel": use.channel, "direction": use.direction}, use) for use in health.channels]
        messages = [(labels, use.messages) for labels, use in uses]
        yield self._counter("messages", "over each channel, refused ones among them", messages)
        ages = [(labels, use.age_s + age_s) for labels, use in uses if use.age_s is not None]
        yield self._gauge("channel_age_seconds", "since the last message of each channel", ages)
        waiting = [(labels, use.waiting) for labels, use in uses if use.direction != "out"]
        yield self._gauge("queue_length", "messages and questions that wait for the work loop", waiting)
        inputs = {use.channel for use in health.channels if use.direction == "in"}
        refused, verdicts, events = [], [], []
        for name, count in health.counters.items():
            first, _, rest = name.partition(".")
            if first in inputs and rest in REFUSALS:
                refused.append(({"channel": first, "reason": rest}, count))
            elif first == "verdict" and rest:
                verdicts.append(({"verdict": rest}, count))
            else:
                events.append(({"event": name}, count))
        yield self._counter("refused", "messages that were not used, by channel and reason", refused)
        if verdicts:
            yield self._counter("verdicts", "words on fixes", verdicts)
        yield self._counter("events", "what else the service counts", events)
        for name, value in health.gauges.items():
            metric = name.replace(".", "_").replace("-", "_")
            metric = f"{metric[:-2]}_seconds" if metric.endswith("_s") else metric
            yield self._gauge(metric, "as the service says of itself", [({}, value)])

    def _filled(
        self, family: type[_Family], name: str, text: str, values: Sequence[tuple[dict[str, str], float]]
    ) -> Metric:
        labels = [*self._labels, *(values[0][0] if values else ())]
        metric = family(f"camber_{name}", text, labels=labels)
        for extra, value in values:
            metric.add_metric([*self._labels.values(), *extra.values()], value)
        return metric


class MetricsServer:
    """Serves `/metrics` until it is closed. Raises OSError where the port cannot be had."""

    def __init__(self, host: str, port: int, collector: HealthCollector) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(collector)
        ProcessCollector(registry=self._registry)
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.create_server((host, port), family=family, backlog=_MOST_CONNECTIONS)
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Serve no more."""
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(1.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._task = self._loop.create_task(self._accept())
        try:
            self._loop.run_until_complete(self._task)
        except asyncio.CancelledError:
            pass
        finally:
            for task in asyncio.all_tasks(self._loop):
                task.cancel()
            self._loop.run_until_complete(asyncio.sleep(0))
            self._socket.close()
            self._loop.close()

    async def _accept(self) -> None:
        places = asyncio.Semaphore(_MOST_CONNECTIONS)
        serving: set[asyncio.Task[None]] = set()
        while True:
            await places.acquire()
            try:
                connection, _ = await self._loop.sock_accept(self._socket)
            except OSError:  # no more files may be opened
                places.release()
                await asyncio.sleep(1.0)
                continue
            task = self._loop.create_task(self._serve(connection))
            serving.add(task)
            task.add_done_callback(serving.discard)
            task.add_done_callback(lambda _: places.release())
            await asyncio.sleep(_BETWEEN_CONNECTIONS_S)

    async def _serve(self, connection: socket.socket) -> None:
        try:
            reader, writer = await asyncio.open_connection(sock=connection, limit=_MOST_HEAD_BYTES)
        except OSError:
            connection.close()
            return
        try:
            async with asyncio.timeout(_CONNECTION_LIMIT_S):
                writer.write(self._answer(await reader.readuntil(b"\r\n\r\n")))
                writer.close()
                await writer.wait_closed()
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        finally:
            writer.transport.abort()

    def _answer(self, head: bytes) -> bytes:
        request, *lines = head.decode("latin-1").split("\r\n")
        method, _, rest = request.partition(" ")
        path = rest.partition(" ")[0].partition("?")[0]
        if method not in ("GET", "HEAD"):
            return _response(HTTPStatus.METHOD_NOT_ALLOWED, "text/plain", b"GET /metrics\n")
        if path not in ("/", "/metrics"):
            return _response(HTTPStatus.NOT_FOUND, "text/plain", b"/metrics\n")
        headers = dict(line.lower().split(": ", 1) for line in lines if ": " in line)
        try:
            encoder, kind = choose_encoder(headers.get("accept", ""))
        except (TypeError, ValueError):  # a version of OpenMetrics that is none
            encoder, kind = choose_encoder("")
        return _response(HTTPStatus.OK, kind, b"" if method == "HEAD" else encoder(self._registry))


def _response(status: HTTPStatus, kind: str, body: bytes) -> bytes:
    head = (
        f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
        "Connection: close\r\nCache-Control: no-store\r\n\r\n"
    )
    return head.encode("ascii") + body
