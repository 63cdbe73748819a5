"""A bus without one for the GNSS service: what it published, in order."""

from __future__ import annotations

from collections import Counter

from camber.schemas.base import Message
from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from support.fake_bus import FakeBus


class GnssBus(FakeBus):
    def __init__(self, now_ns: int = 0) -> None:
        super().__init__(now_ns)
        self.published: list[Message] = []

    @property
    def fixes(self) -> list[Fix]:
        return [message for message in self.published if isinstance(message, Fix)]

    def publish(self, name: str, message: Message) -> None:
        encode(message)
        self.published.append(message)

    def wake(self) -> None:
        pass

    def named(self) -> dict[str, str]:
        """Last text by code."""
        return dict(self.issues)

    def counted(self) -> Counter[str]:
        """Issues by code."""
        return Counter(code for code, _ in self.issues)

    def qualities(self) -> list[str]:
        return [fix.quality for fix in self.fixes]
