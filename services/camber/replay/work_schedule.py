"""Which services work on a tick of a replay: those that something reaches, and all of them once a second."""

from __future__ import annotations

from camber.schemas.channels import SERVICES, inputs_of

HEARTBEAT_NS = 1_000_000_000
"""All services work at least this often. Chosen: what a service does by time alone (stale inputs, uploads, a
re-estimation that is due) is judged in seconds."""

_TRIGGERS = {
    service: {
        channel.name if channel.producers == ("vehicle",) else channel.producers[0]
        for channel in inputs_of(service)
        if not channel.looped
    }
    for service in SERVICES
}
"""What makes a service work: a message on a channel of the vehicle, or a service before it that works."""


class WorkSchedule:
    """Decides for each tick which services work on it, from the table of channels alone."""

    def __init__(self) -> None:
        self._fed: set[str] = set()
        self._heartbeat_ns = 0

    def add(self, channel: str) -> None:
        """A message of the vehicle belongs to the next tick."""
        self._fed.add(channel)

    def wake_all(self) -> None:
        """Let all services work on the next tick: one has just joined, and starts with what it needs."""
        self._heartbeat_ns = 0

    def next_tick(self, time_ns: int, *, last: bool) -> frozenset[str]:
        """Return who works on the tick at `time_ns`, and begin the one after it."""
        fed, self._fed = self._fed, set()
        if last or time_ns - self._heartbeat_ns >= HEARTBEAT_NS:
            self._heartbeat_ns = time_ns
            return frozenset(SERVICES)
        working: set[str] = set()
        for service in SERVICES:  # in the order of work
            if _TRIGGERS[service] & (fed | working):
                working.add(service)
        return frozenset(working)
