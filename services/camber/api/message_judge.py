"""The judge without a bus: messages go in, verdicts and positions come out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

from camber.integrity.service import IntegrityService
from camber.integrity.settings import IntegritySettings
from camber.replay.local_bus import LocalBus
from camber.replay.service_settings import validated_settings
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.clock import ReplayClock
from camber.schemas.antenna import AntennaHeight
from camber.schemas.base import Message
from camber.schemas.channels import inputs_of
from camber.schemas.gnss import Estimates, EstimatesRequest, Fix
from camber.schemas.integrity import Position, Verdict
from camber.schemas.pose import Pose

_ABSENT = frozenset({"map_update"})
"""All others are taken to be there: how old their messages are is judged anyway."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgements:
    """What one step of the judge has published: verdicts, positions, and the issues that it has reported."""

    verdicts: tuple[Verdict, ...] = ()
    positions: tuple[Position, ...] = ()
    issues: tuple[str, ...] = ()


class MessageJudge:
    """The service `integrity` in this process, with nothing kept on disk and nothing uploaded.

    `settings` are those of the service (docs/services/integrity.md); neither environment nor files change them.
    `estimates` answers requests for other estimates of a fix, as the service `gnss` does; None: nobody answers.
    Raises ValueError for a setting that cannot be.
    """

    def __init__(
        self,
        settings: Mapping[str, Any] | None = None,
        *,
        estimates: Callable[[EstimatesRequest], Estimates] | None = None,
    ) -> None:
        table = {"clock": "replay", **(settings or {}), "upload": False, "state_dir": None}
        kept = validated_settings("integrity", IntegritySettings, table)
        self._output = _JudgeOutput(estimates)
        self._service = IntegrityService(kept, cast(Bus, LocalBus(self._output, IntegrityService.NAME)))
        self._handlers = {
            channel.message: self._service.handlers()[channel.name]
            for channel in inputs_of(IntegrityService.NAME)
            if channel.name in self._service.handlers()
        }

    def add(self, message: Message) -> None:
        """Take a fix, a pose with the road, an antenna height, a velocity, motion or a warning of the receiver.

        Messages of one kind come in the order of time. Raises TypeError for any other message.
        """
        handler = self._handlers.get(type(message))
        if handler is None:
            expected = ", ".join(sorted(kind.__name__ for kind in self._handlers))
            raise TypeError(f"a message {type(message).__name__}, expected one of {expected}")
        handler(message)

    def advance(self, time_ns: int) -> Judgements:
        """Judge what can be judged at this GPS time; a fix waits 0.1 s of it for the pose of its epoch.

        To be called at least ten times a second of the messages' time. Where inputs are missing or too old, verdict
        and position say so.
        """
        self._output.clock.set(time_ns)
        self._service.advance(time_ns)
        return self._output.take()


def judge(
    fix: Fix, *, pose: Pose, antenna_height: AntennaHeight, settings: Mapping[str, Any] | None = None
) -> Verdict:
    """Return the verdict on one fix that nothing precedes, with the pose of its epoch and the road that this has.

    The evidence of a sequence (start, learning, verification by the fixes before) needs a `MessageJudge`, which is
    `camber.Judge`.
    """
    one = MessageJudge(settings)
    one.add(pose)
    one.add(antenna_height)
    one.add(fix)
    # A fix without a pose near it is judged when it has waited for one.
    for time_ns in (fix.time_ns, fix.time_ns + _WAIT_NS):
        for verdict in one.advance(time_ns).verdicts:
            if verdict.fix_id is not None:
                return verdict
    raise AssertionError("every fix is judged when it has waited")


_WAIT_NS = 200_000_000
"""Twice what a fix waits for its pose (`rules.SAME_EPOCH_S`)."""


class _JudgeOutput:
    """Collects what the service publishes."""

    def __init__(self, estimates: Callable[[EstimatesRequest], Estimates] | None) -> None:
        self.clock = ReplayClock()
        self._estimates = estimates
        self._verdicts: list[Verdict] = []
        self._positions: list[Position] = []
        self._issues: list[str] = []

    def take(self) -> Judgements:
        """What has come since the last time."""
        verdicts, positions, issues = tuple(self._verdicts), tuple(self._positions), tuple(self._issues)
        for messages in (self._verdicts, self._positions, self._issues):
            messages.clear()
        return Judgements(verdicts=verdicts, positions=positions, issues=issues)

    def publish(self, source: str, name: str, message: Message) -> None:
        match message:
            case Verdict():
                self._verdicts.append(message)
            case Position():
                self._positions.append(message)

    def ask(self, name: str, request: Message) -> Any:
        if self._estimates is None or not isinstance(request, EstimatesRequest):
            raise QueryFailed("absent", name)
        return self._estimates(request)

    def is_kept(self, name: str) -> bool:
        return True

    def is_running(self, name: str) -> bool:
        return name not in _ABSENT

    def report(self, service: str, time_ns: int, code: str, text: str) -> None:
        self._issues.append(f"{code}: {text}")
