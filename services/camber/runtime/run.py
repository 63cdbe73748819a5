"""Run a service: read settings, join the bus, work until asked to stop, leave.

Exit codes: 0 stopped as asked, 2 settings are wrong or the folder of state is in use, 3 the bus could not be joined, 70
the work loop failed. Ended by SIGALRM: the work loop did not end within two seconds of being asked to.
"""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

import zenoh

from camber.compiled.compilation_progress import CompilationProgress, watched_by
from camber.runtime.bus import Bus
from camber.runtime.clock import ReplayClock, SystemClock
from camber.runtime.health.report import HealthReporter
from camber.runtime.inbox import Inbox
from camber.runtime.log import make_logger
from camber.runtime.service import Service
from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ServiceSettings, load_or_exit
from camber.runtime.state_lock import FolderInUseError, locked
from camber.runtime.uploads.received_upload import ReceivedUpload
from camber.schemas.channels import BY_NAME, Channel, inputs_of
from camber.schemas.codec import DecodeError, decode
from camber.schemas.health import Health, LogLevelReply, LogLevelRequest

if TYPE_CHECKING:
    from camber.runtime.health.metrics import HealthCollector, MetricsServer

STOP_LIMIT_S = 2.0  # chosen: a stopping service ends within this time
_SAY_EVERY_S = 1.0  # chosen: period of updates of the metrics
_JOINING_S, _WAITS_AGAIN_S = 2.0, 60.0


