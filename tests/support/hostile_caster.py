"""A scripted TCP server, and certificates for it."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from camber.tools.security.certificate_authority import Authority

_STEP_S = 0.05

Script = Callable[["Peer"], None]


class Peer:
    """A connection of the server."""

    def __init__(self, connection: socket.socket, stop: threading.Event) -> None:
        self.socket = connection
        self._stop = stop
        self.sentences = b""

    def request(self) -> bytes:
        """Receive all up to the empty line."""
        while b"\r\n\r\n" not in self.sentences:
            self.listen()
        head, end, self.sentences = self.sentences.partition(b"\r\n\r\n")
        return head + end

    def listen(self) -> None:
        """Receive into `sentences` for a moment; ConnectionError where the client has gone."""
        if self._stop.is_set():
            raise ConnectionError("the test is over")
        self.socket.settimeout(_STEP_S)
        try:
            data = self.socket.recv(65_536)
        except TimeoutError:
            return
        if not data:
            raise ConnectionError("the client has gone")
        self.sentences += data

    def say(self, data: bytes) -> None:
        self.socket.settimeout(5.0)
        self.socket.sendall(data)

    def wait(self, seconds: float = 60.0) -> None:
        """Send nothing until the client has gone or the test is over."""
        for _ in range(int(seconds / _STEP_S)):
            self.listen()


class HostileCaster:
    """Runs the first script for the first connection, and so on; the last one for all others."""

    def __init__(self, *scripts: Script, tls: ssl.SSLContext | None = None, port: int = 0) -> None:
        self._scripts = scripts
        self._tls = tls
        self._stop = threading.Event()
        self._listening = socket.create_server(("127.0.0.1", port))
        self._listening.settimeout(_STEP_S)
        self.port = self._listening.getsockname()[1]
        self.connections = 0
        self._threads = [threading.Thread(target=self._accept, name="hostile-caster")]

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.end()

    def start(self) -> None:
        self._threads[0].start()

    def end(self) -> None:
        """Close all connections and the port."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._listening.close()

    def _accept(self) -> None:
        while not self._stop.is_set():
            try:
                connection = self._listening.accept()[0]
            except TimeoutError:
                continue
            script = self._scripts[min(self.connections, len(self._scripts) - 1)]
            self.connections += 1
            thread = threading.Thread(target=self._serve, args=(connection, script), name="hostile-caster")
            self._threads.append(thread)
            thread.start()

    def _serve(self, connection: socket.socket, script: Script) -> None:
        try:
            if self._tls is not None:
                connection.settimeout(5.0)
                connection = self._tls.wrap_socket(connection, server_side=True)
            script(Peer(connection, self._stop))
        except OSError:
            pass  # the client has gone, or has refused us
        finally:
            connection.close()


def certificates(folder: Path, name: str, *addresses: str) -> tuple[Path, ssl.SSLContext]:
    """The file of an authority, and the context of a server whose certificate it has signed, for `name`."""
    now = datetime.now(UTC)
    authority = Authority.make(folder / name, name=name, days=1, now=now)
    authority.issue("caster", "router", hosts=[name, *addresses], days=1, now=now)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(authority.folder / "caster.pem", authority.folder / "caster.key")
    return authority.folder / "ca.pem", context
