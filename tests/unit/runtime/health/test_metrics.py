"""Metrics are what the work loop reported last, read by Prometheus' own parser; hostile clients hold nothing up."""

from __future__ import annotations

import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics_families
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from camber.runtime.clock import SystemClock
from camber.runtime.health.metrics import HealthCollector, MetricsServer
from camber.schemas.health import ChannelUse, Health, Issue

PROCESS = {"service": "integrity", "vehicle": "v7"}


def health() -> Health:
    return Health(
        time_ns=SystemClock().now_ns(),
        service="integrity",
        version="0.1.0",
        status="degraded",
        uptime_s=12.0,
        loop_age_s=0.0,
        issues=(Issue(code="upload_unanswered", text='a "quoted"\ntext', count=3),),
        counters={"verdict.confirmed": 7, "fix.stale": 2, "fix.judged_already": 1},
        channels=(
            ChannelUse(channel="fix", direction="in", messages=9, age_s=0.25, waiting=4),
            ChannelUse(channel="verdict", direction="out", messages=8, age_s=None),
            ChannelUse(channel="health", direction="asked", messages=1, age_s=3.0),
        ),
        gauges={"uploads_waiting": 5.0, "loop_lag_s": 0.5},
        facts={"process": "host:1", "map_release": 'nagoya "3"'},
    )


@pytest.fixture
def server() -> Iterator[MetricsServer]:
    """Of a service whose work loop has not begun."""
    with closing(MetricsServer("127.0.0.1", 0, HealthCollector("integrity", "v7"))) as server:
        yield server
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port), timeout=1.0).close()


@pytest.fixture
def reporting() -> Iterator[MetricsServer]:
    """Of a service that has reported its health."""
    collector = HealthCollector("integrity", "v7")
    collector.say(health())
    with closing(MetricsServer("127.0.0.1", 0, collector)) as server:
        yield server


def get(server: MetricsServer, accept: str = "", path: str = "/metrics") -> tuple[str, str]:
    request = urllib.request.Request(
        f"http://127.0.0.1:{server.port}{path}", headers={"Accept": accept} if accept else {}
    )
    with urllib.request.urlopen(request, timeout=10.0) as answer:
        return answer.read().decode(), answer.headers["Content-Type"]


def samples(server: MetricsServer) -> dict[str, list[Sample]]:
    result: dict[str, list[Sample]] = {}
    for family in text_string_to_metric_families(get(server)[0]):
        for sample in family.samples:
            result.setdefault(sample.name, []).append(sample)
    return result


def value(result: dict[str, list[Sample]], name: str, **labels: str) -> float:
    (sample,) = [one for one in result[name] if {**one.labels, **PROCESS, **labels} == one.labels]
    return float(sample.value)


def test_every_part_of_the_health_is_there(reporting: MetricsServer) -> None:
    result = samples(reporting)
    assert value(result, "camber_status", status="degraded") == 1.0
    assert value(result, "camber_status", status="ok") == 0.0
    assert value(result, "camber_messages_total", channel="fix", direction="in") == 9.0
    assert value(result, "camber_messages_total", channel="verdict", direction="out") == 8.0
    assert value(result, "camber_refused_total", channel="fix", reason="stale") == 2.0
    assert value(result, "camber_events_total", event="fix.judged_already") == 1.0
    assert value(result, "camber_verdicts_total", verdict="confirmed") == 7.0
    assert value(result, "camber_issues_total", code="upload_unanswered") == 3.0
    assert value(result, "camber_queue_length", channel="fix", direction="in") == 4.0
    assert value(result, "camber_uploads_waiting") == 5.0
    assert value(result, "camber_loop_lag_seconds") == 0.5
    assert value(result, "camber_service_info", version="0.1.0", map_release='nagoya "3"') == 1.0
    assert [s.labels["channel"] for s in result["camber_channel_age_seconds"]] == ["fix", "health"], (
        "what never came has no age"
    )
    assert result["process_resident_memory_bytes"][0].value > 1e6


