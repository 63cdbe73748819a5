"""Casters that send wrong, slow or no data: a reported reason, bounded waits, and reconnection."""

from __future__ import annotations

import re
import ssl
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from camber.transport.byte_streams import ByteStream, open_stream
from camber.transport.ntrip_client import NtripAccess
from camber.transport.tcp_connection import TcpConnection
from support.hostile_caster import HostileCaster, Peer, Script, certificates
from support.streams import Reader, wait_for

pytestmark = pytest.mark.usefixtures("no_thread_is_left")

GGA = "$GPGGA,090000.00,3510.0000,N,13658.0000,E,1,12,0.8,30.0,M,38.0,M,,*5E"
ACCESS = NtripAccess(user="driver", password="geheim")
OK_2 = b"HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nContent-Type: gnss/data\r\n"


def opened(
    caster: HostileCaster,
    reader: Reader,
    access: NtripAccess = ACCESS,
    *,
    tls: bool = False,
    silence_s: float = 15.0,
) -> ByteStream:
    url = f"ntrip{'s' if tls else ''}://127.0.0.1:{caster.port}/BASE"
    return open_stream(url, on_data=reader.arrived.set, ntrip=access, silence_s=silence_s)


def closing_after(*parts: bytes) -> Script:
    """Send this response, and close the connection."""

    def script(peer: Peer) -> None:
        peer.request()
        for part in parts:
            peer.say(part)

    return script


def saying(*parts: bytes) -> Script:
    """Send this response, and then nothing more."""

    def script(peer: Peer) -> None:
        closing_after(*parts)(peer)
        peer.wait()

    return script


def endless(head: bytes, part: bytes) -> Script:
    """Send this, and then a part again and again."""

    def script(peer: Peer) -> None:
        closing_after(head)(peer)
        while True:
            peer.say(part)

    return script


