"""`camber health`: 1 only where a supervisor should look; over a real router, with a service's part played here."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import zenoh

from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.codec import encode, encoding_of
from camber.schemas.health import Health, Issue
from camber.tools.operate import health as tool
from support.refusals import Refused
from support.running import free_port

KEY = "camber/v1/v7/gnss/health"


def a_health(status: Any = "ok", issues: tuple[Issue, ...] = ()) -> Health:
    return Health(
        time_ns=SystemClock().now_ns(),
        service="gnss",
        version="0.1.0",
        status=status,
        uptime_s=12.3,
        loop_age_s=0.01,
        issues=issues,
        counters={"fix.stale": 4},
    )


@contextmanager
def answering(endpoint: str, answer: Callable[[zenoh.Query], None]) -> Iterator[None]:
    """A gnss that answers questions for its health like this."""
    with open_session(ZenohSettings(mode="client", connect=[endpoint]), timeout_s=10.0) as session:
        session.declare_queryable(KEY, answer)
        yield


def replies(data: bytes) -> Callable[[zenoh.Query], None]:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(KEY, data, encoding=encoding_of(Health))

    return answer


def reports(message: Health) -> Callable[[zenoh.Query], None]:
    return replies(encode(message, source="gnss"))


def ask(endpoint: str, *more: str) -> int:
    return tool.main(["gnss", "--vehicle", "v7", "--connect", endpoint, *more])


@pytest.mark.parametrize(("status", "code"), [("ok", 0), ("starting", 0), ("degraded", 0), ("failing", 1)])
def test_only_a_failing_service_is_unhealthy(
    endpoint: str, status: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with answering(endpoint, reports(a_health(status))):
        assert ask(endpoint) == code
    assert capsys.readouterr().out.startswith(f"gnss: {status}, version 0.1.0, up 12 s")


def test_json_is_the_whole_answer(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with answering(endpoint, reports(a_health("degraded"))):
        assert ask(endpoint, "--json") == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["service"], output["status"], output["counters"]) == ("gnss", "degraded", {"fix.stale": 4})


def test_a_service_of_another_vehicle_does_not_answer_for_this_one(endpoint: str) -> None:
    with answering(endpoint, reports(a_health())):
        assert tool.main(["gnss", "--vehicle", "v8", "--connect", endpoint]) == 1


def test_without_an_answer_a_service_is_unhealthy(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    held: list[zenoh.Query] = []
    assert ask(endpoint) == 1
    with answering(endpoint, held.append):
        assert ask(endpoint, "--timeout", "0.3") == 1
        held.clear()
    with answering(endpoint, replies(b"\x00 not a message")):
        assert ask(endpoint) == 1
    reasons = [line.split("no answer: ")[1] for line in capsys.readouterr().out.splitlines()]
    assert reasons[0].startswith("absent: gnss of v7")
    assert [reason.split(":")[0] for reason in reasons] == ["absent", "timeout", "invalid"]


def test_a_refused_question_is_unhealthy(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply_err(b"busy")

    with answering(endpoint, answer):
        assert ask(endpoint, "--json") == 1
    output = json.loads(capsys.readouterr().out)
    assert output == {"service": "gnss", "status": "no_answer", "reason": "refused: busy"}


def test_without_a_router_everything_is_unhealthy(capsys: pytest.CaptureFixture[str]) -> None:
    nobody = f"tcp/127.0.0.1:{free_port()}"
    assert ask(nobody, "--timeout", "0.3") == 1
    assert tool.main(["router", "--connect", nobody, "--timeout", "0.3"]) == 1
    assert "cannot join the bus" in capsys.readouterr().out


def test_a_router_that_accepts_a_session_is_healthy(endpoint: str, capsys: Any) -> None:
    assert tool.main(["router", "--connect", endpoint]) == 0
    assert capsys.readouterr().out == f"router: ok, reached over {endpoint}\n"


def test_vehicle_and_endpoint_come_from_the_settings_of_the_service(
    endpoint: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "gnss.toml"
    file.write_text(
        f'vehicle = "nobody"\nsource = "bus"\ndatum = "WGS84"\n[zenoh]\nmode = "client"\nconnect = ["{endpoint}"]\n'
    )
    with answering(endpoint, reports(a_health())):
        assert tool.main(["gnss", "--config", str(file)]) == 1
        monkeypatch.setenv("CAMBER_GNSS_VEHICLE", "v7")
        assert tool.main(["gnss", "--config", str(file)]) == 0


def test_the_line_has_the_most_frequent_issue_first() -> None:
    issues = tuple(Issue(code=code, text="t", count=count) for code, count in (("b", 2), ("c", 30), ("a", 2)))
    assert tool.line(a_health(issues=issues)) == "gnss: ok, version 0.1.0, up 12 s; c ×30, a ×2, b ×2"


@pytest.mark.parametrize(
    "argv",
    [["nosuch"], [], ["gnss", "--config", "/no"], ["gnss", "--vehicle", "a b"]],
)
def test_wrong_usage_is_one_line_and_code_2(argv: list[str], refused: Refused) -> None:
    assert refused(tool.main, *argv).startswith("camber health: ")
