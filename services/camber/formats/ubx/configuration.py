"""Configuration of u-blox receivers from generation 9 on: keys that Camber sets, UBX-CFG-VALGET and -VALSET.

Source: u-blox ZED-F9P, interface description of HPG 1.32 (UBX-22008968): messages UBX-CFG-VALGET, UBX-CFG-VALSET and
UBX-ACK; chapter "Configuration interface" (bits 28 to 30 of a key give the size of its value) with the groups CFG-RATE,
CFG-NAVSPG, CFG-MSGOUT and those of the ports' protocols.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Literal

from camber.formats.errors import FormatError
from camber.formats.ubx.writer import ubx_frame

UbxPort = Literal["i2c", "uart1", "uart2", "usb"]
UBX_PORTS: tuple[UbxPort, ...] = ("i2c", "uart1", "uart2", "usb")
"""In the order of the keys of a message's output rates (CFG-MSGOUT)."""
RAM, BATTERY_BACKED, FLASH = 1, 2, 4
"""Bits of `layers` of CFG-VALSET."""
_CLASS, _VALSET, _VALGET = 0x06, 0x8A, 0x8B
_ACK_CLASS, _NAK, _ACK = 0x05, 0x00, 0x01
_VALUE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8}
"""By bits 28 to 30 of a key."""
_FORMS = {1: "<B", 2: "<H", 4: "<I", 8: "<Q"}

RATE_MEAS_MS, RATE_NAV = 0x30210001, 0x30210002
DYNAMIC_MODEL, AUTOMOTIVE = 0x20110021, 4
_MESSAGE_RATES = {
    "RXM-RAWX": 0x209102A4,
    "RXM-SFRBX": 0x20910231,
    "NAV-PVT": 0x20910006,
    "NAV-HPPOSLLH": 0x20910033,
    "NAV-COV": 0x20910083,
    "NAV-PL": 0x20910415,
    "NAV-SAT": 0x20910015,
    "SEC-SIG": 0x20910634,
    "MON-RF": 0x20910359,
}
"""Messages and the key of their output rate on I2C; those of UART1, UART2 and USB follow."""
_PROTOCOLS = {
    "uart1": (0x10730004, 0x10740001, 0x10740002),
    "uart2": (0x10750004, 0x10760001, 0x10760002),
    "usb": (0x10770004, 0x10780001, 0x10780002),
    "i2c": (0x10710004, 0x10720001, 0x10720002),
}
"""Keys of RTCM 3 as input, UBX as output and NMEA as output, by port."""


def wanted_values(port: UbxPort, rate_hz: int, *, raw: bool) -> dict[int, int]:
    """Return key → value of what Camber needs at one port: raw observations, or positions; with integrity reports.

    RTCM 3 is taken and NMEA is not sent there. Epochs come `rate_hz` times a second, reports once a second.
    """
    offset = UBX_PORTS.index(port)
    rtcm_input, ubx_output, nmea_output = _PROTOCOLS[port]
    every_epoch = {"RXM-RAWX", "RXM-SFRBX"} if raw else {"NAV-PVT", "NAV-HPPOSLLH", "NAV-COV", "NAV-PL"}
    once_a_second = {"SEC-SIG", "MON-RF"} if raw else {"NAV-SAT", "SEC-SIG", "MON-RF"}
    rates = (
        dict.fromkeys(_MESSAGE_RATES, 0)
        | dict.fromkeys(every_epoch, 1)
        | dict.fromkeys(once_a_second, rate_hz)
    )
    return {
        RATE_MEAS_MS: 1000 // rate_hz,
        RATE_NAV: 1,
        DYNAMIC_MODEL: AUTOMOTIVE,
        rtcm_input: 1,
        ubx_output: 1,
        nmea_output: 0,
        **{_MESSAGE_RATES[name] + offset: rate for name, rate in rates.items()},
    }


def key_name(key: int) -> str:
    """Return what a key of `wanted_values` sets, for people."""
    fixed = {
        RATE_MEAS_MS: "measurement period [ms]",
        RATE_NAV: "measurements per solution",
        DYNAMIC_MODEL: f"dynamic model ({AUTOMOTIVE}: automotive)",
    }
    if key in fixed:
        return fixed[key]
    for port, keys in _PROTOCOLS.items():
        if key in keys:
            return f"{('RTCM 3 input', 'UBX output', 'NMEA output')[keys.index(key)]} on {port.upper()}"
    for name, first in _MESSAGE_RATES.items():
        if 0 <= key - first < len(UBX_PORTS):
            return f"{name} on {UBX_PORTS[key - first].upper()}, each n-th epoch"
    return f"key {key:#010x}"


def value_request(key: int) -> bytes:
    """Return CFG-VALGET that asks for the value in use (layer 0, RAM)."""
    return ubx_frame(_CLASS, _VALGET, struct.pack("<BBHI", 0, 0, 0, key))


def value_setting(values: Mapping[int, int], layers: int) -> bytes:
    """Return CFG-VALSET of at most 64 keys in layers; ValueError for more, or for values beyond their size."""
    if not 0 < len(values) <= 64:
        raise ValueError(f"{len(values)} keys, expected 1 to 64")
    body = struct.pack("<BBH", 0, layers, 0)
    for key, value in values.items():
        form = _FORMS[_value_bytes(key)]
        try:
            body += struct.pack("<I", key) + struct.pack(form, value)
        except struct.error:
            size = struct.calcsize(form)
            raise ValueError(f"{value} for {key_name(key)}, expected a number of {size} bytes") from None
    return ubx_frame(_CLASS, _VALSET, body)


def read_values(frame: bytes) -> dict[int, int] | None:
    """Return key → value of a frame of CFG-VALGET; None for another message. Raises FormatError for a damaged one."""
    if frame[2:4] != bytes((_CLASS, _VALGET)):
        return None
    payload = frame[6:-2]
    if len(payload) < 4 or payload[0] != 1:
        raise FormatError("CFG-VALGET", "version", "1, with a layer and a position", actual=payload[:4])
    return dict(_values(payload[4:]))


def is_acknowledged(frame: bytes, *, setting: bool) -> bool | None:
    """Whether a frame accepts (True) or refuses (False) CFG-VALSET, or CFG-VALGET; None: it is about neither."""
    about = bytes((_CLASS, _VALSET if setting else _VALGET))
    if frame[2] != _ACK_CLASS or frame[6:8] != about:
        return None
    return {_ACK: True, _NAK: False}.get(frame[3])


def _values(data: bytes) -> Iterator[tuple[int, int]]:
    while data:
        if len(data) < 4:
            raise FormatError("CFG-VALGET", "key", "4 bytes", actual=data)
        (key,) = struct.unpack_from("<I", data)
        size = _value_bytes(key)
        if len(data) < 4 + size:
            raise FormatError("CFG-VALGET", key_name(key), f"{size} bytes", actual=data[4:])
        yield key, struct.unpack_from(_FORMS[size], data, 4)[0]
        data = data[4 + size :]


def _value_bytes(key: int) -> int:
    size = _VALUE_BYTES.get(key >> 28 & 7)
    if size is None:
        raise FormatError("CFG-VALGET", "key", "a size in bits 28 to 30 from 1 to 5", actual=f"{key:#010x}")
    return size
