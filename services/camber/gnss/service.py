"""The process of gnss: bytes of a receiver, from the bus or its own port, become tentative positions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pydantic import ValidationError

from camber.formats.byte_streams import ByteStream, open_stream
from camber.formats.errors import FormatError
from camber.formats.nmea import NmeaDecoder
from camber.formats.receiver_solution import ReceiverSolution
from camber.formats.rtklib_pos import PosDecoder
from camber.gnss.receiver_side import fix_from, refuse
from camber.gnss.settings import GnssSettings
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.schemas.base import Message
from camber.schemas.gnss import Estimates, EstimatesRequest, ReceiverBytes

_SILENT_NS = 5_000_000_000


class GnssService(Service[GnssSettings]):
    """Every epoch once, in order; what cannot be read is counted and named."""

    NAME = "gnss"
    SETTINGS = GnssSettings

    def __init__(self, settings: GnssSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._decoders: dict[str, PosDecoder | NmeaDecoder] = {}
        self._left_out: set[str] = set()
        self._last_ns: int | None = None
        self._stream: ByteStream | None = None
        self._failures = self._lost_bytes = 0
        if settings.source != "bus":
            self._stream = open_stream(settings.source, arrived=bus.wake)

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs: the bus is read only where it is the source."""
        return {"receiver_bytes": self._hear} if self._stream is None else {}

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """A receiver's own solution has no other estimates: the judge is told so."""
        return {"estimates": lambda requests: [self._estimates(request) for request in requests]}

    def advance(self, now_ns: int) -> None:
        """Read what the stream has brought."""
        if self._stream is None:
            return
        if self._stream.failures > self._failures:
            self._failures = self._stream.failures
            self.bus.issue("source_lost", f"{self.settings.source}: {self._stream.problem}")
        if self._stream.lost_bytes > self._lost_bytes:
            self.bus.issue(
                "source_overflow", f"{self._stream.lost_bytes - self._lost_bytes} bytes came too fast"
            )
            self._lost_bytes = self._stream.lost_bytes
        data = self._stream.take()
        if data:
            self._feed(self.settings.protocol, data)

    def healthy(self) -> bool:
        """Are epochs coming?"""
        return self._last_ns is not None and self.bus.now_ns() - self._last_ns < _SILENT_NS

    def close(self) -> None:
        """Close the port."""
        if self._stream is not None:
            self._stream.close()

    def _hear(self, received: ReceiverBytes) -> None:
        if received.stream == "rover" and received.protocol in ("pos", "nmea"):
            self._feed(received.protocol, received.payload.tobytes())
        else:
            self._leave_out(f"{received.stream}.{received.protocol}")

    def _leave_out(self, what: str) -> None:
        """Counted; said once."""
        if what not in self._left_out:
            self._left_out.add(what)
            self.bus.issue("stream_not_used", f"{what}: expected rover.pos or rover.nmea")
        self.bus.count(f"not_used.{what}")

    def _feed(self, protocol: str, data: bytes) -> None:
        decoder = self._decoders.get(protocol)
        if decoder is None:
            name, date = self.settings.source, self.settings.nmea_date
            decoder = PosDecoder(name) if protocol == "pos" else NmeaDecoder(name, utc_date=date)
            self._decoders[protocol] = decoder
        for item in decoder.feed(data):
            if isinstance(item, FormatError):
                self.bus.issue("unreadable_input", str(item))
            else:
                self._publish(item)

    def _publish(self, solution: ReceiverSolution) -> None:
        refusal = refuse(solution.time_ns, self._last_ns, self.bus.now_ns())
        if refusal is not None:
            self.bus.issue(refusal, f"epoch {solution.time_ns} ns after {self._last_ns} ns")
            return
        try:
            fix = fix_from(solution, self.settings.datum)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            self.bus.issue("implausible_epoch", f"{'.'.join(map(str, first['loc']))}: {first['msg']}")
            return
        self._last_ns = solution.time_ns
        self.bus.publish("fix", fix)

    def _estimates(self, request: EstimatesRequest) -> Estimates:
        reason = "the receiver's own solution; there are no raw observations"
        return Estimates(time_ns=request.time_ns, fix_id=request.fix_id, status="unavailable", reason=reason)


SERVICE = GnssService
