"""Where packets and frames come from, as the settings name it."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from pathlib import Path
from typing import Literal


def lidar_source(text: str) -> tuple[Literal["udp"], str, int] | tuple[Literal["pcap"], Path]:
    """Raises ValueError for what is no source, and for a recording that is not there."""
    kind, _, rest = text.partition(":")
    if kind == "pcap" and rest:
        return "pcap", _existing(rest)
    address, _, port = rest.rpartition(":")
    if kind == "udp" and port.isdecimal() and 0 < int(port[:6]) < 65_536:
        return "udp", str(ipaddress.IPv4Address(address)) if address else "", int(port)
    raise ValueError(f"{text!r}: expected udp:PORT, udp:ADDRESS:PORT or pcap:FILE")


def can_source(text: str) -> tuple[Literal["socketcan"], str] | tuple[Literal["candump"], Path]:
    """Raises ValueError for what is no source, and for a recording that is not there."""
    kind, _, rest = text.partition(":")
    if kind == "candump" and rest:
        return "candump", _existing(rest)
    if kind == "socketcan" and 0 < len(rest) < 16:
        return "socketcan", rest
    raise ValueError(f"{text!r}: expected socketcan:INTERFACE or candump:FILE")


def checked_by(parse: Callable[[str], object]) -> Callable[[str], str]:
    """A validator that keeps the text where it can be parsed."""

    def check(text: str) -> str:
        parse(text)
        return text

    return check


def _existing(text: str) -> Path:
    path = Path(text)
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    return path


def text_of(path: Path, encoding: str) -> str:
    """A file's text; ValueError where it cannot be read."""
    try:
        return path.read_text(encoding, "replace")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
