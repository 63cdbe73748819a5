"""One question to one service, from outside: for tools that come and go."""

from __future__ import annotations

from typing import Any

import zenoh

from camber.runtime.bus import QueryFailed
from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import DecodeError, decode, encode, encoding_of


def ask_once(
    settings: ServiceSettings,
    name: str,
    request: Message,
    *,
    service: str,
    timeout_s: float,
    source: str = "tools",
) -> Any:
    """Join the bus, ask `service` over the query channel `name`, leave; returns the reply.

    Raises BusError where the bus cannot be joined, QueryFailed where there is no usable answer, each within about
    `timeout_s`.
    """
    channel = BY_NAME[name]
    assert channel.reply is not None
    key = channel.key_for(settings.vehicle).replace("{service}", service)
    with open_session(settings.zenoh.model_copy(update={"mode": "client"}), timeout_s=timeout_s) as session:
        replies = session.get(
            key,
            payload=encode(request, source=source),
            encoding=encoding_of(channel.message),
            timeout=timeout_s,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
        )
        refusal: str | None = None
        for reply in replies:
            if reply.ok is not None:
                try:
                    return decode(channel.reply, reply.ok.payload.to_bytes(), str(reply.ok.encoding)).message
                except DecodeError as error:
                    raise QueryFailed("invalid", str(error)) from None
            if reply.err is not None:
                refusal = reply.err.payload.to_bytes()[:200].decode("utf-8", "replace")
    if refusal is None:
        raise QueryFailed("absent", f"{service} of {settings.vehicle} is not on the bus")
    # Zenoh ends the wait of an unanswered question with an error reply that says so.
    raise QueryFailed("timeout" if "timeout" in refusal.lower() else "refused", refusal)


def reach_router(settings: ServiceSettings, *, timeout_s: float) -> None:
    """Join the bus and leave it; raises BusError within about `timeout_s`."""
    with open_session(settings.zenoh.model_copy(update={"mode": "client"}), timeout_s=timeout_s):
        pass


__all__ = ["BusError", "QueryFailed", "ask_once", "reach_router"]