ICY = b"ICY 200 OK\r\n"
CHUNKED = OK_2 + b"Transfer-Encoding: chunked\r\n\r\n"
GOOD = saying(ICY + b"\r\n", b"good")
ILL: dict[str, tuple[Script, str]] = {
    "an endless header": (
        endless(b"HTTP/1.1 200 OK\r\n", b"X-Nothing: " + b"x" * 1000 + b"\r\n"),
        "the header of the answer does not end within 16384 bytes",
    ),
    "an endless line": (endless(b"", b"x" * 1000), "expected an answer of a caster, got 'xxxx"),
    "a page": (
        saying(OK_2.replace(b"gnss/data", b"text/html") + b"\r\n<html><body>Welcome</body></html>"),
        "a web page instead of a stream",
    ),
    "an unknown mountpoint": (
        closing_after(
            b"SOURCETABLE 200 OK\r\nContent-Type: text/plain\r\n\r\nSTR;OTHER\r\nENDSOURCETABLE\r\n"
        ),
        "the mountpoint is unknown to the caster",
    ),
    "a wrong password": (
        closing_after(b"HTTP/1.1 401 Unauthorized\r\n\r\n"),
        "does not accept user and password",
    ),
    "elsewhere, in a circle": (
        closing_after(b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1/BASE\r\n\r\n"),
        "sends us on to 127.0.0.1 (302); not followed",
    ),
    "a chunk longer than it says": (
        saying(CHUNKED, b"4\r\nlong and longer\r\n"),
        "a chunk is longer than its length",
    ),
    "a chunk of all the world's bytes": (
        saying(CHUNKED, b"fffffffff\r\nsome"),
        "a chunk of 68719476735 bytes",
    ),
    "the end of all chunks": (
        saying(CHUNKED, b"0\r\n\r\n"),
        "the caster ended the stream",
    ),
    "closed without a word": (closing_after(), "the other side closed the connection"),
    "closed in the answer": (closing_after(b"HTTP/1.1 200 O"), "the other side closed the connection"),
    "TLS where none is expected": (saying(b"\x15\x03\x03\x00\x02\x02\x28"), "speaks TLS; use ntrips://"),
}


@pytest.mark.parametrize(("ill", "reason"), ILL.values(), ids=ILL)
def test_failure_is_reported_and_a_recovered_caster_is_reconnected(
    ill: Script, reason: str, reader: Reader
) -> None:
    with HostileCaster(ill, ill, GOOD) as caster, closing(opened(caster, reader)) as stream:
        assert reader.until(stream, lambda data: data.endswith(b"good"))
        assert stream.problem is None
        assert stream.failures == 2
        assert reason in str(stream.last_failure)
        assert "geheim" not in str(stream.last_failure)


def test_request_is_as_a_caster_expects(reader: Reader) -> None:
    asked = []

    def script(peer: Peer) -> None:
        asked.append(peer.request())
        peer.say(b"ICY 200 OK\r\n\r\ngood")
        peer.wait()

    with HostileCaster(script) as caster, closing(opened(caster, reader)) as stream:
        reader.until(stream, bool)
    assert asked[0].startswith(b"GET /BASE HTTP/1.1\r\n")
    assert b"\r\nAuthorization: Basic ZHJpdmVyOmdlaGVpbQ==\r\n" in asked[0]


def test_dropping_caster_is_contacted_with_growing_pauses(reader: Reader) -> None:
    with (
        HostileCaster(closing_after(b"ICY 200 OK\r\n\r\n", b"x")) as caster,
        closing(opened(caster, reader)) as stream,
    ):
        time.sleep(3.0)
        assert stream.failures > 1
        assert caster.connections <= 6  # pauses of 0.1, 0.2, 0.4, 0.8, 1.6 s at least


@pytest.mark.parametrize(
    "silent",
    [saying(ICY), saying(CHUNKED + b"1000\r\n"), endless(ICY, b"Server: x\r\n" * 1000)],
    ids=["nothing", "lengths without bytes", "a header of revision 1 that never ends"],
)
def test_a_silent_caster_is_reported(silent: Script, reader: Reader) -> None:
    with HostileCaster(silent, GOOD) as caster, closing(opened(caster, reader, silence_s=0.4)) as stream:
        assert reader.until(stream, bool) == b"good"
        assert stream.last_failure == "silent for 0.4 s"


def test_a_caster_that_waits_for_a_position_gets_it_before_anything_has_come(reader: Reader) -> None:
    def script(peer: Peer) -> None:
        peer.request()
        peer.say(b"ICY 200 OK\r\n")  # and no empty line: that would be of the stream
        while b"GGA" not in peer.sentences:
            peer.listen()
        peer.say(b"\xd3yours")
        peer.wait()

    access = NtripAccess(position=lambda: GGA)
    with HostileCaster(script) as caster, closing(opened(caster, reader, access)) as stream:
        assert reader.until(stream, bool) == b"\xd3yours"
        assert stream.failures == 0


def test_missing_position_is_given_as_reason_of_silence(reader: Reader) -> None:
    access = NtripAccess(position=lambda: None)
    with (
        HostileCaster(saying(ICY)) as caster,
        closing(opened(caster, reader, access, silence_s=0.3)) as stream,
    ):
        wait_for(lambda: stream.failures > 0)
        assert stream.last_failure == "silent for 0.3 s; no position has been sent to the caster yet"


@pytest.mark.parametrize("answer", [b"ICY 200 OK\r\n\r\n", OK_2 + b"\r\n"], ids=["revision 1", "revision 2"])
def test_positions_come_at_most_once_a_second_across_connections_too(answer: bytes, reader: Reader) -> None:
    sent_s: list[float] = []
    opened_s = time.monotonic()

    def script(peer: Peer) -> None:
        sent_s.extend([time.monotonic()] * peer.request().count(b"$GPGGA"))
        peer.say(answer + b"x")
        until_s = time.monotonic() + 0.5
        while time.monotonic() < until_s:
            peer.listen()
            sent_s.extend([time.monotonic()] * peer.sentences.count(b"\r\n"))
            peer.sentences = peer.sentences.rpartition(b"\n")[2]

    access = NtripAccess(position=lambda: GGA, position_interval_s=1.0)
    with HostileCaster(script) as caster, closing(opened(caster, reader, access)) as stream:
        wait_for(lambda: len(sent_s) >= 4)
        assert caster.connections > 1
        assert stream.failures > 0
    assert sent_s[3] - opened_s >= 3.0  # the first at once, and then one a second at most


def test_a_caster_that_does_not_take_positions_is_still_read(
    reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    send = TcpConnection.send

    def without_sentences(connection: TcpConnection, data: bytes) -> int:
        """As with a full queue."""
        return 0 if data.startswith(b"$") else send(connection, data)

    monkeypatch.setattr(TcpConnection, "send", without_sentences)
    access = NtripAccess(position=lambda: GGA, version=1)

    def script(peer: Peer) -> None:
        peer.request()
        peer.say(b"ICY 200 OK\r\n\r\n")
        for _ in range(20):
            peer.say(b"x")
            peer.listen()
        peer.wait()

    with HostileCaster(script) as caster, closing(opened(caster, reader, access)) as stream:
        assert reader.until(stream, lambda data: len(data) == 20)
        assert stream.failures == 0


def test_a_caster_that_answers_a_letter_at_a_time_is_given_up_in_bounded_time(
    reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camber.transport.ntrip_client.RESPONSE_TIMEOUT_S", 0.5)

    def script(peer: Peer) -> None:
        peer.request()
        peer.say(b"HTTP/1.1 200 OK\r\n")
        while True:
            peer.say(b"X")
            peer.listen()

    with HostileCaster(script, GOOD) as caster, closing(opened(caster, reader)) as stream:
        assert reader.until(stream, bool) == b"good"
        assert stream.last_failure == "the caster has not answered in 0.5 s"


@pytest.fixture(scope="module")
def caster_tls(tmp_path_factory: pytest.TempPathFactory) -> tuple[NtripAccess, ssl.SSLContext]:
    """Access by an authority, and the context of a caster that it has certified."""
    authority, tls = certificates(tmp_path_factory.mktemp("tls"), "caster.example", "127.0.0.1")
    return replace(ACCESS, ca_file=authority), tls


def test_a_stream_in_chunks_comes_through_tls_byte_for_byte(
    reader: Reader, caster_tls: tuple[NtripAccess, ssl.SSLContext]
) -> None:
    content = bytes(range(256)) * 400
    access, tls = caster_tls

    def script(peer: Peer) -> None:
        peer.request()
        peer.say(CHUNKED)
        at, size = 0, 1
        while at < len(content):
            part = content[at : at + size]
            peer.say(b"%X\r\n%s\r\n" % (len(part), part))
            at, size = at + size, size * 3 % 5000 + 1
        peer.wait()

    with (
        HostileCaster(script, tls=tls) as caster,
        closing(opened(caster, reader, access, tls=True)) as stream,
    ):
        assert reader.until(stream, lambda data: len(data) >= len(content)) == content
        assert stream.failures == 0


def test_certificates_are_checked(
    reader: Reader, tmp_path: Path, caster_tls: tuple[NtripAccess, ssl.SSLContext]
) -> None:
    asked: list[bytes] = []
    _, tls = caster_tls
    other, _ = certificates(tmp_path, "other.example", "127.0.0.1")
    server_name, of_another = certificates(tmp_path, "third.example")
    empty = tmp_path / "empty.pem"
    empty.write_text("no certificate\n")

    def script(peer: Peer) -> None:
        asked.append(peer.request())

    for presented, trusted, reason in [
        (tls, None, "its certificate is not accepted: "),
        (tls, other, "its certificate is not accepted: "),
        (of_another, server_name, "its certificate is not accepted: IP address mismatch"),
        (tls, tmp_path / "missing.pem", "missing.pem: No such file"),
        (tls, empty, "empty.pem: expected certificates in PEM"),
    ]:
        access = replace(ACCESS, ca_file=trusted)
        with (
            HostileCaster(script, tls=presented) as caster,
            closing(opened(caster, reader, access, tls=True)) as stream,
        ):
            wait_for(lambda stream=stream: stream.failures > 0)
            assert reason in str(stream.last_failure)
    assert asked == []  # no password has left us


def test_a_caster_without_tls_gets_no_password(reader: Reader) -> None:
    sentences: list[bytes] = []

    def script(peer: Peer) -> None:
        peer.listen()
        sentences.append(peer.sentences)
        peer.say(b"HTTP/1.1 400 Bad Request\r\n\r\n")

    with HostileCaster(script) as caster, closing(opened(caster, reader, tls=True)) as stream:
        wait_for(lambda: stream.failures > 0)
        assert "does not speak TLS" in str(stream.last_failure)
    assert not any(re.search(rb"Authorization|GET", data) for data in sentences)


def test_closing_ends_the_thread_in_whatever_it_waits_for(
    reader: Reader, caster_tls: tuple[NtripAccess, ssl.SSLContext]
) -> None:
    access, tls = caster_tls
    cases: list[tuple[Script, ssl.SSLContext | None, bool]] = [
        (Peer.wait, None, True),  # the handshake
        (Peer.wait, None, False),  # the answer
        (Peer.wait, tls, True),  # the answer, within TLS
        (saying(ICY), None, False),  # bytes
        (closing_after(b"HTTP/1.1 401 No\r\n\r\n"), None, False),  # the next attempt
    ]
    for script, server_tls, client_tls in cases:
        with HostileCaster(script, tls=server_tls) as caster:
            stream = opened(caster, reader, access, tls=client_tls)
            wait_for(lambda caster=caster: caster.connections > 0)
            time.sleep(0.2)
            stream.close()
            wait_for(lambda stream=stream: not stream.running, within_s=2.0)  # all waits are longer
