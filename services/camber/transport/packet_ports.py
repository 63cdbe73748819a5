"""Datagrams and CAN frames as this machine receives them, with the time at which its kernel had them.

Sockets are read without waiting; the kernel keeps what comes in between. A port that cannot be opened, or that fails,
is opened anew every second, and `problem` says why it is closed.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
import time
from abc import ABC, abstractmethod
from typing import Any

from camber.formats.lidar_can.candump import ERROR_FLAG, CanFrame
from camber.formats.lidar_can.pcap import Datagram

BUFFER_BYTES = 8 << 20
"""Asked of the kernel, which gives what `net.core.rmem_max` allows."""
_MOST_AT_ONCE = 4096
_AGAIN_S = 1.0
_TIMESTAMP_NS, _OVERFLOW = 35, 40  # SO_TIMESTAMPNS, SO_RXQ_OVFL: the socket module has no names for them
_EXTENDED_FLAG, _REMOTE_FLAG = 0x8000_0000, 0x4000_0000


class _Port(ABC):
    """`lost` counts what came while the kernel's buffer was full."""

    def __init__(self) -> None:
        self.problem: str | None = "not opened yet"
        self.lost = 0
        self._socket: socket.socket | None = None
        self._lost_before = 0
        self._tried_s = -_AGAIN_S

    @abstractmethod
    def _opened(self) -> socket.socket:
        """A socket that is bound, or OSError."""

    def close(self) -> None:
        """Close it."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _received(self, most_bytes: int) -> list[tuple[int, str, bytes]]:
        """All that has come since the last call, up to some thousands."""
        if self._socket is None and not self._open():
            return []
        assert self._socket is not None
        found: list[tuple[int, str, bytes]] = []
        try:
            for _ in range(_MOST_AT_ONCE):
                data, notes, _, sender = self._socket.recvmsg(most_bytes, 128)
                found.append((self._noted(notes), str(sender[0]) if sender else "", data))
        except BlockingIOError:
            pass
        except OSError as error:
            self.close()
            self.problem = error.strerror or str(error)
        return found

    def _open(self) -> bool:
        now_s = time.monotonic()
        if now_s - self._tried_s < _AGAIN_S:
            return False
        self._tried_s = now_s
        try:
            port = self._opened()
        except OSError as error:
            self.problem = error.strerror or str(error)
            return False
        port.setblocking(False)
        port.setsockopt(socket.SOL_SOCKET, _TIMESTAMP_NS, 1)
        port.setsockopt(socket.SOL_SOCKET, _OVERFLOW, 1)
        self._socket, self.problem, self._lost_before = port, None, 0
        return True

    def _noted(self, notes: list[tuple[int, int, bytes]]) -> int:
        time_ns = 0
        for level, kind, value in notes:
            if level == socket.SOL_SOCKET and kind == _TIMESTAMP_NS and len(value) == 16:
                seconds, nanoseconds = struct.unpack("=qq", value)
                time_ns = seconds * 1_000_000_000 + nanoseconds
            elif level == socket.SOL_SOCKET and kind == _OVERFLOW and len(value) == 4:
                (lost,) = struct.unpack("=I", value)
                self.lost += (lost - self._lost_before) & 0xFFFF_FFFF
                self._lost_before = lost
        return time_ns or time.time_ns()


class UdpPort(_Port):
    """What is sent to a port of this machine; with a multicast address, what is sent to that group."""

    def __init__(self, address: str, port: int) -> None:
        super().__init__()
        self._address, self._number = address, port

    def take(self) -> list[Datagram]:
        """All datagrams since the last call."""
        return [
            Datagram(time_ns, source, self._number, payload)
            for time_ns, source, payload in self._received(65_536)
        ]

    def _opened(self) -> socket.socket:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            if self._address and ipaddress.ip_address(self._address).is_multicast:
                port.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                group = socket.inet_aton(self._address) + socket.inet_aton("0.0.0.0")
                port.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
            port.bind((self._address, self._number))
        except OSError:
            port.close()
            raise
        return port


class CanPort(_Port):
    """Frames of a CAN interface of Linux (SocketCAN)."""

    def __init__(self, interface: str) -> None:
        super().__init__()
        self._interface = interface

    def take(self) -> list[CanFrame]:
        """All data frames since the last call."""
        frames = [
            frame_from_socket(data, time_ns, self._interface) for time_ns, _, data in self._received(72)
        ]
        return [frame for frame in frames if frame is not None]

    def _opened(self) -> socket.socket:
        port = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            port.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            port.bind((self._interface,))
        except OSError:
            port.close()
            raise
        return port


def frame_from_socket(data: bytes, time_ns: int, interface: str) -> CanFrame | None:
    """A `can_frame` (16 bytes) or `canfd_frame` (72) of Linux; None for remote and error frames and what is neither."""
    if len(data) not in (16, 72):
        return None
    word, length = struct.unpack_from("=IB", data)
    if word & (_REMOTE_FLAG | ERROR_FLAG) or length > len(data) - 8:
        return None
    extended = bool(word & _EXTENDED_FLAG)
    return CanFrame(
        time_ns, interface, word & (0x1FFF_FFFF if extended else 0x7FF), extended, data[8 : 8 + length]
    )


def socket_bytes(frame: CanFrame) -> bytes:
    """A frame as Linux takes it: 16 bytes, or 72 where it is longer than eight."""
    word = frame.identifier | (_EXTENDED_FLAG if frame.extended else 0)
    size: Any = 8 if len(frame.data) <= 8 else 64
    return struct.pack(f"=IB3x{size}s", word, len(frame.data), frame.data)
