"""Responses of casters of both revisions, in chunks of any size: a stream, or a reason for refusal."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from camber.transport.ntrip_responses import HEAD_LIMIT_BYTES, parse_response
from camber.transport.tcp_connection import RefusedError

STREAM = b"\xd3\x00\x13>\xd0\x00\x03\n\r\nA: b\r\n\r\n0\r\n"
"""Bytes of a stream that contain all characters of the framing."""
OK_2 = b"HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nContent-Type: gnss/data\r\n"


def chunked(data: bytes, size: int) -> bytes:
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    return b"".join(b"%x;name=value\r\n%s\r\n" % (len(part), part) for part in parts)


STREAMS = {
    "revision 1, the stream at once": b"ICY 200 OK\r\n" + STREAM,
    "revision 1, an empty line": b"ICY 200 OK\r\n\r\n" + STREAM,
    "revision 1, a header": b"ICY 200 OK\r\nServer: some caster/1.0\r\nDate: now\r\n\r\n" + STREAM,
    "revision 1, lines ended by LF": b"ICY 200 OK\nServer: x\n\n" + STREAM,
    "revision 2": OK_2 + b"\r\n" + STREAM,
    "revision 2, chunks of 3": OK_2 + b"Transfer-Encoding: chunked\r\n\r\n" + chunked(STREAM, 3),
    "revision 2, one chunk": OK_2 + b"transfer-encoding: Chunked\r\n\r\n" + chunked(STREAM, 999),
    "revision 2, no type": b"HTTP/1.0 200\r\n\r\n" + STREAM,
    "a status line that has lost its end": b"HTTP/1.1 200 OKNtrip-Version: Ntrip/2.0\r\nServer: x\r\n\r\n"
    + STREAM,
}


def fed(answer: bytes, cuts: list[int]) -> bytes:
    """The bytes of the stream of a response in chunks that end at `cuts`."""
    body, head, decoded = None, b"", b""
    for begin, end in zip([0, *cuts], [*cuts, len(answer)], strict=True):
        piece = answer[begin:end]
        if body is None:
            head += piece
            read = parse_response(head, with_password=False)
            if read is None:
                continue
            body, piece = read
        decoded += body.feed(piece)
    return decoded


@pytest.mark.parametrize("answer", STREAMS.values(), ids=STREAMS)
def test_stream_is_decoded_in_any_chunks(answer: bytes) -> None:
    assert fed(answer, []) == STREAM
    assert fed(answer, list(range(1, len(answer)))) == STREAM
    for cut in range(1, len(answer)):
        assert fed(answer, [cut]) == STREAM, cut


REFUSALS = {
    "a wrong password": (b"HTTP/1.0 401 Unauthorized\r\n", "does not accept user and password (401)"),
    "no right to it": (b"HTTP/1.1 403 Forbidden\r\n\r\n", "does not accept user and password (403)"),
    "a wrong password, revision 1": (b"ERROR - Bad Password\r\n", "does not accept user and password"),
    "an unknown mountpoint": (b"HTTP/1.1 404 Not Found\r\n\r\n", "mountpoint is unknown to the caster (404)"),
    "a mountpoint that is taken": (b"ERROR - Mount Point Taken or Invalid\r\n", "mountpoint is unknown"),
    "another error": (b"ERROR - out of order\r\n", "answers with an error"),
    "a table": (b"SOURCETABLE 200 OK\r\n", "unknown to the caster: it sends the table of its mountpoints"),
    "a table of revision 2": (
        b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n",
        "unknown to the caster: it sends the table of its mountpoints",
    ),
    "a caster that is full": (b"HTTP/1.1 503 Be gone\r\n\r\n", "answers 503 Service Unavailable"),
    "a status of nobody": (b"HTTP/1.1 599 Be gone\r\n\r\n", "answers 599"),
    "revision 1, an error": (b"ICY 401 Unauthorized\r\n", "does not accept user and password (401)"),
    "a page": (b"HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=x\r\n\r\n<html>", "a web page instead"),
    "a text": (b"HTTP/1.1 200 OK\r\nContent-Type: text/plain\r\n\r\nhello", "text/plain instead of a stream"),
    "a page without a header": (
        b"<!DOCTYPE html>\n",
        "expected an answer of a caster, got '<!DOCTYPE html>'",
    ),
    "elsewhere": (
        b"HTTP/1.1 302 Found\r\nLocation: https://driver:geheim@other.example:444/x?token=geheim\r\n\r\n",
        "sends us on to other.example:444 (302); not followed",
    ),
    "elsewhere, but where": (b"HTTP/1.1 301 Moved\r\n\r\n", "sends us on to another place (301)"),
    "elsewhere, unreadable": (
        b"HTTP/1.1 301 Moved\r\nLocation: http://[x\r\n\r\n",
        "sends us on to an unreadable address (301)",
    ),
    "compressed": (
        OK_2 + b"Transfer-Encoding: gzip, chunked\r\n\r\n",
        "encoded in a way that is not understood",
    ),
    "content that is compressed": (OK_2 + b"Content-Encoding: gzip\r\n\r\n", "encoded in a way"),
    "no status": (b"HTTP/1.1 OK\r\n\r\n", "no status"),
    "TLS": (b"\x15\x03\x01\x00\x02\x02\x46", "speaks TLS; use ntrips://"),
    "a plain stream": (b"\xd3\x00\x13", "expected an answer of a caster, got '?"),
    "a header without end": (OK_2 + b"X: y\r\n" * 4000, f"does not end within {HEAD_LIMIT_BYTES} bytes"),
    "a redirection without end": (b"HTTP/1.1 301 Moved\r\n" + b"X: y\r\n" * 4000, "does not end within"),
    "a line without end": (b"HTTP/1.1 " + b"2" * 2000, "expected an answer of a caster"),
    "another protocol": (b"SSH-2.0-OpenSSH_9.9\r\n", "got 'SSH-2.0-OpenSSH_9.9'"),
    "an empty line": (b"\r\n", "expected an answer of a caster, got ''"),
}


@pytest.mark.parametrize(("answer", "reason"), REFUSALS.values(), ids=REFUSALS)
def test_refusals_are_reported_with_the_reason(answer: bytes, reason: str) -> None:
    with pytest.raises(RefusedError) as raised:
        assert parse_response(answer, with_password=True)
    assert reason in str(raised.value)
    assert "geheim" not in str(raised.value)


def test_missing_password_is_the_reason() -> None:
    with pytest.raises(RefusedError, match=r"asks for user and password \(401\), and none are set"):
        parse_response(b"HTTP/1.0 401 Unauthorized\r\n", with_password=False)


@pytest.mark.parametrize(
    ("chunks", "reason"),
    [
        (b"4\r\nabcdef\r\n", "longer than its length"),
        (b"4\r\nabcd" + b"e" * 100, "longer than its length"),
        (b"-4\r\nabcd\r\n", "expected the length of a chunk, not '-4'"),
        (b"0x4\r\nabcd\r\n", "expected the length of a chunk"),
        (b"\r\n", "expected the length of a chunk, not ''"),
        (b"\xd3\x00\n", "expected the length of a chunk, not '\\?"),
        (b"ffffffff\r\n", "at most 16777216 are believed"),
        (b"f" * 300, "does not end"),
        (b"4;" + b"x" * 300 + b"\r\n", "does not end"),
        (b"0\r\n\r\n", "the caster ended the stream"),
    ],
)
@pytest.mark.parametrize("bytewise", [True, False])
def test_wrong_chunk_lengths_end_the_stream(chunks: bytes, reason: str, bytewise: bool) -> None:
    answer = OK_2 + b"Transfer-Encoding: chunked\r\n\r\n" + chunks
    with pytest.raises(ConnectionError, match=reason):
        fed(answer, list(range(1, len(answer))) if bytewise else [])


PARTS = (
    b"ICY|HTTP/1.1| |200|301|\r\n|\n|\r|:|Location: |//[|Transfer-Encoding: chunked|5|0|SOURCETABLE"
    b"|Content-Type: |text/html|@|\xd3"
).split(b"|")
ANYTHING = st.binary(max_size=200) | st.lists(st.sampled_from(PARTS), max_size=24).map(b"".join)


@given(ANYTHING, st.lists(st.integers(0, 200), max_size=5))
@example(b"ICY 200 OK\r\n\n\r", [])
@settings(derandomize=True, max_examples=600, deadline=None)
def test_random_responses_are_a_stream_or_a_reason(answer: bytes, cuts: list[int]) -> None:
    ends = sorted(min(cut, len(answer)) for cut in cuts)
    decoded, reason = b"", ""
    try:
        decoded = fed(answer, ends)
    except ConnectionError as error:
        reason = str(error)
    assert len(decoded) <= len(answer)
    assert len(reason) < 200
    assert reason.isprintable()
