"""An upload as a service gets it: with the vehicle in whose name it came."""

from __future__ import annotations

from typing import Any, NamedTuple


class ReceivedUpload(NamedTuple):
    """`vehicle` is that of the key, which access rules bind to a certificate; the message may name another one."""

    vehicle: str
    message: Any

    @property
    def time_ns(self) -> int:
        """That of the message, at which a replay answers."""
        return int(self.message.time_ns)
