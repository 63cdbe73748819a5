"""What a service is to the runtime: handlers of inputs, answers to questions, a step in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from camber.runtime.bus import Bus
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message

S = TypeVar("S", bound=ServiceSettings)


class Service(Generic[S]):
    """Base of the services. All methods are called in the work loop, in one thread.

    A service wires: it hands values to pure modules and publishes what they return. It reads time from `bus.now_ns()`
    or the messages, never from the machine.
    """

    NAME: ClassVar[str]
    SETTINGS: ClassVar[type[ServiceSettings]]

    @classmethod
    def prepare(cls, settings: S) -> None:
        """What takes long and must be done before anybody can see, or wait for, this service."""

    @classmethod
    def compiled_functions(cls, settings: S) -> int:
        """Number of compiled functions that `prepare` reads from disk, or compiles at the first start."""
        return 0

    @classmethod
    def state_folder(cls, settings: S) -> Path | None:
        """Folder that only one process of this service may use; None: there is none, or several may."""
        return settings.state_dir

    def __init__(self, settings: S, bus: Bus) -> None:
        self.settings = settings
        self.bus = bus

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Channel name → handler of its messages; they are fresh, valid and in order."""
        return {}

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Query channel → function from all questions waiting to their replies; None: no answer, ask again."""
        return {}

    def advance(self, now_ns: int) -> None:
        """All inputs up to `now_ns` have been handled."""

    def healthy(self) -> bool:
        """Does the service do its work? False shows as `degraded`."""
        return True

    def gauges(self) -> dict[str, float]:
        """What goes up and down: name, ending in its unit, → value now; for health and metrics, so it must be quick."""
        return {}

    def facts(self) -> dict[str, str]:
        """What the service works with, in words: name → text, as `map_release`."""
        return {}

    def close(self) -> None:
        """The service ends; the bus is still open."""
