"""UDP datagrams and CAN frames received by this machine, with the kernel's receive time.

Sockets are non-blocking; the kernel buffers between reads. A port that cannot be opened, or that fails, is reopened
every second, and `problem` is why it is closed.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
import time
from abc import ABC, abstractmethod

from camber.formats.lidar_can.candump import ERROR_FLAG, CanFrame
from camber.formats.lidar_can.pcap import Datagram

_BUFFER_BYTES = 8 << 20
"""Chosen: a fraction of a second of a LiDAR with 128 channels. The kernel grants at most `net.core.rmem_max`."""
_MAX_PACKETS = 4096  # chosen: a service that is late must still return from a read
_REOPEN_S = 1.0  # chosen: quick enough for a plugged cable, no load
_TIMESTAMP_NS, _OVERFLOW = 35, 40  # SO_TIMESTAMPNS, SO_RXQ_OVFL: the socket module has no names for them
_EXTENDED_FLAG, _REMOTE_FLAG = 0x8000_0000, 0x4000_0000


class _PacketPort(ABC):
    """`lost` counts packets that arrived while the kernel's buffer was full."""

    def __init__(self) -> None:
        self.problem: str | None = "not opened yet"
        self.lost = 0
        self._socket: socket.socket | None = None
        self._kernel_lost = 0
        self._tried_s = -_REOPEN_S

    @abstractmethod
    def _bound_socket(self) -> socket.socket:
        """Return a bound socket, or raise OSError."""

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _receive(self, max_bytes: int) -> list[tuple[int, str, bytes]]:
        """Return the receive time, sender and payload of all packets since the last call, up to some thousands."""
        port = self._socket or self._open()
        if port is None:
            return []
        packets: list[tuple[int, str, bytes]] = []
        try:
            for _ in range(_MAX_PACKETS):
                data, ancillary, _, sender = port.recvmsg(max_bytes, 128)
                packets.append((self._receive_time_ns(ancillary), str(sender[0]) if sender else "", data))
        except BlockingIOError:
            pass
        except OSError as error:
            self.close()
            self.problem = error.strerror or str(error)
        return packets

    def _open(self) -> socket.socket | None:
        now_s = time.monotonic()
        if now_s - self._tried_s < _REOPEN_S:
            return None
        self._tried_s = now_s
        try:
            port = self._bound_socket()
        except OSError as error:
            self.problem = error.strerror or str(error)
            return None
        port.setblocking(False)
        port.setsockopt(socket.SOL_SOCKET, _TIMESTAMP_NS, 1)
        port.setsockopt(socket.SOL_SOCKET, _OVERFLOW, 1)
        self._socket, self.problem, self._kernel_lost = port, None, 0
        return port

    def _receive_time_ns(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        """Return the kernel's time of a packet, and count those lost before it."""
        time_ns = 0
        for level, kind, value in ancillary:
            if level == socket.SOL_SOCKET and kind == _TIMESTAMP_NS and len(value) == 16:
                seconds, nanoseconds = struct.unpack("=qq", value)
                time_ns = seconds * 1_000_000_000 + nanoseconds
            elif level == socket.SOL_SOCKET and kind == _OVERFLOW and len(value) == 4:
                (lost,) = struct.unpack("=I", value)
                self.lost += (lost - self._kernel_lost) & 0xFFFF_FFFF
                self._kernel_lost = lost
        return time_ns or time.time_ns()


class UdpPort(_PacketPort):
    """Datagrams to a port of this machine; with a multicast address, to that group."""

    def __init__(self, address: str, port: int) -> None:
        super().__init__()
        self._address, self._number = address, port

    def take(self) -> list[Datagram]:
        """Return all datagrams since the last call."""
        return [
            Datagram(time_ns=time_ns, source=source, port=self._number, payload=payload)
            for time_ns, source, payload in self._receive(65_536)
        ]

    def _bound_socket(self) -> socket.socket:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            if self._address and ipaddress.ip_address(self._address).is_multicast:
                port.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                group = socket.inet_aton(self._address) + socket.inet_aton("0.0.0.0")
                port.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
            port.bind((self._address, self._number))
        except OSError:
            port.close()
            raise
        return port


class CanPort(_PacketPort):
    """Frames of a CAN interface of Linux (SocketCAN)."""

    def __init__(self, interface: str) -> None:
        super().__init__()
        self._interface = interface

    def take(self) -> list[CanFrame]:
        """Return all data frames since the last call."""
        frames = [frame_from_socket(data, time_ns, self._interface) for time_ns, _, data in self._receive(72)]
        return [frame for frame in frames if frame is not None]

    def _bound_socket(self) -> socket.socket:
        port = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            port.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            port.bind((self._interface,))
        except OSError:
            port.close()
            raise
        return port


def frame_from_socket(data: bytes, time_ns: int, interface: str) -> CanFrame | None:
    """Parse a `can_frame` (16 bytes) or `canfd_frame` (72) of Linux; None for remote, error and other frames."""
    if len(data) not in (16, 72):
        return None
    flags, length = struct.unpack_from("=IB", data)
    if flags & (_REMOTE_FLAG | ERROR_FLAG) or length > len(data) - 8:
        return None
    extended = bool(flags & _EXTENDED_FLAG)
    return CanFrame(
        time_ns=time_ns,
        bus=interface,
        identifier=flags & (0x1FFF_FFFF if extended else 0x7FF),
        extended=extended,
        data=data[8 : 8 + length],
    )
