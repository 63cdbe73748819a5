"""What a service uses of a bus, without one."""

from __future__ import annotations

from collections import Counter

NOW_NS = 1_400_000_000 * 1_000_000_000


class FakeBus:
    """Time that stands still until it is set, counters, and issues in their order."""

    def __init__(self, now_ns: int = NOW_NS) -> None:
        self.time_ns = now_ns
        self.issues: list[tuple[str, str]] = []
        self.counters: Counter[str] = Counter()

    def now_ns(self) -> int:
        return self.time_ns

    def issue(self, code: str, text: str) -> None:
        self.issues.append((code, text))

    def count(self, name: str, n: int = 1) -> None:
        self.counters[name] += n

    def codes(self) -> set[str]:
        return {code for code, _ in self.issues}

    def text(self, code: str) -> str:
        """The latest issue of a code."""
        return dict(self.issues)[code]
