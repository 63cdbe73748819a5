"""Browsers whose connection ends while the server sends to them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import MutableMapping
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send

from camber.live.history import History
from camber.live.web_server import LiveState, application


class NoSource:
    mode, state, problem = "bus", "receiving", ""

    def left_out(self) -> dict[str, int]:
        return {}


def closed_by_keepalive() -> tuple[Scope, Receive, Send]:
    """uvicorn's side of a stalled browser: accepted, then closed, and what was sent before is still in the buffer."""
    arrived: asyncio.Queue[MutableMapping[str, Any]] = asyncio.Queue()
    arrived.put_nowait({"type": "websocket.connect"})

    async def send(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "websocket.send":
            raise RuntimeError("Unexpected ASGI message 'websocket.send', after sending 'websocket.close'.")

    scope: Scope = {
        "type": "websocket",
        "path": "/stream",
        "headers": [(b"host", b"localhost")],
        "query_string": b"",
        "server": ("localhost", 80),
    }
    return scope, arrived.get, send


def test_a_browser_closed_while_its_buffer_is_full_ends_quietly(caplog: pytest.LogCaptureFixture) -> None:
    state = LiveState(title="drive", history=History(()), source=NoSource())  # type: ignore[arg-type]
    with caplog.at_level(logging.INFO):
        asyncio.run(asyncio.wait_for(application(state, token=None)(*closed_by_keepalive()), 5.0))
    assert state.browsers == 0
    assert not caplog.records
