"""What an NTRIP caster answers, of revision 1 and 2: a stream, and in what pieces it comes, or a reason why none.

Nothing that a caster sends is trusted: every part has a limit, and of its own words only what is harmless is repeated.
RTCM 10410.0 (revision 1) and 10410.1 (revision 2); chunks: RFC 9112, section 7.1.
"""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Protocol
from urllib.parse import urlsplit

from camber.transport.tcp_connection import RefusedError

HEAD_LIMIT_BYTES = 16_384
_LINE_LIMIT_BYTES = 1024
_CHUNK_LINE_LIMIT_BYTES = 256
_CHUNK_LIMIT_BYTES = 16 << 20
_UNKNOWN = "the mountpoint is unknown to the caster"


class Body(Protocol):
    """Takes what comes after the head of an answer, in pieces of any size, and gives the bytes of the stream."""

    def feed(self, data: bytes) -> bytes:
        """The bytes of the stream in `data`; ConnectionError where it breaks or ends."""


class PlainBody:
    """As it comes."""

    def feed(self, data: bytes) -> bytes:
        """The same bytes."""
        return data


class IcyBody:
    """After `ICY 200 OK`: the stream at once, or first an empty line, or lines of a header and an empty line.

    Revision 1 leaves this open, and a caster may wait for a position before it sends anything at all.
    """

    _LINE = re.compile(rb"[A-Za-z][A-Za-z0-9-]{0,40}:[^\r\n]{0,512}\r?\n")
    _BEGUN = re.compile(rb"[A-Za-z][A-Za-z0-9-]{0,40}(:[^\r\n]{0,512}\r?)?|\r")

    def __init__(self) -> None:
        self._head: bytes | None = b""

    def feed(self, data: bytes) -> bytes:
        """What is not header."""
        if self._head is None:
            return data
        head = self._head + data
        while line := self._LINE.match(head):
            head = head[line.end() :]
        if not head or self._BEGUN.fullmatch(head):
            self._head = head
            return b""
        self._head = None
        return head.removeprefix(b"\r\n").removeprefix(b"\n") if head[0] in b"\r\n" else head


class ChunkedBody:
    """Chunks: a hexadecimal length on a line, so many bytes, an end of line. A chunk's bytes are given as they come."""

    def __init__(self) -> None:
        self._line = b""
        self._left = 0
        self._after_data = False

    def feed(self, data: bytes) -> bytes:
        """The bytes of the stream; ConnectionError where lengths are none, lie, or say that this is the end."""
        found = bytearray()
        while data:
            if self._left:
                found += data[: self._left]
                taken = min(self._left, len(data))
                self._left -= taken
                self._after_data = self._left == 0
                data = data[taken:]
                continue
            line, end, data = data.partition(b"\n")
            self._line += line
            if len(self._line) > _CHUNK_LINE_LIMIT_BYTES:
                raise ConnectionError("the length of a chunk does not end")
            if end:
                self._line_read(self._line.rstrip(b"\r"))
                self._line = b""
            elif self._after_data and self._line not in (b"", b"\r"):
                raise ConnectionError("a chunk is longer than its length")
        return bytes(found)

    def _line_read(self, line: bytes) -> None:
        if self._after_data:
            if line:
                raise ConnectionError("a chunk is longer than its length")
            self._after_data = False
            return
        length = line.partition(b";")[0].strip()
        if not re.fullmatch(rb"[0-9A-Fa-f]{1,16}", length):
            raise ConnectionError(f"expected the length of a chunk, not {_harmless(line)!r}")
        self._left = int(length, 16)
        if self._left == 0:
            raise ConnectionResetError("the caster ended the stream")
        if self._left > _CHUNK_LIMIT_BYTES:
            raise ConnectionError(f"a chunk of {self._left} bytes; at most {_CHUNK_LIMIT_BYTES} are believed")


