"""Which serial ports this machine has, and under which name a receiver stays the same when it is plugged in again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from serial.tools import list_ports

BY_ID = Path("/dev/serial/by-id")


def describe_ports() -> str:
    """A paragraph for each port: device, description, USB vendor and product, what to give as a source."""
    return described(list_ports.comports(), by_id=BY_ID)


def described(ports: Iterable[Any], *, by_id: Path) -> str:
    """The same, of ports as pyserial lists them; `by_id` is where the system keeps lasting names of devices."""
    lasting = _lasting_names(by_id)
    paragraphs = [
        _paragraph(port, lasting.get(port.device)) for port in sorted(ports, key=lambda p: str(p.device))
    ]
    return "\n".join(paragraphs) or "no serial port is there"


def _paragraph(port: Any, lasting: Path | None) -> str:
    lines = [str(port.device)]
    if port.description and port.description != "n/a":
        lines.append(f"  {port.description}")
    if port.vid is not None and port.pid is not None:
        number = f", serial number {port.serial_number}" if port.serial_number else ""
        lines.append(f"  USB {port.vid:04x}:{port.pid:04x}{number}")
    lines.append(f"  --source serial:{lasting or port.device}")
    return "\n".join(lines)


def _lasting_names(by_id: Path) -> dict[str, Path]:
    if not by_id.is_dir():
        return {}
    return {str(link.resolve()): link for link in sorted(by_id.iterdir())}