def test_both_text_formats_are_served_as_asked(reporting: MetricsServer) -> None:
    for accept in ("application/openmetrics-text; version=abc", "text/plain;version=0.0.4"):
        plain, kind = get(reporting, accept)
        assert kind.startswith("text/plain; version=0.0.4")
        assert "camber_said_age_seconds" in plain
    text, kind = get(reporting, "application/openmetrics-text;version=1.0.0,text/plain;q=0.5")
    assert kind.startswith("application/openmetrics-text")
    assert text.endswith("# EOF\n")
    assert not plain.endswith("# EOF\n")
    names = {family.name for family in openmetrics_families(text)}
    assert {"camber_messages", "camber_status", "camber_said_age_seconds"} <= names


def test_before_the_loop_has_begun_it_is_starting(server: MetricsServer) -> None:
    result = samples(server)
    assert value(result, "camber_status", status="starting") == 1.0
    assert "camber_uptime_seconds" not in result


def test_of_a_frozen_loop_the_figures_stay_and_their_age_grows(
    reporting: MetricsServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = samples(reporting)
    monkeypatch.setattr(time, "monotonic", lambda real=time.monotonic: real() + 60.0)
    after = samples(reporting)
    assert value(before, "camber_said_age_seconds") < 30.0
    assert value(after, "camber_said_age_seconds") >= 60.0
    assert value(after, "camber_channel_age_seconds", channel="fix", direction="in") >= 60.25
    assert value(after, "camber_messages_total", channel="fix", direction="in") == 9.0


@pytest.mark.parametrize(("path", "code"), [("/other", 404), ("/metrics/../etc", 404)])
def test_other_pages_are_not_there(server: MetricsServer, path: str, code: int) -> None:
    with pytest.raises(urllib.error.HTTPError) as error:
        get(server, path=path)
    assert error.value.code == code
    error.value.close()


def raw(server: MetricsServer, data: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", server.port), timeout=10.0) as connection:
        connection.sendall(data)
        parts = []
        try:
            while part := connection.recv(65536):
                parts.append(part)
        except ConnectionResetError:
            pass
        return b"".join(parts)


@pytest.mark.parametrize(
    ("data", "begin"),
    [
        (b"POST /metrics HTTP/1.1\r\n\r\n", b"HTTP/1.1 405"),
        (b"\xff\xfe\x00\r\n\r\n", b"HTTP/1.1 405"),
        (b"HEAD /metrics HTTP/1.1\r\n\r\n", b"HTTP/1.1 200"),
        (b"GET " + b"a" * 100_000, b""),
    ],
)
def test_what_is_no_question_is_refused_and_the_next_one_answered(
    reporting: MetricsServer, data: bytes, begin: bytes
) -> None:
    answer = raw(reporting, data)
    assert answer.startswith(begin)
    assert bool(answer) == bool(begin)
    assert value(samples(reporting), "camber_uptime_seconds") >= 12.0


def test_who_asks_slowly_and_in_great_number_is_dropped(reporting: MetricsServer) -> None:
    threads = threading.active_count()
    with ExitStack() as held:
        for _ in range(60):  # more than are served at once, and none ever ends its question
            connection = held.enter_context(socket.socket())
            connection.setblocking(False)
            connection.connect_ex(("127.0.0.1", reporting.port))
        assert value(samples_after(reporting, 30.0), "camber_uptime_seconds") >= 12.0, (
            "they are dropped in time"
        )
        assert threading.active_count() == threads, "no thread was made for them"


def samples_after(server: MetricsServer, limit_s: float) -> dict[str, list[Sample]]:
    deadline = time.monotonic() + limit_s
    while True:
        try:
            return samples(server)
        except (OSError, TimeoutError):
            if time.monotonic() > deadline:
                raise


def test_a_port_that_is_taken_is_reported(server: MetricsServer) -> None:
    with pytest.raises(OSError, match="in use"):
        MetricsServer("127.0.0.1", server.port, HealthCollector("gnss", "v7"))
