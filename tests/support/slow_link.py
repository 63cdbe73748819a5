"""A TCP connection over a long way: all bytes in both directions come so much later, and in order."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque


class SlowLink:
    """Listens on a port of the loopback and passes on to another, `delay_s` later; use as a context."""

    def __init__(self, to_port: int, delay_s: float) -> None:
        self._to_port, self.delay_s = to_port, delay_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._sockets: list[socket.socket] = []
        self._ended = threading.Event()

    def __enter__(self) -> SlowLink:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._ended.set()
        for one in (self._server, *self._sockets):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _accept(self) -> None:
        while not self._ended.is_set():
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
            for one in (near, far):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._sockets += [near, far]
            for source, sink in ((near, far), (far, near)):
                self._pass_on(source, sink)

    def _pass_on(self, source: socket.socket, sink: socket.socket) -> None:
        in_transit: deque[tuple[float, bytes]] = deque()
        some = threading.Condition()

        def read() -> None:
            data = b"-"
            while data:
                try:
                    data = source.recv(65_536)
                except OSError:
                    data = b""
                with some:
                    in_transit.append((time.monotonic() + self.delay_s, data))
                    some.notify()

        def write() -> None:
            while not self._ended.is_set():
                with some:
                    while not in_transit:
                        some.wait()
                    due, data = in_transit.popleft()
                time.sleep(max(due - time.monotonic(), 0.0))
                try:
                    if not data:
                        sink.shutdown(socket.SHUT_WR)
                        return
                    sink.sendall(data)
                except OSError:
                    return

        for work in (read, write):
            threading.Thread(target=work, daemon=True).start()
