"""A TCP connection, optionally with TLS, whose waits are all bounded and end when its thread is stopped."""

from __future__ import annotations

import errno
import os
import select
import socket
import ssl
import threading
import time
from pathlib import Path

_CHUNK_BYTES = 4096  # chosen: several messages of a receiver
_STEP_S = 0.1  # chosen: a stop is noticed after at most this time
_READ_S = 0.2  # chosen: a stop is noticed after at most this time
_CONNECT_S = 5.0
"""Chosen, for each address of a host, and for the handshake: enough when two of the first three packets are lost."""
_NOT_TLS = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE")


class RefusedError(ConnectionError):
    """The peer answers, and refuses a stream; asking again soon is of no use."""


class TcpConnection:
    """An open connection to `host`:`port`; OSError where there is none. Setting `stop` ends every wait.

    Only name resolution takes as long as the system lets it. It is a `ByteSource`.
    """

    lossless = False
    silence_reason = ""

    def __init__(self, host: str, port: int, *, stop: threading.Event, tls: ssl.SSLContext | None = None):
        self._stop = stop
        self._socket = _connected(host, port, stop)
        if tls is not None:
            try:
                self._socket = tls.wrap_socket(
                    self._socket, server_hostname=host, do_handshake_on_connect=False
                )
                _shake_hands(self._socket, stop)
            except BaseException:
                self._socket.close()
                raise

    def read(self) -> bytes:
        """Return some bytes; empty where nothing arrived in time. Raises OSError when the peer has gone."""
        data = self._received()
        if data is None:
            _await(self._socket, select.POLLIN, self._stop, time.monotonic() + _READ_S)
            data = self._received()
        if data == b"":
            raise ConnectionResetError("the other side closed the connection")
        return data or b""

    def send(self, data: bytes) -> int:
        """Send without waiting; return the number of bytes sent."""
        try:
            return self._socket.send(data)
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            return 0

    def close(self) -> None:
        """Close it, at once."""
        self._socket.close()

    def _received(self) -> bytes | None:
        """Return empty when the peer has closed, None without data. Bytes buffered by TLS are no event to poll for."""
        try:
            return self._socket.recv(_CHUNK_BYTES)
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            return None


def tls_context(ca_file: Path | None) -> ssl.SSLContext:
    """Return a context that checks certificates against `ca_file`, or the system's. RefusedError names the file."""
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


def _shake_hands(secured: ssl.SSLSocket, stop: threading.Event) -> None:
    deadline_s = time.monotonic() + _CONNECT_S
    while True:
        try:
            secured.do_handshake()
            return
        except ssl.SSLWantReadError:
            event = select.POLLIN
        except ssl.SSLWantWriteError:
            event = select.POLLOUT
        except ssl.SSLCertVerificationError as error:
            raise RefusedError(f"its certificate is not accepted: {error.verify_message}") from None
        except ssl.SSLError as error:
            problem = "the other side does not speak TLS" if error.reason in _NOT_TLS else "TLS failed"
            raise RefusedError(f"{problem} ({error.reason or error})") from None
        if not _await(secured, event, stop, deadline_s):
            raise TimeoutError(errno.ETIMEDOUT, f"no TLS handshake in {_CONNECT_S:g} s")


def _await(waiting: socket.socket, event: int, stop: threading.Event, deadline_s: float) -> bool:
    """Return whether the socket is ready in time; raises where `stop` is set meanwhile."""
    poll = select.poll()
    poll.register(waiting, event)
    while True:
        if stop.is_set():
            raise ConnectionAbortedError("stopped")
        left_s = deadline_s - time.monotonic()
        if left_s <= 0.0:
            return False
        if poll.poll(1000.0 * min(left_s, _STEP_S)):
            return True
