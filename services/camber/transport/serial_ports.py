"""Serial ports of this machine, with the name under which a receiver stays the same when it is plugged in again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from serial.tools import list_ports

_BY_ID = Path("/dev/serial/by-id")


def describe_ports() -> str:
    """Return a paragraph for each port: device, description, USB vendor and product, the source option."""
    return describe(list_ports.comports(), by_id=_BY_ID)


def describe(ports: Iterable[Any], *, by_id: Path) -> str:
    """Describe ports as pyserial lists them; `by_id` is the system's folder of persistent device names."""
    persistent_names = {}
    if by_id.is_dir():
        persistent_names = {str(link.resolve()): link for link in sorted(by_id.iterdir())}
    paragraphs = [
        _paragraph(port, persistent_names.get(port.device))
        for port in sorted(ports, key=lambda p: str(p.device))
    ]
    return "\n".join(paragraphs) or "no serial port is there"


def _paragraph(port: Any, persistent_name: Path | None) -> str:
    lines = [str(port.device)]
    if port.description and port.description != "n/a":
        lines.append(f"  {port.description}")
    if port.vid is not None and port.pid is not None:
        number = f", serial number {port.serial_number}" if port.serial_number else ""
        lines.append(f"  USB {port.vid:04x}:{port.pid:04x}{number}")
    lines.append(f"  --source serial:{persistent_name or port.device}")
    return "\n".join(lines)
