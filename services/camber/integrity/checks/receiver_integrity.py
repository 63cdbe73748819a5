"""What the receiver says of its own integrity, as far as it holds a fix back: it warns, or it says nothing.

Statements come in parts, each sentence telling of one thing; a part that is not known, and one that is old, takes
back nothing and adds nothing. A receiver that finds nothing wrong makes no fix any better: that is our own business.
"""

from __future__ import annotations

from camber.schemas.gnss import ReceiverIntegrity

_WARNINGS: dict[str, frozenset[str]] = {
    "spoofing": frozenset({"indicated", "affirmed"}),
    "jamming": frozenset({"critical"}),
    "raim": frozenset({"failed"}),
}


class ReceiverIntegrityMonitor:
    """The newest known statement on each thing that can warn, with its time."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[int, str]] = {}

    def update(self, statement: ReceiverIntegrity) -> None:
        """One more; what it does not know leaves the word before it, and so does one that is older."""
        for name in _WARNINGS:
            word = getattr(statement, name)
            said = self._said.get(name)
            if word != "unknown" and (said is None or statement.time_ns >= said[0]):
                self._said[name] = (statement.time_ns, word)

    def warning(self, at_ns: int, max_age_s: float) -> str | None:
        """What the receiver warns of at a time, None where it does not, or not lately."""
        warned = [
            f"{name} {word}"
            for name, (time_ns, word) in self._said.items()
            if word in _WARNINGS[name] and abs(at_ns - time_ns) <= max_age_s * 1e9
        ]
        return ", ".join(warned) or None

    def forget_after(self, limit_ns: int) -> None:
        """The clock was set back: nothing can have been said later than this."""
        self._said = {name: said for name, said in self._said.items() if said[0] <= limit_ns}
