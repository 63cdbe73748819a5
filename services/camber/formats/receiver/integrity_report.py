"""The receiver's integrity reports of several messages, combined into one `ReceiverIntegrity` message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.gnss import ReceiverIntegrity

_VALID_NS = 2 * NS_PER_SECOND  # chosen: two epochs at 1 Hz, the lowest rate of these messages
JAMMING = ("unknown", "none", "warning", "critical")
"""From the least to the worst state, by u-blox' numbers."""


class IntegrityReport:
    """The last report of each kind. Each is valid for two seconds at most, then unknown."""

    def __init__(self) -> None:
        self._reports: dict[str, tuple[int, Mapping[str, Any]]] = {}

    def update(self, kind: str, time_ns: int, fields: Mapping[str, Any]) -> None:
        """Replace the report of a kind by these fields of `ReceiverIntegrity`."""
        self._reports[kind] = time_ns, fields

    def at(self, time_ns: int) -> list[ReceiverIntegrity]:
        """Return all valid reports, with the worst of several states of jamming; nothing at times out of range."""
        if not EARLIEST_NS <= time_ns <= LATEST_NS:
            return []
        self._reports = {k: r for k, r in self._reports.items() if abs(time_ns - r[0]) <= _VALID_NS}
        fields = dict[str, Any]()
        for _, content in self._reports.values():
            worst = max((each.get("jamming", "unknown") for each in (fields, content)), key=JAMMING.index)
            fields |= {**content, "jamming": worst}
        return [ReceiverIntegrity(time_ns=time_ns, **fields)]
