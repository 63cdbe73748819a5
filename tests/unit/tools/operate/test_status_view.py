"""`camber status`: services, channels, notes and exit code from the reports of the services."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from camber.runtime.query import BusError, QueryFailed
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import EARLIEST_NS
from camber.schemas.health import ChannelUse, Health, Issue
from camber.tools.operate import status
from camber.tools.operate.status import as_text, duration, fleet_text
from camber.tools.operate.status_view import StatusView, view_of
from support.refusals import Refused

NOW_NS = EARLIEST_NS + 10**18


def health(service: str = "gnss", **more: Any) -> Health:
    fields: dict[str, Any] = {"version": "0.1.0", "status": "ok", "uptime_s": 100.0, "loop_age_s": 0.0}
    return Health(time_ns=NOW_NS, service=service, **(fields | more))


def use(
    channel: str, direction: str, messages: int, age_s: float | None = 0.1, waiting: int = 0
) -> ChannelUse:
    return ChannelUse(channel=channel, direction=direction, messages=messages, age_s=age_s, waiting=waiting)


def view(*reports: Health) -> StatusView:
    return view_of("v", {report.service: [report] for report in reports}, {}, frozenset())


@pytest.mark.parametrize(
    ("messages", "uptime_s", "rate_hz"), [(120, 104.0, 5.0), (5, 1.0, None)], ids=["running", "restarted"]
)
def test_a_rate_is_the_difference_of_two_counts(
    messages: int, uptime_s: float, rate_hz: float | None
) -> None:
    before = health("gnss", channels=(use("fix", "out", 100),), uptime_s=100.0)
    now = health("gnss", channels=(use("fix", "out", messages),), uptime_s=uptime_s)
    (row,) = view_of("v", {"gnss": [now]}, {"gnss": [before]}, frozenset()).channels
    assert (row.channel, row.rate_hz, row.table_rate_hz) == ("fix", rate_hz, 10.0)


def test_a_channel_s_row_joins_the_reports_of_all_that_use_it() -> None:
    localizer_channels = (use("fix", "in", 8, 4.1, waiting=1),)
    integrity_channels = (use("fix", "in", 8, 4.2, waiting=3),)
    (row,) = view(
        health("gnss", channels=(use("fix", "out", 9, age_s=4.0),)),
        health("localizer", channels=localizer_channels, counters={"fix.stale": 2, "anchor.a": 7}),
        health("integrity", channels=integrity_channels, counters={"fix.stale": 1, "fix.other": 5}),
    ).channels
    assert set(row.received_s_ago) == {"localizer", "integrity"}
    assert row.refused == {"stale": 3}
    assert (row.age_s, row.waiting) == (4.2, 3)
    assert row.late


@pytest.mark.parametrize("age_s", [300.0, None], ids=["for long", "always"])
def test_a_service_that_receives_nothing_on_a_channel_in_use_is_named(age_s: float | None) -> None:
    shown = view(
        health("gnss", channels=(use("fix", "out", 9, age_s=0.05),)),
        health("localizer", channels=(use("fix", "in", 8, 0.05),)),
        health("integrity", channels=(use("fix", "in", 0, age_s),)),
    )
    (row,) = shown.channels
    assert (row.late, row.deaf, shown.exit_code) == (True, ["integrity"], 4)
    assert (row.age_s or 0.0) >= 100.0
    assert "integrity has had no fix for" in " ".join(shown.notes)


def test_a_channel_without_messages_is_not_late() -> None:
    silent = (use("motion", "in", 0, None),)
    shown = view(health("gnss", channels=silent), health("integrity", channels=silent))
    assert (shown.channels[0].late, shown.channels[0].deaf, shown.exit_code) == (False, [], 0)


@pytest.mark.parametrize(
    ("reason", "alive", "expected"),
    [
        ("timeout", True, "on the bus, but its work loop does not answer"),
        ("absent", True, "on the bus, but its work loop does not answer"),
        ("absent", False, "not on the bus"),
        ("timeout", False, "not on the bus any more"),
        ("refused", False, "refused"),
        ("invalid", True, "another version"),
    ],
)
def test_a_service_without_an_answer_is_not_answering(reason: Any, alive: bool, expected: str) -> None:
    answers = {"gnss": [QueryFailed(reason, reason)]}
    shown = view_of("v", answers, {}, frozenset({"gnss"} if alive else ()))
    (row,) = shown.services
    assert (row.state, shown.exit_code) == ("not answering", 1)
    assert expected in row.why


@pytest.mark.parametrize(
    ("states", "code"),
    [(["ok", "ok"], 0), (["ok", "degraded"], 4), (["starting", "ok"], 4), (["degraded", "failing"], 1)],
)
def test_the_exit_code_is_that_of_the_worst(states: list[str], code: int) -> None:
    assert view(*(health(f"s{n}", status=state) for n, state in enumerate(states))).exit_code == code


def test_one_hanging_worker_among_several_is_seen() -> None:
    answers = {"map_update": [health("map_update"), QueryFailed("timeout")]}
    shown = view_of("fleet", answers, {}, frozenset({"map_update"}))
    assert [row.state for row in shown.services] == ["ok", "not answering"]
    assert shown.exit_code == 1


def test_services_of_different_versions_are_noted() -> None:
    newer = {"version": "0.2.0", "facts": {"messages": "bbbb"}, "log_level": "debug"}
    shown = view(health("gnss", facts={"messages": "aaaa"}), health("integrity", **newer))
    notes = " ".join(shown.notes)
    assert "0.1.0, 0.2.0" in notes
    assert "aaaa, bbbb" in notes
    assert "integrity logs at debug" in notes


def test_the_table_shows_the_last_issue_and_its_age() -> None:
    issues = (
        Issue(code="source_lost", text="tcp:receiver:\n refused", count=3, last_time_ns=NOW_NS - 12 * 10**9),
        Issue(code="damaged_input", text="", count=9, last_time_ns=NOW_NS - 90 * 10**9),
    )
    output = health(
        "gnss",
        issues=issues,
        gauges={"memory_bytes": 85e6, "loop_lag_s": 0.012, "uploads_waiting": 3.0},
        facts={"map_release": "here 7"},
        channels=(use("fix", "out", 7, age_s=None), use("motion", "in", 7, waiting=2)),
    )
    text = as_text(view(output), NOW_NS)
    assert "source_lost ×3, 12 s ago: tcp:receiver: refused" in text
    line = next(line for line in text.splitlines() if line.startswith("gnss"))
    assert line.split()[1:8] == ["ok", "100", "s", "0.1.0", "85", "MB", "12"]
    assert "  5  " in line, "uploads, and messages in its queue"
    assert "here 7" in line
    assert "never" in text


def test_a_fleet_is_a_list_of_vehicles() -> None:
    assert fleet_text({}) == "no vehicle is on this bus"
    text = fleet_text({"v2": frozenset({"gnss"}), "v1": frozenset({"integrity", "gnss"})})
    assert text.splitlines()[1:] == ["v1       gnss, integrity", "v2       gnss"]


def test_durations_are_short() -> None:
    shown = [duration(s) for s in (0.0004, 0.02, 5.0, 90.0, 600.0, 10_000.0, 1e6)]
    assert shown == ["0.4 ms", "20 ms", "5 s", "90 s", "10 min", "2.8 h", "12 d"]


@pytest.mark.parametrize(
    ("expected", "vehicle"), [([], "car-7"), (["--vehicle", "car-8"], "car-8"), (["--fleet"], "fleet")]
)
def test_the_vehicle_is_the_one_that_is_named_or_that_of_the_settings(
    tmp_path: Path, expected: list[str], vehicle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def nobody(settings: ServiceSettings, **_: Any) -> None:
        asked.append(settings.vehicle)
        raise BusError("away")

    monkeypatch.setattr(status, "QueryClient", nobody)
    config = tmp_path / "car.toml"
    config.write_text('vehicle = "car-7"\n')
    assert status.main(["--config", str(config), *expected]) == 3
    assert status.main([]) == 3
    assert asked == [vehicle, "vehicle"]


@pytest.mark.parametrize("option", ["--service", "--expect"])
@pytest.mark.parametrize("name", ["a//b", "", "gnss/", "*", "a b"])
def test_an_invalid_name_of_a_service_is_refused(option: str, name: str, refused: Refused) -> None:
    line = refused(status.main, option, name)
    assert line == f"camber status: error: argument {option}: {name!r}: expected the name of a service"
