"""Warnings of the receiver's own integrity monitoring that hold a fix back: spoofing, jamming, failed RAIM.

Statements come in parts, each sentence with one of them; an unknown part and an outdated one change nothing.
A receiver that reports no problem makes no fix better: testing is the judge's task.
"""

from __future__ import annotations

from camber.schemas.gnss import ReceiverIntegrity

_WARNINGS: dict[str, frozenset[str]] = {
    "spoofing": frozenset({"indicated", "affirmed"}),
    "jamming": frozenset({"critical"}),
    "raim": frozenset({"failed"}),
}


class ReceiverIntegrityMonitor:
    """The newest known state of each part that can warn, with its time."""

    def __init__(self) -> None:
        self._states: dict[str, tuple[int, str]] = {}

    def update(self, statement: ReceiverIntegrity) -> None:
        """Take one statement; parts that it does not know, and older ones, leave the state as it is."""
        for name in _WARNINGS:
            state, known = getattr(statement, name), self._states.get(name)
            if state != "unknown" and (known is None or statement.time_ns >= known[0]):
                self._states[name] = (statement.time_ns, state)

    def warning(self, at_ns: int, max_age_s: float) -> str | None:
        """Return the current warnings, None where there are none within the age limit."""
        warnings = [
            f"{name} {state}"
            for name, (time_ns, state) in self._states.items()
            if state in _WARNINGS[name] and abs(at_ns - time_ns) <= max_age_s * 1e9
        ]
        return ", ".join(warnings) or None

    def forget_after(self, limit_ns: int) -> None:
        """Drop what is dated later than this: the clock was set back."""
        self._states = {name: state for name, state in self._states.items() if state[0] <= limit_ns}
