"""The live page's server: browsers that stall, a flood of messages, a clock that jumps, and who has no token."""

from __future__ import annotations

import json
import math
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from camber.formats.drive.mcap_recorder import Recorder
from camber.replay.short_drive import START_NS
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.base import Message
from camber.schemas.codec import encode, encoding_of
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from support.browser import served_address
from support.running import camber_started, loopback_router, wait_until

pytestmark = pytest.mark.slow

EPOCHS = 24_000
"""3.4 MB: more than the kernel takes for a browser that reads nothing (2.8 MB were measured)."""
STALLED = 100
MOST_KB = 220_000
"""Resident memory with a hundred stalled browsers: 105 MB without any, and a megabyte for each at most."""
FLOOD = 30_000
TENTH_NS = 100_000_000


def messages(k: int, start_ns: int = START_NS) -> tuple[tuple[str, str, Message], ...]:
    place = {"latitude_rad": math.radians(35.0), "longitude_rad": math.radians(137.0), "height_m": 41.6}
    time_ns = start_ns + k * TENTH_NS
    fix = Fix(time_ns=time_ns, fix_id=k, origin="receiver", quality="fixed", covariance_enu_m2=None, **place)
    verdict = Verdict(
        time_ns=time_ns, fix_id=k, verdict="confirmed", reason="height_agrees", detail="x" * 400
    )
    return ("fix", "gnss/fix", fix), ("verdict", "integrity/verdict", verdict)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "drive.mcap"
    recorder = Recorder(path)
    for k in range(EPOCHS):
        for channel, key, message in messages(k):
            data = encode(message, source=key.partition("/")[0], sequence=k)
            recorder.add(channel, data, key=f"camber/v1/car/{key}", arrival_ns=START_NS)
    recorder.close()
    return path


@contextmanager
def serving(*arguments: object) -> Iterator[tuple[str, int]]:
    """Address of the stream, and the server's process."""
    with camber_started("live", *arguments, "--port", 0) as process:
        yield served_address(process).replace("http", "ws") + "stream", process.pid


def memory_kb(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


class Browser:
    """Reads all that comes, as the page does."""

    def __init__(self, address: str, ends: ExitStack) -> None:
        self.rows: dict[str, int] = {}
        self.generation = 0
        self.status: dict[str, Any] = {}
        self._connection = ends.enter_context(connect(address, max_size=None, open_timeout=30.0))

    def read(self, timeout_s: float = 0.05) -> None:
        try:
            data = self._connection.recv(timeout_s)
        except TimeoutError:
            return
        if isinstance(data, bytes):
            header = json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])
            self.generation = header["generation"]
            for table in header["tables"]:
                self.rows[table["name"]] = table["first"] + table["rows"]
        elif (message := json.loads(data))["kind"] == "status":
            self.status = message

    def read_until(self, done: Any, why: str, timeout_s: float = 40.0) -> None:
        def read_and_ask() -> Any:
            self.read()
            return done(self)

        wait_until(read_and_ask, timeout_s=timeout_s, why=why)


def stalled_browser(address: str, ends: ExitStack) -> None:
    """One that asks for the stream (RFC 6455, section 4.1) and reads nothing of it."""
    host, port = address.removeprefix("ws://").partition("/")[0].split(":")
    small = socket.socket()
    ends.callback(small.close)
    small.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    small.connect((host, int(port)))
    lines = (
        "GET /stream HTTP/1.1",
        f"Host: {host}:{port}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
    )
    small.sendall("\r\n".join((*lines, "", "")).encode())


def test_a_hundred_stalled_browsers_hold_nobody(recording: Path) -> None:
    with serving(recording) as (address, pid), ExitStack() as ends:
        for _ in range(STALLED):
            stalled_browser(address, ends)
        browser = Browser(address, ends)
        browser.read_until(lambda it: it.rows.get("verdict") == EPOCHS, "not all rows came")
        assert browser.rows["fix"] == EPOCHS
        assert memory_kb(pid) < MOST_KB, memory_kb(pid)
        # Who does not answer for some seconds is let go.
        browser.read_until(lambda it: it.status.get("browsers", STALLED) == 1, "they are still served", 60.0)


def test_a_flood_is_counted_and_what_comes_after_it_is_shown() -> None:
    with loopback_router() as endpoint, ExitStack() as ends:
        address, _ = ends.enter_context(serving("--connect", endpoint, "--vehicle", "car"))
        browser = Browser(address, ends)
        browser.read_until(lambda it: it.status.get("state") == "receiving", "it is not on the bus")
        session = open_session(ZenohSettings(mode="client", connect=[endpoint]))
        ends.callback(session.close)

        def put(key: str, message: Message, sequence: int) -> None:
            data = encode(message, source=key.partition("/")[0], sequence=sequence)
            session.put(f"camber/v1/car/{key}", data, encoding=encoding_of(type(message)))

        for k in range(FLOOD):
            if k % 2:
                session.put("camber/v1/car/integrity/verdict", b"\x00\x00\x00\x01" + bytes(200))
            else:
                put("integrity/verdict", messages(0, START_NS + 10 * k)[1][2], k)
        browser.read_until(lambda it: it.status["left_out"].get("flood", 0) > 1000, "no flood is counted")
        browser.read_until(
            lambda it: it.status["left_out"].get("undecodable", 0) > 10, "no damage is counted"
        )
        time.sleep(1.0)
        before = browser.rows["verdict"]
        for k in range(10):
            for _, key, message in messages(100 + k):
                put(key, message, FLOOD + k)
            browser.read(0.1)
        browser.read_until(
            lambda it: it.rows["verdict"] >= before + 10, "what came after the flood is missing"
        )
        # A clock that is set back by an hour begins a new history.
        for _, key, message in messages(0, START_NS - 3600 * 10**9):
            put(key, message, 2 * FLOOD)
        browser.read_until(lambda it: it.generation == 1, "the history does not begin anew")


def test_without_the_token_there_is_no_stream(recording: Path) -> None:
    with serving(recording, "--host", "0.0.0.0", "--token", "0123456789abcdef") as (address, _):
        stream = address.replace("0.0.0.0", "127.0.0.1").replace("?token=0123456789abcdefstream", "stream")
        with pytest.raises(InvalidStatus), connect(stream):
            pass
        with connect(stream, additional_headers={"Cookie": "camber_live=0123456789abcdef"}) as connection:
            assert json.loads(connection.recv(20.0))["kind"] == "greeting"
    with (
        serving(recording) as (address, _),
        pytest.raises(InvalidStatus),
        connect(address, origin=Origin("http://example.org")),
    ):
        pass
