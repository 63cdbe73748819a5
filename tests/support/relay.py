"""A TCP connection over a relay: bytes come later, in order, and are counted; it can be cut."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from queue import SimpleQueue


class Relay:
    """Listens on a port of the loopback and passes on to another, `delay_s` later; use as a context."""

    def __init__(self, to_port: int, delay_s: float = 0.0) -> None:
        self._to_port, self._delay_s = to_port, delay_s
        self.bytes_passed = 0
        """In both directions together."""
        self._counting = threading.Lock()
        self._is_cut = False
        self._open: list[socket.socket] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *exc: object) -> None:
        self.cut(True)
        _end(self._server)

    def cut(self, cut: bool) -> None:
        """From now on nothing passes, or it does again."""
        self._is_cut = cut
        while cut and self._open:
            _end(self._open.pop())

    def _accept(self) -> None:
        while self._server.fileno() >= 0:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(("127.0.0.1", self._to_port), 5.0)
            except OSError:  # no server yet: the client tries again
                near.close()
                continue
            far.settimeout(None)
            self._open += [near, far]
            for source, sink in ((near, far), (far, near)):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._pass_on(source, sink)
            if self._is_cut:
                self.cut(True)

    def _pass_on(self, source: socket.socket, sink: socket.socket) -> None:
        in_transit: SimpleQueue[tuple[float, bytes]] = SimpleQueue()

        def read() -> None:
            data = b"-"
            while data:
                try:
                    data = source.recv(65_536)
                except OSError:
                    data = b""
                with self._counting:
                    self.bytes_passed += len(data)
                in_transit.put((time.monotonic() + self._delay_s, data))

        def write() -> None:
            data = b"-"
            while data:
                due, data = in_transit.get()
                time.sleep(max(due - time.monotonic(), 0.0))
                try:
                    sink.sendall(data)
                    if not data:
                        sink.shutdown(socket.SHUT_WR)
                except OSError:
                    return

        for work in (read, write):
            threading.Thread(target=work, daemon=True).start()


def _end(one: socket.socket) -> None:
    """Also for a thread that waits for it."""
    with suppress(OSError):
        one.shutdown(socket.SHUT_RDWR)
    one.close()
