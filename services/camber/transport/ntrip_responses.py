"""Responses of NTRIP casters, revision 1 and 2: a stream with its transfer encoding, or a reason for refusal.

A caster is untrusted: every part has a limit, and of its texts only printable characters are repeated.
RTCM 10410.0 (revision 1) and 10410.1 (revision 2); chunks: RFC 9112, section 7.1.
"""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Protocol
from urllib.parse import urlsplit

from camber.transport.tcp_connection import RefusedError

# Chosen: limits of what an untrusted caster may send, far above what casters do send.
HEAD_LIMIT_BYTES = 16_384
_LINE_LIMIT_BYTES = 1024
_CHUNK_LINE_LIMIT_BYTES = 256
_CHUNK_LIMIT_BYTES = 16 << 20
_UNKNOWN = "the mountpoint is unknown to the caster"
_PRINTABLE = re.compile(rb"[\x20-\x7e\r]")


class Body(Protocol):
    """Decodes the bytes after the head of a response, in chunks of any size, to the bytes of the stream."""

    def feed(self, data: bytes) -> bytes:
        """Return the bytes of the stream in `data`; ConnectionError where it is malformed or ends."""


class _PlainBody:
    """A stream without transfer encoding."""

    def feed(self, data: bytes) -> bytes:
        return data


class IcyBody:
    """After `ICY 200 OK`: the stream at once, or after an empty line, or after header lines and an empty line.

    Revision 1 does not specify it, and a caster may wait for a position before it sends anything at all.
    """

    _LINE = re.compile(rb"[A-Za-z][A-Za-z0-9-]{0,40}:[^\r\n]{0,512}\r?\n")
    _PARTIAL = re.compile(rb"[A-Za-z][A-Za-z0-9-]{0,40}(:[^\r\n]{0,512}\r?)?|\r")

    def __init__(self) -> None:
        self._head: bytes | None = b""

    def feed(self, data: bytes) -> bytes:
        """Return the bytes after the header."""
        if self._head is None:
            return data
        head = self._head + data
        while line := self._LINE.match(head):
            head = head[line.end() :]
        if not head or self._PARTIAL.fullmatch(head):
            self._head = head
            return b""
        self._head = None
        return head.removeprefix(b"\r\n").removeprefix(b"\n") if head[0] in b"\r\n" else head


class _ChunkedBody:
    """Chunks: a hexadecimal length on a line, that many bytes, a line end. Bytes are returned as they arrive."""

    def __init__(self) -> None:
        self._line = b""
        self._left = 0
        self._after_data = False

    def feed(self, data: bytes) -> bytes:
        decoded = bytearray()
        while data:
            if self._left:
                decoded += data[: self._left]
                size = min(self._left, len(data))
                self._left -= size
                self._after_data = self._left == 0
                data = data[size:]
                continue
            line, end, data = data.partition(b"\n")
            self._line += line
            if len(self._line) > _CHUNK_LINE_LIMIT_BYTES:
                raise ConnectionError("the length of a chunk does not end")
            if end:
                self._end_line(self._line.rstrip(b"\r"))
                self._line = b""
            elif self._after_data and self._line not in (b"", b"\r"):
                raise ConnectionError("a chunk is longer than its length")
        return bytes(decoded)

    def _end_line(self, line: bytes) -> None:
        if self._after_data:
            if line:
                raise ConnectionError("a chunk is longer than its length")
            self._after_data = False
            return
        length = line.partition(b";")[0].strip()
        if not re.fullmatch(rb"[0-9A-Fa-f]{1,16}", length):
            raise ConnectionError(f"expected the length of a chunk, not {_printable(line)!r}")
        self._left = int(length, 16)
        if self._left == 0:
            raise ConnectionResetError("the caster ended the stream")
        if self._left > _CHUNK_LIMIT_BYTES:
            raise ConnectionError(f"a chunk of {self._left} bytes; at most {_CHUNK_LIMIT_BYTES} are believed")


def parse_response(received: bytes, *, with_password: bool) -> tuple[Body, bytes] | None:
    """Return the body of the stream and its first bytes, or None where the head of the response is incomplete.

    `received` is everything received so far. The text of RefusedError is why there is no stream.
    """
    if received.startswith(b"\x15\x03"):
        raise RefusedError("the other side speaks TLS; use ntrips://")
    first, end, rest = received.partition(b"\n")
    if not end:
        if len(first) > _LINE_LIMIT_BYTES or not _PRINTABLE.fullmatch(first[:1] or b" "):
            raise RefusedError(_not_a_caster(first))
        return None
    match first.split(None, 2):
        case [b"ICY", code, *_]:
            _expect_ok(code, {}, with_password)
            return IcyBody(), rest
        case [b"SOURCETABLE", *_]:
            raise RefusedError(f"{_UNKNOWN}: it sends the table of its mountpoints")
        case [b"ERROR", *_]:
            raise RefusedError(_error_of_revision_1(first))
        case [protocol, code, *_] if re.fullmatch(rb"HTTP/1\.[01]", protocol):
            return _parse_http(code, rest, with_password)
    raise RefusedError(_not_a_caster(first))


def _parse_http(code: bytes, rest: bytes, with_password: bool) -> tuple[Body, bytes] | None:
    end = re.search(rb"(\A|\n)\r?\n", rest)
    fields = _header_fields(rest[: end.start()] if end else rest)
    # Some close without an empty line; the header of a redirection is needed for its target.
    if end or not code.startswith(b"3"):
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
        raise RefusedError(f"{_printable(kind.encode())} instead of a stream")
    encoding = fields.get("transfer-encoding", "identity").strip().lower()
    if encoding not in ("identity", "chunked") or fields.get("content-encoding", "identity") != "identity":
        raise RefusedError(
            "the stream is encoded in a way that is not understood; expected chunked or identity"
        )
    return (_ChunkedBody() if encoding == "chunked" else _PlainBody()), rest[end.end() :]


def _header_fields(head: bytes) -> dict[str, str]:
    fields = {}
    for line in head.decode("latin-1").split("\n"):
        name, colon, value = line.partition(":")
        if colon:
            fields[name.strip().lower()] = value.strip()
    return fields


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
        raise RefusedError(f"the caster sends us on to {_redirect_target(fields)} ({status}); not followed")
    phrases = {each.value: each.phrase for each in HTTPStatus}
    raise RefusedError(f"the caster answers {status} {phrases.get(status, '')}".rstrip())


def _redirect_target(fields: dict[str, str]) -> str:
    """Return host and port only: the rest may contain names and passwords."""
    try:
        parts = urlsplit(fields.get("location", ""))
        host, port = parts.hostname, parts.port
    except ValueError:
        return "an unreadable address"
    if not host:
        return "another place"
    return _printable((f"{host}:{port}" if port else host).encode())


def _error_of_revision_1(line: bytes) -> str:
    text = line.lower()
    if b"password" in text:
        return "the caster does not accept user and password"
    return _UNKNOWN if b"mount" in text else "the caster answers with an error"


def _not_a_caster(line: bytes) -> str:
    return f"expected an answer of a caster, got {_printable(line)!r}"


def _printable(data: bytes) -> str:
    """Return at most 40 printable characters."""
    return re.sub(rb"[^\x20-\x7e]", b"?", data.rstrip(b"\r")[:40]).decode("ascii")