def read_answer(received: bytes, *, with_password: bool) -> tuple[Body, bytes] | None:
    """The body of the stream and the first bytes for it, or None where the head of the answer is not complete.

    `received` is everything that has come. RefusedError says why there is no stream.
    """
    if received.startswith(b"\x15\x03"):
        raise RefusedError("the other side speaks TLS; use ntrips://")
    first, end, rest = received.partition(b"\n")
    if not end:
        if len(first) > _LINE_LIMIT_BYTES or not _HARMLESS.fullmatch(first[:1] or b" "):
            raise RefusedError(_no_caster(first))
        return None
    words = first.split(None, 2)
    match words:
        case [b"ICY", code, *_]:
            _expect_ok(code, {}, with_password)
            return IcyBody(), rest
        case [b"SOURCETABLE", *_]:
            raise RefusedError(f"{_UNKNOWN}: it sends the table of its mountpoints")
        case [b"ERROR", *_]:
            raise RefusedError(_error_of_revision_1(first))
        case [protocol, code, *_] if re.fullmatch(rb"HTTP/1\.[01]", protocol):
            return _read_http(code, rest, with_password)
    raise RefusedError(_no_caster(first))


def _read_http(code: bytes, rest: bytes, with_password: bool) -> tuple[Body, bytes] | None:
    end = re.search(rb"(\A|\n)\r?\n", rest)
    fields = _fields(rest[: end.start()] if end else rest)
    if end or not code.startswith(
        b"3"
    ):  # some close without an empty line; a redirection says where in its header
        _expect_ok(code, fields, with_password)
    if end is None:
        if len(rest) > HEAD_LIMIT_BYTES:
            raise RefusedError(f"the header of the answer does not end within {HEAD_LIMIT_BYTES} bytes")
        return None
    kind = fields.get("content-type", "").partition(";")[0].strip().lower()
    if kind == "gnss/sourcetable":
        raise RefusedError(f"{_UNKNOWN}: it sends the table of its mountpoints")
    if kind in ("text/html", "application/xhtml+xml"):
        raise RefusedError(
            "a web page instead of a stream: is this a caster, or is there a page to log in before it?"
        )
    if kind.startswith("text/") or kind in ("application/json", "application/xml"):
        raise RefusedError(f"{_harmless(kind.encode())} instead of a stream")
    encoding = fields.get("transfer-encoding", "identity").strip().lower()
    if encoding not in ("identity", "chunked") or fields.get("content-encoding", "identity") != "identity":
        raise RefusedError(
            "the stream is encoded in a way that is not understood; expected chunked or identity"
        )
    return (ChunkedBody() if encoding == "chunked" else PlainBody()), rest[end.end() :]


def _fields(head: bytes) -> dict[str, str]:
    found = {}
    for line in head.split(b"\n"):
        name, colon, value = line.partition(b":")
        if colon:
            found[name.strip().decode("latin-1").lower()] = value.strip().decode("latin-1")
    return found


def _expect_ok(code: bytes, fields: dict[str, str], with_password: bool) -> None:
    if not re.fullmatch(rb"[1-5][0-9]{2}", code):
        raise RefusedError("the answer has no status")
    status = int(code)
    if status == 200:
        return
    if status == 401 and not with_password:
        raise RefusedError("the caster asks for user and password (401), and none are set")
    if status in (401, 403):
        raise RefusedError(f"the caster does not accept user and password ({status})")
    if status == 404:
        raise RefusedError(f"{_UNKNOWN} (404)")
    if status // 100 == 3:
        raise RefusedError(f"the caster sends us on to {_target(fields)} ({status}); not followed")
    known = {each.value: each.phrase for each in HTTPStatus}
    raise RefusedError(f"the caster answers {status} {known.get(status, '')}".rstrip())


def _target(fields: dict[str, str]) -> str:
    """Host and port only: the rest may hold names and passwords."""
    try:
        parts = urlsplit(fields.get("location", ""))
        host, port = parts.hostname, parts.port
    except ValueError:
        return "an unreadable address"
    if not host:
        return "another place"
    return _harmless(f"{host}:{port}" if port else host)


def _error_of_revision_1(line: bytes) -> str:
    text = line.lower()
    if b"password" in text:
        return "the caster does not accept user and password"
    return _UNKNOWN if b"mount" in text else "the caster answers with an error"


def _no_caster(line: bytes) -> str:
    return f"expected an answer of a caster, got {_harmless(line)!r}"


_HARMLESS = re.compile(rb"[\x20-\x7e\r]")


def _harmless(text: bytes | str) -> str:
    """At most 40 printable characters."""
    data = text if isinstance(text, bytes) else text.encode()
    return re.sub(rb"[^\x20-\x7e]", b"?", data.rstrip(b"\r")[:40]).decode("ascii")
