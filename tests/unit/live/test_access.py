"""Who may see the page: browsers of this machine under its own names, or who has the token."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from camber.live.access import Guard

TOKEN = "0123456789abcdef"


async def page(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"page"})


def answered(
    token: str | None, *, kind: str = "http", query: str = "", **headers: str
) -> list[dict[str, Any]]:
    sent: list[dict[str, Any]] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        return {"type": "websocket.connect"}

    encoded = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "path": "/", "query_string": query.encode(), "headers": encoded, "scheme": "http"}
    scope |= {"method": "GET", "server": ("127.0.0.1", 8080), "root_path": ""}
    asyncio.run(Guard(page, token=token)(scope, receive, send))
    return sent


def status(*arguments: Any, **more: Any) -> int:
    return int(answered(*arguments, **more)[0]["status"])


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080"])
def test_this_machine_is_answered(host: str) -> None:
    assert status(None, host=host, origin=f"http://{host}") == 200


@pytest.mark.parametrize("host", ["example.org", "192.0.2.7:8080", "localhost.example.org", "[", ""])
def test_another_name_for_this_machine_is_refused(host: str) -> None:
    """A page from elsewhere whose name resolves to this machine must not read what a vehicle does."""
    assert status(None, host=host) == 403


def test_another_origin_is_refused() -> None:
    assert status(None, host="localhost:8080", origin="http://example.org") == 403
    assert answered(None, kind="websocket", host="localhost:8080", origin="http://example.org")[0] == {
        "type": "websocket.close",
        "code": 1008,
    }


def test_with_a_token_nobody_without_it_is_answered() -> None:
    assert status(TOKEN, host="vehicle.example:8080") == 403
    assert status(TOKEN, host="localhost:8080") == 403
    assert status(TOKEN, host="vehicle.example:8080", cookie="camber_live=wrong") == 403
    assert status(TOKEN, host="vehicle.example:8080", query="token=wrong") == 403
    assert status(TOKEN, host="vehicle.example:8080", cookie=f"camber_live={TOKEN}") == 200


def test_a_token_of_the_address_becomes_a_cookie() -> None:
    start = answered(TOKEN, host="vehicle.example:8080", query=f"token={TOKEN}")[0]
    headers = {name.decode(): value.decode() for name, value in start["headers"]}
    assert (start["status"], headers["location"]) == (303, "/")
    assert "httponly" in headers["set-cookie"].lower()
    assert "samesite=strict" in headers["set-cookie"].lower()


def test_every_answer_forbids_what_is_from_elsewhere() -> None:
    for token in (None, TOKEN):
        headers = dict(answered(token, host="localhost")[0]["headers"])
        policy = headers[b"content-security-policy"].decode()
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
