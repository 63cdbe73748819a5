"""Decisions on changes of the map: read from a request of the page, signed with the operator's key, sent to map_update.

Only `camber live --fleet --review KEYFILE` has them. The page gets a token with its greeting, over the WebSocket that
the guard has admitted, and sends it in a header, which a page of another origin can neither know nor set.
"""

from __future__ import annotations

import json
import math
import secrets
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import ValidationError

from camber.live.access import is_same_text, origin_of
from camber.road_map.operator_keys import sign_decision
from camber.runtime.bus import QueryFailed
from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.runtime.settings import ServiceSettings
from camber.schemas.fleet import MapDecision, MapDecisionReceipt, MapVotes, MapVotesRequest
from camber.schemas.refused_field import first_refused

HEADER = "x-camber-review"
MOST_BYTES = 4096
"""Of a request. Chosen: four times the longest reason in UTF-8."""
_TIMEOUT_S = 5.0  # as the table of channels
_TOKEN_BYTES = 24  # chosen: 192 bits, beyond guessing
_SECONDS_OF_DAY = 86_400  # source: a day of UTC but for leap seconds
_DECIMALS = 4  # of offsets [m]: tenths of a millimetre, as tiles have them


class Answer(NamedTuple):
    """Status code of HTTP, and what the page is sent as JSON."""

    code: int
    content: dict[str, Any]


class MapReview:
    """Asks map_update for votes, and sends it decisions where there is a key."""

    def __init__(self, settings: ServiceSettings, key: Ed25519PrivateKey | None) -> None:
        self._settings, self._key = settings, key
        self._lock = threading.Lock()  # one question at a time
        self.token = None if key is None else secrets.token_urlsafe(_TOKEN_BYTES)
        """What a request must carry; None: nobody can decide here."""

    def refusal(self, *, host: str, origin: str | None, token: str) -> str | None:
        """Why a request to decide is refused before it is read; None: it is not."""
        if self.token is None:
            return "this page only shows: camber live was started without --review"
        if origin is None or origin_of(origin) != host:
            return "the request is not of this page"
        return (
            None if is_same_text(token, self.token) else "the token is not that of this page: load it again"
        )

    def decide(self, body: bytes) -> Answer:
        """Sign and send a decision, given as JSON."""
        try:
            decision = _decision_of(body)
        except ValidationError as error:
            return Answer(400, {"reason": str(first_refused(error))})
        except (ValueError, TypeError, OverflowError, RecursionError):
            return Answer(400, {"reason": "not a decision in JSON"})
        assert self._key is not None
        replies = self._ask("map_decision", sign_decision(decision, self._key))
        receipts = [reply for reply in replies if isinstance(reply, MapDecisionReceipt)]
        if any(receipt.status == "recorded" for receipt in receipts):
            return Answer(200, {"status": "recorded"})
        meant = [receipt for receipt in receipts if receipt.status != "elsewhere"]
        reasons = [receipt.reason for receipt in meant or receipts] or [str(reply) for reply in replies]
        return Answer(409 if receipts else 503, {"reason": "; ".join(reasons)})

    def votes(self, surface_id: int) -> Answer:
        """The votes on a surface by day."""
        request = MapVotesRequest(time_ns=SystemClock().now_ns(), surface_id=surface_id)
        replies = self._ask("map_votes", request)
        known = [reply for reply in replies if isinstance(reply, MapVotes) and reply.status == "known"]
        if not known:
            reasons = [reply.reason if isinstance(reply, MapVotes) else str(reply) for reply in replies]
            # A browser reports any other code as a failure of the page.
            return Answer(200, {"days": [], "reason": "; ".join(reasons)})
        left_out = sum(reply.left_out for reply in known)
        return Answer(
            200, {"days": [row for reply in known for row in _days_of(reply)], "left_out": left_out}
        )

    def _ask(self, channel: str, request: MapDecision | MapVotesRequest) -> Sequence[Any]:
        with self._lock:
            try:
                with QueryClient(self._settings, timeout_s=_TIMEOUT_S, source="live") as client:
                    (replies,) = client.ask(channel, request, "fleet", ["map_update"]).values()
            except BusError as error:
                return [QueryFailed("absent", str(error))]
        return replies


def _decision_of(body: bytes) -> MapDecision:
    """Ids come as texts, because JSON has 53 bits. Raises ValidationError, ValueError or TypeError."""
    values = json.loads(body)
    if not isinstance(values, dict) or values.keys() & {"time_ns", "key_id", "signature"}:
        raise TypeError("expected an object with what is decided, who and why")
    for name in ("surface_id", "map_version"):
        if isinstance(values.get(name), str):
            values[name] = int(values[name])
    if isinstance(values.get("offset_m"), int):
        values["offset_m"] = float(values["offset_m"])
    return MapDecision(time_ns=SystemClock().now_ns(), **values)


def _days_of(votes: MapVotes) -> list[dict[str, Any]]:
    columns = {name: getattr(votes, name).tolist() for name in ("vehicles", "offset_m", "low_m", "high_m")}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return [
        {name: round(value, _DECIMALS) if math.isfinite(value) else None for name, value in row.items()}
        | {"t": day * _SECONDS_OF_DAY}
        for day, row in zip(votes.day.tolist(), rows, strict=True)
    ]
