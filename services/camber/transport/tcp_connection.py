"""A TCP connection, with TLS where asked, of which no step waits without end or keeps its thread from stopping."""

from __future__ import annotations

import errno
import os
import select
import socket
import ssl
import threading
import time
from pathlib import Path

_CHUNK_BYTES = 4096
_STEP_S = 0.1  # so long a stop goes unseen at most
_CONNECT_S = 5.0
"""For each address of a host, and for the handshake. Two lost packets of the first three still leave time."""


class RefusedError(ConnectionError):
    """The other side answers, and will not give a stream; asking again soon is of no use."""


class Connection:
    """An open connection to `host`:`port`; OSError where there is none. Setting `stop` ends every wait.

    Only the resolver of names waits as long as the system lets it.
    """

    def __init__(self, host: str, port: int, *, stop: threading.Event, tls: ssl.SSLContext | None = None):
        self._stop = stop
        self._socket = _connected(host, port, stop)
        if tls is not None:
            self._socket = _secured(self._socket, tls, host, stop)

    def receive(self, within_s: float = 2 * _STEP_S) -> bytes:
        """Some bytes; empty where nothing came in time. Raises OSError when the other side has gone."""
        data = self._read()
        if data is None:
            _await(self._socket, select.POLLIN, self._stop, time.monotonic() + within_s)
            data = self._read()
        if data == b"":
            raise ConnectionResetError("the other side closed the connection")
        return data or b""

    def send(self, data: bytes) -> int:
        """How many of the first bytes of `data` went out; without waiting."""
        try:
            return self._socket.send(data)
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            return 0

    def close(self) -> None:
        """Close it, at once."""
        self._socket.close()

    def _read(self) -> bytes | None:
        """Empty: the other side has closed. None: nothing has come. Bytes that TLS holds are no event to poll for."""
        try:
            return self._socket.recv(_CHUNK_BYTES)
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            return None


def tls_context(ca_file: Path | None) -> ssl.SSLContext:
    """Certificates are checked: against `ca_file`, or else what the system trusts. RefusedError names the file."""
    try:
        return ssl.create_default_context(cafile=ca_file)
    except ssl.SSLError:
        raise RefusedError(f"{ca_file}: expected certificates in PEM") from None
    except OSError as error:
        raise RefusedError(f"{ca_file}: {error.strerror or error}") from None


def _connected(host: str, port: int, stop: threading.Event) -> socket.socket:
    last: OSError | None = None
    for family, kind, protocol, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        attempt = socket.socket(family, kind, protocol)
        try:
            attempt.setblocking(False)
            code = attempt.connect_ex(address)
            if code == errno.EINPROGRESS:
                if not _await(attempt, select.POLLOUT, stop, time.monotonic() + _CONNECT_S):
                    raise TimeoutError(errno.ETIMEDOUT, f"no answer in {_CONNECT_S:g} s")
                code = attempt.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if code:
                raise OSError(code, os.strerror(code))
            return attempt
        except OSError as error:
            attempt.close()
            last = error
    raise last or OSError(f"{host} has no address")


def _secured(raw: socket.socket, tls: ssl.SSLContext, host: str, stop: threading.Event) -> ssl.SSLSocket:
    deadline = time.monotonic() + _CONNECT_S
    try:
        secured = tls.wrap_socket(raw, server_hostname=host, do_handshake_on_connect=False)
    except BaseException:
        raw.close()
        raise
    try:
        while True:
            try:
                secured.do_handshake()
                return secured
            except ssl.SSLWantReadError:
                ready = _await(secured, select.POLLIN, stop, deadline)
            except ssl.SSLWantWriteError:
                ready = _await(secured, select.POLLOUT, stop, deadline)
            if not ready:
                raise TimeoutError(errno.ETIMEDOUT, f"no TLS handshake in {_CONNECT_S:g} s")
    except ssl.SSLCertVerificationError as error:
        secured.close()
        raise RefusedError(f"its certificate is not accepted: {error.verify_message}") from None
    except ssl.SSLError as error:
        secured.close()
        what = "the other side does not speak TLS" if error.reason in _NOT_TLS else "TLS failed"
        raise RefusedError(f"{what} ({error.reason or error})") from None
    except BaseException:
        secured.close()
        raise


_NOT_TLS = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE")


def _await(waiting: socket.socket, event: int, stop: threading.Event, deadline: float) -> bool:
    """Whether the socket is ready in time; raises where `stop` is set meanwhile."""
    poll = select.poll()
    poll.register(waiting, event)
    while True:
        if stop.is_set():
            raise ConnectionAbortedError("stopped")
        left_s = deadline - time.monotonic()
        if left_s <= 0.0:
            return False
        if poll.poll(1000.0 * min(left_s, _STEP_S)):
            return True
