"""What a service has learnt, kept over a restart: one file for each thing, used only where it is whole.

    {"sha256": "…", "format": 2, "name": "correction", "vehicle": "car-1", "content": {…}}

The hash is of every byte behind it, and the bytes before it are fixed: no changed byte goes unnoticed. Another
format, another vehicle, or values out of their bounds are as bad as damage: the file is renamed, reported, and what it
held is learnt anew. So is a file of before there were checksums (format 1): one changed digit in it would move
the height of every fix, and what it held is learnt again within minutes.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from camber.road_map.release_files import write_file
from camber.runtime.bus import Bus
from camber.runtime.settings import ServiceSettings
from camber.schemas.plain_file import read_plain_file
from camber.schemas.refused_field import first_refused

T = TypeVar("T")

FORMAT = 2  # of the envelope and of all contents; 1 had no checksum
_MOST_BYTES = 4 << 20  # chosen: the largest, 256 base stations of 32 days, has 1.6 MB
_FILE = re.compile(
    rb'\{"sha256": "([0-9a-f]{64})",'
    rb' ("format": (\d{1,9}), "name": "(\w+)", "vehicle": "([^"]+)", "content": (.*))\}\n',
    re.DOTALL,
)


class StateFile:
    """The file `NAME.json` in `state_dir`; without `state_dir` nothing is read and nothing written."""

    def __init__(self, name: str, *, settings: ServiceSettings, bus: Bus) -> None:
        self.path = None if settings.state_dir is None else settings.state_dir / f"{name}.json"
        self.was_rejected = False
        self._name, self._vehicle, self._bus = name, settings.vehicle, bus

    def load(self, parse: Callable[[str], T]) -> T | None:
        """Return what `parse` makes of the content, JSON; None where there is no file, or none that can be used.

        `parse` raises ValueError for values out of their bounds.
        """
        if self.path is None or not os.path.lexists(self.path):
            return None
        try:
            data = read_plain_file(self.path, _MOST_BYTES)
            return parse(_content_of(data, self._name, self._vehicle))
        except (OSError, ValueError, RecursionError) as error:
            self._reject(self.path, _one_line(error))
            return None

    def save(self, content: str) -> bool:
        """Replace the file by one with this content, JSON, and return whether that was possible."""
        if self.path is None:
            return False
        try:
            write_file(self.path, _bytes_of(content, self._name, self._vehicle))
        except OSError as error:
            self._bus.issue("state_not_saved", f"{self.path}: {error.strerror or error}")
            return False
        return True

    def _reject(self, path: Path, reason: str) -> None:
        """Rename the file; an earlier one of that name is overwritten, so that damage does not fill the disk."""
        self.was_rejected = True
        renamed = path.with_name(f"{path.name}.corrupt")
        try:
            os.replace(path, renamed)
            outcome = f"renamed to {renamed.name}"
        except OSError as error:
            outcome = f"cannot be renamed: {error.strerror or error}"
        self._bus.issue("state_rejected", f"{path}: {reason}; {outcome}")


def _one_line(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return str(first_refused(error))
    return getattr(error, "strerror", None) or str(error)


def _bytes_of(content: str, name: str, vehicle: str) -> bytes:
    # Neither a name here nor that of a vehicle has a character that JSON escapes.
    text = f'"format": {FORMAT}, "name": "{name}", "vehicle": "{vehicle}", "content": {content}'
    hashed = text.encode()
    return b'{"sha256": "' + hashlib.sha256(hashed).hexdigest().encode() + b'", ' + hashed + b"}\n"


def _content_of(data: bytes, name: str, vehicle: str) -> str:
    """The content of a file's bytes; ValueError, one line, for any that `_bytes_of` has not made for this vehicle."""
    match = _FILE.fullmatch(data)
    if match is None:
        raise ValueError(f"sha256: expected a state file of format {FORMAT}")
    sha256, hashed, *envelope, content = match.groups()
    if hashlib.sha256(hashed).hexdigest().encode() != sha256:
        raise ValueError("sha256: differs from that of the contents")
    for field, got, expected in zip(
        ("format", "name", "vehicle"), envelope, (str(FORMAT), name, vehicle), strict=True
    ):
        if got != expected.encode():
            raise ValueError(f"{field}: expected {expected}, got {got.decode('utf-8', 'replace')[:64]}")
    return content.decode("utf-8")
