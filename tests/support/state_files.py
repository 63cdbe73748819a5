"""Files of what services have learnt, as a service of a vehicle writes and reads them."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from camber.runtime.bus import Bus
from camber.runtime.settings import ServiceSettings
from camber.runtime.state_file import StateFile
from support.fake_bus import FakeBus


def state_file(folder: Path, name: str, *, vehicle: str = "vehicle", bus: FakeBus | None = None) -> StateFile:
    settings = ServiceSettings(vehicle=vehicle, state_dir=folder)
    return StateFile(name, settings=settings, bus=cast(Bus, bus or FakeBus()))


def write_state(folder: Path, name: str, content: str, *, vehicle: str = "vehicle") -> Path:
    """Write a whole file; returns where it is."""
    assert state_file(folder, name, vehicle=vehicle).save(content)
    return folder / f"{name}.json"


def content_of(folder: Path, name: str, *, vehicle: str = "vehicle") -> str:
    """The content of a whole file."""
    content = state_file(folder, name, vehicle=vehicle).load(str)
    assert content is not None
    return content
