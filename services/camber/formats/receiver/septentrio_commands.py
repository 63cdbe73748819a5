"""Commands of Septentrio receivers as text, and their replies among the binary blocks of a port.

Source: Septentrio mosaic-X5, Reference Guide, chapter "Command Line Reference": a reply begins with `$R:` (done), `$R;`
(done, more lines) or `$R?` (refused), has a line for each setting, and ends with the prompt, which names the port.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_REPLY = re.compile(rb"\$R([:;?!])[ ]?([^\r\n]*)((?:\r\n[^\r\n]*)*?)\r\n([A-Z]{2,4}\d{1,2})>")
_PERIODS_MS = (10, 20, 40, 50, 100, 200, 500)
"""Shorter than a second, as `msec` and the number (setSBFOutput)."""
RAW_BLOCKS = frozenset({"MeasEpoch"})
POSITION_BLOCKS = frozenset({"PVTGeodetic", "PosCovGeodetic", "EndOfPVT"})
INTEGRITY_BLOCKS = frozenset({"RFStatus", "GALAuthStatus"})
EPHEMERIS_BLOCKS = frozenset({"GPSNav", "GPSIon", "GALNav", "BDSNav", "QZSNav", "GLONav"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SeptentrioReply:
    """What a receiver answers: the lines of the settings, or why it refuses; and the port it answers on."""

    accepted: bool
    text: str
    lines: tuple[str, ...]
    port: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SeptentrioSetting:
    """A setting with the command that asks for it, that sets it, and its values in the reply, in any order within +."""

    ask: str
    command: str
    values: tuple[str, ...]

    def is_met(self, reply: SeptentrioReply) -> bool:
        """Whether a line of the reply has these values; what follows them does not count."""
        return any(self._agrees(line) for line in reply.lines)

    def _agrees(self, line: str) -> bool:
        fields = [frozenset(field.strip().split("+")) for field in line.split(",")]
        wanted = [frozenset(value.split("+")) for value in self.values]
        return fields[: len(wanted)] == wanted


def parse_reply(data: bytes) -> SeptentrioReply | None:
    """Return the first whole reply in a stream; None where there is none yet."""
    match = _REPLY.search(data)
    if match is None:
        return None
    kind, first, rest, port = match.groups()
    lines = tuple(line.strip() for line in rest.decode("ascii", "replace").split("\r\n") if line.strip())
    return SeptentrioReply(
        accepted=kind in b":;", text=first.decode("ascii", "replace"), lines=lines, port=port.decode("ascii")
    )


def wanted_settings(port: str, rate_hz: int, *, raw: bool) -> list[SeptentrioSetting]:
    """Return what Camber needs at a port: raw observations, or positions; with integrity reports once a second.

    Raises ValueError for a rate that the receiver does not have.
    """
    period_ms = 1000 // rate_hz
    if rate_hz != 1 and (period_ms not in _PERIODS_MS or 1000 % rate_hz):
        raise ValueError(f"{rate_hz} Hz, expected one of 1, 2, 5, 10, 20, 25, 50 and 100")
    interval = "sec1" if rate_hz == 1 else f"msec{period_ms}"
    streams = [(RAW_BLOCKS if raw else POSITION_BLOCKS, interval), (INTEGRITY_BLOCKS, "sec1")]
    if raw:
        streams.append((EPHEMERIS_BLOCKS, "OnChange"))
    settings = [
        _setting("DataInOut", (port, "auto", "SBF")),
        _setting("ReceiverDynamics", ("Moderate", "Automotive")),
    ]
    for number, (blocks, every) in enumerate(streams, start=1):
        settings.append(_setting("SBFOutput", (f"Stream{number}", port, "+".join(sorted(blocks)), every)))
    return settings


def keep_command() -> str:
    """Return the command that keeps the settings without power."""
    return "exeCopyConfigFile, Current, Boot"


def _setting(name: str, values: tuple[str, ...]) -> SeptentrioSetting:
    asks_for = f", {values[0]}" if name != "ReceiverDynamics" else ""
    return SeptentrioSetting(
        ask=f"get{name}{asks_for}", command=f"set{name}, {', '.join(values)}", values=(name, *values)
    )