class Loop:
    """The one thread in which a service works, by the machine's clock.

    A replay in lock step derives from it (`camber.replay.lock_step`) and works by the ticks of a feeder instead.
    """

    def __init__(
        self,
        service: Service[Any],
        bus: Bus,
        clock: SystemClock | ReplayClock,
        collector: HealthCollector | None = None,
    ) -> None:
        self.service = service
        self.bus = bus
        self.stopping = False
        self._clock = clock
        self._handlers = service.handlers()
        self._answers = service.answers()
        self._inboxes = {c.name: Inbox(channel=c.received_by(service.NAME)) for c in self.inputs()}
        self._report = HealthReporter(service, bus)
        self._of_itself = {"health": self._healths, "log_level": self._log_levels}
        self._collector = collector
        self._say_at_s = 0.0

    def inputs(self) -> tuple[Channel, ...]:
        """Return the channels to subscribe to: those that the service handles."""
        return tuple(c for c in inputs_of(self.service.NAME) if c.name in self._handlers)

    def subscribe(self) -> None:
        """Subscribe to all inputs."""
        for name in self._inboxes:
            self.bus.subscribe(BY_NAME[name])

    def declare(self) -> None:
        """Subscribe to all inputs, answer all queries, then declare this service alive."""
        self.subscribe()
        for name in self._answers:
            self.bus.answer(BY_NAME[name])
        for name in self._of_itself:
            self.bus.answer(BY_NAME[name])
        self.bus.announce()

    def work(self) -> None:
        """Work by the clock until stopped: handle what arrives, advance at least every period."""
        period_s = self.service.settings.period_s
        deadline = time.monotonic() + period_s
        while not self.stopping:
            event = self.bus.next_event(max(deadline - time.monotonic(), 0.0))
            # More may come than can be handled: what is due by the clock is done all the same. Where that itself takes
            # a period or more, there is one for what has come: each round leaves less behind than it has found.
            worked, until = False, max(deadline, time.monotonic() + period_s)
            while event is not None and not self.stopping:
                worked |= self._event(event)
                event = self.bus.next_event(0.0) if time.monotonic() < until else None
            now = time.monotonic()
            if worked or now >= deadline:
                self._report.came_late(max(now - deadline, 0.0))
                self._guard(self.service.advance, self._clock.now_ns())
                deadline = now + period_s
            self._round_ended()

    def _round_ended(self) -> None:
        self._report.round_ended()
        self.bus.restore_log_level()
        self.bus.check_access()
        now = time.monotonic()
        if self._collector is not None and now >= self._say_at_s:
            self._say_at_s = now + _SAY_EVERY_S
            self._collector.say(self.health())

    def _event(self, event: tuple[str, str]) -> bool:
        kind, name = event
        if kind == "query":
            self.answer(name)
            return False
        if kind != "message":
            return kind == "wake"  # bytes have come at a port of the service's own
        item = self.bus.pop(name)
        inbox = self._inboxes[name]
        received = inbox.open(item.data, item.encoding) if item else None
        message = None
        if item and received:
            message = inbox.accept(received, self._clock.now_ns(), arrival=item.arrival)
        if message is not None:
            self._guard(self._handlers[name], message)
            return True
        if item:
            self.refused(inbox)
        return False

    def refused(self, inbox: Inbox) -> None:
        """Report what an inbox did not hand out."""
        for reason, n in inbox.refused.items():
            self.bus.counters[f"{inbox.channel.name}.{reason}"] = n
        text = f"{inbox.channel.name}: {inbox.last_detail}"
        if inbox.last_reason == "two_producers":
            self.bus.issue("two_producers", text)
        else:
            self.bus.issue("refused_input", text)

    def answer(self, name: str) -> None:
        """Answer all questions waiting on a channel; whatever happens, each query is closed."""
        channel = BY_NAME[name]
        asked: list[tuple[zenoh.Query, Any]] = []
        for query in self.bus.pop_queries(name):
            request = self._request(channel, query)
            if request is not None:
                asked.append((query, request))
        if not asked:
            return
        requests = [request for _, request in asked]
        answer = self._of_itself.get(name)
        replies: Any = self._replies(name, requests) if answer is None else answer(requests)
        for (query, _), reply in zip(asked, replies or [None] * len(asked), strict=True):
            with query:
                try:
                    if reply is None:
                        query.reply_err(b"failed; ask again")
                    else:
                        self.bus.reply(query, reply)
                except zenoh.ZError as error:  # the asker has gone
                    self.bus.issue("reply_failed", str(error))

    def _replies(self, name: str, requests: list[Any]) -> Any:
        return self._guard(self._answers[name], requests)

    def _request(self, channel: Channel, query: zenoh.Query) -> Any:
        payload = query.payload
        uploads = channel.delivery == "upload"
        try:
            if payload is None:
                raise DecodeError("a question without a payload")
            message = decode(channel.message, payload.to_bytes(), str(query.encoding)).message
            # What a vehicle's certificate vouches for is the key; the service compares it with the payload.
            return ReceivedUpload(channel.vehicle_in(str(query.key_expr)), message) if uploads else message
        except ValueError as error:  # a DecodeError, or a key that names no vehicle
            self.bus.issue("refused_question", f"{channel.name}: {error}")
            with query:
                query.reply_err(str(error)[:200].encode())
            return None

    def health(self) -> Health:
        """How this service is, as its own work loop sees it; whatever it has met, it can say so."""
        healthy = self._guard(lambda _: bool(self.service.healthy()), None)
        gauges = self._guard(lambda _: self.service.gauges(), None)
        facts = self._guard(lambda _: self.service.facts(), None)
        return self._report.health(healthy, gauges or {}, facts or {})

    def _healths(self, requests: list[Any]) -> list[Health]:
        return [self.health()] * len(requests)

    def _log_levels(self, requests: list[LogLevelRequest]) -> list[LogLevelReply]:
        before = self.bus.log_level
        last = requests[-1]
        self.bus.set_log_level(last.level, last.for_s)
        self.bus.log.warning("log_level", level=last.level, for_s=last.for_s, before=before)
        return [
            LogLevelReply(
                time_ns=request.time_ns,
                service=self.service.NAME,
                level=last.level,
                for_s=last.for_s,
                before=before,
            )
            for request in requests
        ]

    def _guard(self, function: Any, argument: Any) -> Any:
        """A fault while working on one input must not end the service; it makes it `failing`, visibly."""
        try:
            return function(argument)
        except Exception as error:
            self._report.failed += 1
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{os.path.basename(last.filename)}:{last.lineno}"
            self.bus.issue("internal_error", f"{type(error).__name__} in {where}: {error}")
            self.bus.log.debug("internal_error", trace=traceback.format_exc())
            return None


def run(service_class: type[Service[Any]], argv: list[str] | None = None) -> int:
    """Run one service until SIGTERM or SIGINT; returns the exit code."""
    prog = f"camber {service_class.NAME}"
    settings: ServiceSettings = load_or_exit(
        service_class.SETTINGS, sys.argv[1:] if argv is None else argv, prog=prog
    )
    try:
        with locked(service_class.state_folder(settings), service_class.NAME):
            return _run_with(service_class, settings, prog)
    except FolderInUseError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return 2


