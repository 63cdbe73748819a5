"""Client of an NTRIP caster, revision 1 and 2, which sends the vehicle's position (GGA) to the caster.

A small implementation: `pygnssutils.GNSSNTRIPClient` depends on ten packages, decodes every message before it passes it
on, never retries after a refusal, and reports the reasons only in a log.
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

from camber.transport.ntrip_responses import Body, IcyBody, parse_response
from camber.transport.tcp_connection import TcpConnection, tls_context

MIN_POSITION_INTERVAL_S = 1.0  # chosen: once per epoch of a receiver at 1 Hz
RESPONSE_TIMEOUT_S = 10.0  # chosen: generous for a caster under load
_ADDRESS = re.compile(r"ntrip(s?)://(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+)):([0-9]{1,5})/([!-~]+)")
_GGA = re.compile(r"\$[A-Z]{2}GGA,[ -)+-~]{1,100}\*[0-9A-Fa-f]{2}")


@dataclass(frozen=True, kw_only=True)
class NtripAccess:
    """Credentials and options of requests to a caster.

    `version` is the revision of the request; responses of both are understood. `position` returns the latest GGA
    sentence, or None; it is called from the stream's thread. `ca_file` contains the only trusted authorities. The text
    of ValueError contains what was expected.
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
        if not MIN_POSITION_INTERVAL_S <= self.position_interval_s < math.inf:
            expected = f"expected {MIN_POSITION_INTERVAL_S:g} s or more"
            raise ValueError(f"a position every {self.position_interval_s} s: {expected}")


@dataclass(frozen=True, kw_only=True)
class Mountpoint:
    """Address of a caster's stream."""

    host: str
    port: int
    name: str
    tls: bool

    @classmethod
    def parse(cls, url: str) -> Mountpoint | None:
        """Parse `ntrip://HOST:PORT/MOUNT` or `ntrips://…`; None for anything else."""
        match = _ADDRESS.fullmatch(url)
        if match is None or not 0 < int(match[4]) < 65536:
            return None
        return cls(host=match[2] or match[3], port=int(match[4]), name=match[5], tls=bool(match[1]))


class GgaSchedule:
    """Limits the rate of GGA sentences to a caster, across all connections to it."""

    def __init__(self, access: NtripAccess) -> None:
        self._position = access.position
        self._interval_s = access.position_interval_s
        self._last_s = -math.inf

    def take_due(self, now_s: float) -> str | None:
        """Return a sentence to be sent now, without line end; None for anything but a GGA sentence."""
        if self._position is None or now_s - self._last_s < self._interval_s:
            return None
        sentence = (self._position() or "").strip()
        if not _GGA.fullmatch(sentence):
            return None
        self._last_s = now_s
        return sentence

    def retry_soon(self) -> None:
        """Schedule the next sentence soon: the last one was in a request of which the caster ignored it."""
        self._last_s -= self._interval_s - MIN_POSITION_INTERVAL_S

    @property
    def silence_reason(self) -> str:
        """Reason for silence: a caster cannot compute a virtual base station without a position."""
        waiting = self._position is not None and self._last_s == -math.inf
        return "; no position has been sent to the caster yet" if waiting else ""


class NtripSource:
    """The stream of a mount point; the text of OSError is why there is none."""

    lossless = False

    def __init__(
        self, mountpoint: Mountpoint, access: NtripAccess, schedule: GgaSchedule, stop: threading.Event
    ) -> None:
        self._schedule = schedule
        self._unsent = b""
        context = tls_context(access.ca_file) if mountpoint.tls else None
        self._connection = TcpConnection(mountpoint.host, mountpoint.port, stop=stop, tls=context)
        try:
            sentence = schedule.take_due(time.monotonic()) if access.version == 2 else None
            self._body, self._first = self._request(request(mountpoint, access, sentence), access)
            if sentence and isinstance(self._body, IcyBody):
                schedule.retry_soon()
        except BaseException:
            self._connection.close()
            raise

    @property
    def silence_reason(self) -> str:
        """A known reason for silence."""
        return self._schedule.silence_reason

    def read(self) -> bytes:
        """Return bytes of the stream; send the position where it is due."""
        if self._first:
            first, self._first = self._first, b""
            return self._body.feed(first)
        self._send_position()
        return self._body.feed(self._connection.read())

    def send(self, data: bytes) -> int:
        """A caster takes nothing but positions."""
        return 0

    def close(self) -> None:
        """Close it."""
        self._connection.close()

    def _send_position(self) -> None:
        """Send a due sentence; at most one is kept for a caster that does not read."""
        if not self._unsent:
            sentence = self._schedule.take_due(time.monotonic())
            self._unsent = f"{sentence}\r\n".encode("ascii") if sentence else b""
        if self._unsent:
            self._unsent = self._unsent[self._connection.send(self._unsent) :]

    def _request(self, unsent: bytes, access: NtripAccess) -> tuple[Body, bytes]:
        deadline_s = time.monotonic() + RESPONSE_TIMEOUT_S
        received = b""
        while time.monotonic() < deadline_s:
            unsent = unsent[self._connection.send(unsent) :] if unsent else b""
            received += self._connection.read()
            response = parse_response(received, with_password=access.user is not None)
            if response is not None:
                return response
        raise TimeoutError(f"the caster has not answered in {RESPONSE_TIMEOUT_S:g} s")


def request(mountpoint: Mountpoint, access: NtripAccess, sentence: str | None) -> bytes:
    """Return the request to a caster; only revision 2 can contain the position, `sentence`."""
    revision_2 = access.version == 2
    lines = [f"GET /{mountpoint.name} HTTP/1.{1 if revision_2 else 0}"]
    if revision_2:
        host = f"[{mountpoint.host}]" if ":" in mountpoint.host else mountpoint.host
        lines += [f"Host: {host}:{mountpoint.port}", "Ntrip-Version: Ntrip/2.0"]
        lines += [f"Ntrip-GGA: {sentence}"] if sentence else []
    lines += ["User-Agent: NTRIP camber", "Accept: */*", "Connection: close"]
    if access.user is not None:
        pair = f"{access.user}:{access.password or ''}".encode()
        lines.append(f"Authorization: Basic {b64encode(pair).decode('ascii')}")
    return "\r\n".join([*lines, "", ""]).encode("ascii")
