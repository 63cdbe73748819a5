"""A client of an NTRIP caster, revision 1 and 2, which tells the caster where we are.

Our own, and small: `pygnssutils.GNSSNTRIPClient` brings ten packages, decodes every message before it passes it on,
gives up for good after a refusal, and tells the reasons to a log only.
"""

from __future__ import annotations

import math
import re
import threading
import time
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from camber.transport.ntrip_responses import Body, IcyBody, read_answer
from camber.transport.tcp_connection import Connection, tls_context

SHORTEST_POSITION_INTERVAL_S = 1.0
_ANSWER_S = 10.0
_ADDRESS = re.compile(r"ntrip(s?)://(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+)):([0-9]{1,5})/([!-~]+)")
_GGA = re.compile(r"\$[A-Z]{2}GGA,[ -)+-~]{1,100}\*[0-9A-Fa-f]{2}")


@dataclass(frozen=True, kw_only=True)
class NtripAccess:
    """How we present ourselves to a caster.

    `version` is the revision in which we ask; an answer of either is understood. `position` gives the newest GGA
    sentence, or None where there is none; it is called from the stream's thread. `ca_file` holds the only authorities
    that are then trusted. ValueError says what was expected.
    """

    user: str | None = None
    password: str | None = field(default=None, repr=False)
    version: int = 2
    ca_file: Path | None = None
    position: Callable[[], str | None] | None = field(default=None, repr=False)
    position_interval_s: float = 10.0

    def __post_init__(self) -> None:
        if self.user is not None and ":" in self.user:
            raise ValueError("the user's name of a caster has no colon")
        if self.user is None and self.password is not None:
            raise ValueError("a password of a caster needs a user")
        if self.version not in (1, 2):
            raise ValueError(f"revision {self.version} of NTRIP: expected 1 or 2")
        if not SHORTEST_POSITION_INTERVAL_S <= self.position_interval_s < math.inf:
            raise ValueError(
                f"a position every {self.position_interval_s} s: expected {SHORTEST_POSITION_INTERVAL_S:g} s or more"
            )


@dataclass(frozen=True, kw_only=True)
class Mountpoint:
    """Where a stream is."""

    host: str
    port: int
    name: str
    tls: bool

    @classmethod
    def of(cls, url: str) -> Mountpoint | None:
        """Of `ntrip://HOST:PORT/MOUNT` or `ntrips://…`; None where it is none of them."""
        found = _ADDRESS.fullmatch(url)
        if found is None or not 0 < int(found[4]) < 65536:
            return None
        return cls(host=found[2] or found[3], port=int(found[4]), name=found[5], tls=bool(found[1]))


class GgaSchedule:
    """Says when the caster may be told our position, across all connections to it."""

    def __init__(self, access: NtripAccess) -> None:
        self._position = access.position
        self._interval_s = access.position_interval_s
        self._last_s = -math.inf

    def due(self, now_s: float) -> str | None:
        """A sentence to be sent now, without its end of line; what is no GGA sentence is never sent."""
        if self._position is None or now_s - self._last_s < self._interval_s:
            return None
        sentence = (self._position() or "").strip()
        if not _GGA.fullmatch(sentence):
            return None
        self._last_s = now_s
        return sentence

    def not_heard(self) -> None:
        """The sentence before was in a request, and the caster has not read it there: the next comes soon."""
        self._last_s -= self._interval_s - SHORTEST_POSITION_INTERVAL_S

    @property
    def silent_because(self) -> str:
        """A caster that makes a stream for where we are has to know it."""
        waiting = self._position is not None and self._last_s == -math.inf
        return "; the caster has not been told a position yet" if waiting else ""


class Ntrip:
    """The stream of a mountpoint; OSError says why there is none."""

    waits = False

    def __init__(self, at: Mountpoint, access: NtripAccess, pace: GgaSchedule, stop: threading.Event) -> None:
        self._pace = pace
        self._unsent = b""
        context = tls_context(access.ca_file) if at.tls else None
        self._connection = Connection(at.host, at.port, stop=stop, tls=context)
        try:
            sentence = pace.due(time.monotonic()) if access.version == 2 else None
            self._body, self._first = self._ask(request(at, access, sentence), access)
            if sentence and isinstance(self._body, IcyBody):
                pace.not_heard()
        except BaseException:
            self._connection.close()
            raise

    @property
    def silent_because(self) -> str:
        """What is known of why nothing comes."""
        return self._pace.silent_because

    def read(self) -> bytes:
        """Bytes of the stream; tells the caster our position where that is due."""
        if self._first:
            first, self._first = self._first, b""
            return self._body.feed(first)
        self._tell_position()
        return self._body.feed(self._connection.receive())

    def close(self) -> None:
        """Close it."""
        self._connection.close()

    def _tell_position(self) -> None:
        """One sentence waits at most, where a caster does not take what we send."""
        if not self._unsent:
            sentence = self._pace.due(time.monotonic())
            self._unsent = f"{sentence}\r\n".encode("ascii") if sentence else b""
        if self._unsent:
            self._unsent = self._unsent[self._connection.send(self._unsent) :]

    def _ask(self, asking: bytes, access: NtripAccess) -> tuple[Body, bytes]:
        deadline = time.monotonic() + _ANSWER_S
        received = b""
        while time.monotonic() < deadline:
            asking = asking[self._connection.send(asking) :] if asking else b""
            received += self._connection.receive()
            answer = read_answer(received, with_password=access.user is not None)
            if answer is not None:
                return answer
        raise TimeoutError(f"the caster has not answered in {_ANSWER_S:g} s")


def request(at: Mountpoint, access: NtripAccess, sentence: str | None) -> bytes:
    """What we ask a caster with; `sentence` is our position, which only revision 2 takes in a request."""
    revision_2 = access.version == 2
    lines = [f"GET /{at.name} HTTP/1.{1 if revision_2 else 0}"]
    if revision_2:
        host = f"[{at.host}]" if ":" in at.host else at.host
        lines += [f"Host: {host}:{at.port}", "Ntrip-Version: Ntrip/2.0"]
        lines += [f"Ntrip-GGA: {sentence}"] if sentence else []
    lines += ["User-Agent: NTRIP camber", "Accept: */*", "Connection: close"]
    if access.user is not None:
        pair = f"{access.user}:{access.password or ''}".encode()
        lines.append(f"Authorization: Basic {b64encode(pair).decode('ascii')}")
    return "\r\n".join([*lines, "", ""]).encode("ascii")