def _run_with(service_class: type[Service[Any]], settings: ServiceSettings, prog: str) -> int:
    clock = ReplayClock() if settings.clock == "replay" else SystemClock()
    collector, metrics, hindrance = _metrics(settings, service_class.NAME)
    with _compilation_logged(settings, service_class):
        service_class.prepare(settings)
    try:
        with _saying_that_it_waits(settings, service_class.NAME):
            session = open_session(settings.zenoh)
    except BusError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return 3
    bus_class, loop_class = _host_classes(settings)
    bus = bus_class(session, settings, service_class.NAME, clock)
    if hindrance:
        bus.issue("metrics_not_served", hindrance)
    if metrics is not None:
        bus.log.info("metrics", host=settings.metrics_host, port=metrics.port)
    code = 70
    loop: Loop | None = None
    try:
        loop = loop_class(service_class(settings, bus), bus, clock, collector)
        # What is there now stays as long as the process; to look through it all would stop the work for some 50 ms.
        gc.collect()
        gc.freeze()
        _stop_on_signal(loop)
        bus.log.info("started", clock=settings.clock, vehicle=settings.vehicle)
        loop.declare()
        loop.work()
        code = 0
    except Exception:
        bus.log.error("work_loop_failed", trace=traceback.format_exc())
    finally:
        if loop is not None:
            loop.stopping = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _end_within(STOP_LIMIT_S, code)
        try:
            if loop is not None:
                loop.service.close()
        except Exception:
            code = 70
            bus.log.error("close_failed", trace=traceback.format_exc())
        if metrics is not None:
            metrics.close()
        bus.log.info("stopped", code=code, cpu_s=round(time.process_time(), 2))
        bus.close()
    return code


def _host_classes(settings: ServiceSettings) -> tuple[type[Bus], type[Loop]]:
    """Return the bus and the work loop; those of a replay in lock step are loaded only where it is asked for."""
    if settings.clock != "replay":
        return Bus, Loop
    lock_step = importlib.import_module("camber.replay.lock_step.service_loop")
    return lock_step.LockStepBus, lock_step.LockStepLoop


@contextmanager
def _compilation_logged(settings: ServiceSettings, service_class: type[Service[Any]]) -> Iterator[None]:
    """Log one line before functions are compiled, which takes up to a minute after installation."""

    def begin(functions: int | None) -> None:
        log = make_logger(service_class.NAME, level=settings.log_level, form=settings.log_format)
        log.info("compiles", functions=functions)

    expected = service_class.compiled_functions(settings)
    with watched_by(CompilationProgress(expected=expected, begin=begin, advance=lambda: None)):
        yield


@contextmanager
def _saying_that_it_waits(settings: ServiceSettings, service: str) -> Iterator[None]:
    """To join the bus may take for ever, and must not do so in silence."""
    joined = threading.Event()

    def say() -> None:
        pause_s = _JOINING_S
        while not joined.wait(pause_s):
            log = make_logger(service, level=settings.log_level, form=settings.log_format)
            log.warning("waits_for_the_bus", connect=settings.zenoh.connect)
            pause_s = _WAITS_AGAIN_S

    threading.Thread(target=say, name="joining", daemon=True).start()
    try:
        yield
    finally:
        joined.set()


def _metrics(
    settings: ServiceSettings, service: str
) -> tuple[HealthCollector | None, MetricsServer | None, str]:
    """What the loop speaks to, who serves it, and what hinders that: nothing a service should not start for."""
    if settings.metrics_port is None:
        return None, None, ""
    from camber.runtime.health.metrics import HealthCollector, MetricsServer

    collector = HealthCollector(service, settings.vehicle)
    try:
        return collector, MetricsServer(settings.metrics_host, settings.metrics_port, collector), ""
    except OSError as error:
        where = f"{settings.metrics_host}:{settings.metrics_port}"
        return None, None, f"{where}: {error.strerror or error}"


def _stop_on_signal(loop: Loop) -> None:
    def stop(number: int, frame: FrameType | None) -> None:
        if not loop.stopping:  # no thread: the handler may have come in the midst of starting another one
            signal.setitimer(signal.ITIMER_REAL, STOP_LIMIT_S)
        loop.stopping = True
        loop.bus.wake()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)


def _end_within(limit_s: float, code: int) -> None:
    """A session that does not close must not keep the process: end it after the limit."""
    timer = threading.Timer(limit_s, os._exit, [code])
    timer.daemon = True
    timer.start()
