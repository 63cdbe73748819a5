"""GNSS receiver adapter: bytes of a receiver and a base station, from the bus or from ports → candidate fixes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.formats.nmea.writer import format_gga
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.candidates.engine_candidates import (
    fix_from_solution,
    observations_from,
    velocity_from,
)
from camber.gnss.candidates.receiver_candidates import fix_from, refuse
from camber.gnss.candidates.satellites_in_view import satellites_from, satellites_from_report
from camber.gnss.candidates.subset_agreement import subset_agreement
from camber.gnss.observations.base_coordinate_history import BaseMemory, memory_as_text, memory_from_text
from camber.gnss.observations.base_move_detection import BaseWatch
from camber.gnss.observations.receiver_streams import Stream, StreamItem, StreamProtocol, StreamReader
from camber.gnss.observations.rover import Rover, SolvedEpoch
from camber.gnss.position.engine_warnings import EngineWarnings
from camber.gnss.position.satellite_use import satellite_columns
from camber.gnss.settings import GnssSettings
from camber.gnss.warm_up import CARRIED_FUNCTIONS, FUNCTIONS, READER_FUNCTIONS, compile_readers, warm_up
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.state_file import StateFile
from camber.schemas.base import Message
from camber.schemas.gnss import Estimates, EstimatesRequest, Fix, ReceiverBytes, ReceiverIntegrity
from camber.schemas.refused_field import first_refused
from camber.transport.byte_streams import ByteStream, open_stream
from camber.transport.ntrip_client import NtripAccess

M = TypeVar("M", bound=Message)
_SILENT_NS = 5_000_000_000  # chosen: health is degraded after so long without an epoch
_END_OF_FILE_NS = 1_000_000_000  # chosen: a file is complete when nothing came for so long
_EPOCH_JITTER_NS = (
    10_000_000  # chosen: a receiver's clock is within milliseconds of its epochs' nominal times
)
_CLOCK_WAS_SET_NS = 24 * 3600 * NS_PER_SECOND  # less than the half week that resolves the week number
_WEEKLESS = ("ubx", "rtcm", "mixed")


class _StreamPort:
    """A port of this service, and how much of its failures has been reported."""

    def __init__(self, stream: Stream, protocol: StreamProtocol, name: str, port: ByteStream) -> None:
        self.stream, self.protocol, self.name, self.port = stream, protocol, name, port
        self.failures = self.lost_bytes = 0


class GnssService(Service[GnssSettings]):
    """Publishes every epoch once, in order; unreadable input is counted and reported."""

    NAME = "gnss"
    SETTINGS = GnssSettings

    @classmethod
    def prepare(cls, settings: GnssSettings) -> None:
        """Compile everything that is used."""
        compile_readers()
        if settings.positions == "engine":
            warm_up(carried=settings.engine.ambiguities == "carried")

    @classmethod
    def compiled_functions(cls, settings: GnssSettings) -> int:
        """Those of the readers, and with raw observations those of the engine."""
        if settings.positions != "engine":
            return READER_FUNCTIONS
        return FUNCTIONS if settings.engine.ambiguities == "carried" else FUNCTIONS - CARRIED_FUNCTIONS

    def __init__(self, settings: GnssSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._readers: dict[tuple[Stream, StreamProtocol], StreamReader] = {}
        self._fed_ns: dict[tuple[Stream, StreamProtocol], int] = {}
        self._damage: dict[StreamReader, dict[str, int]] = {}
        self._bases_file = StateFile("bases", settings=settings, bus=bus)
        self._rover = self._make_rover() if self._solves else None
        self._satellites_ns = 0
        self._masks = settings.engine.masks()
        self._criteria = settings.engine.fix_criteria() if settings.engine.subset_agreement else None
        self._last_ns: int | None = None
        self._last_fix: Fix | None = None
        self._warnings = EngineWarnings()
        self._left_out: set[str] = set()
        self._ports = self._open_ports()

    @property
    def _solves(self) -> bool:
        return self.settings.positions == "engine"

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs; bytes from the bus where it is the source of one of the streams."""
        handlers: dict[str, Callable[[Any], None]] = {}
        if "bus" in (self.settings.source, self.settings.base_source):
            handlers["receiver_bytes"] = self._receive
        if self._rover is not None:
            handlers["motion"] = self._rover.receive_motion
        return handlers

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Re-estimation; not available for a receiver's solution."""
        return {"estimates": lambda requests: [self._estimates(request) for request in requests]}

    def advance(self, now_ns: int) -> None:
        """Read the ports, base and ephemerides first; solve."""
        for port in self._ports:
            self._read(port)
        if self._rover is None:
            return
        for key in [key for key, fed_ns in self._fed_ns.items() if now_ns - fed_ns > _END_OF_FILE_NS]:
            self._dispatch(self._readers[key].fell_silent())
        for epoch in self._rover.take_pending():
            if not self._is_refused(epoch.time_ns):
                self._publish_solved(self._rover.solve(epoch))
        for code, text in self._warnings.new(self._rover.engine):
            self.bus.issue(code, text)
        self._save_bases(self._rover.bases.memory)

    def healthy(self) -> bool:
        """Whether epochs arrive."""
        return self._last_ns is not None and self.bus.now_ns() - self._last_ns < _SILENT_NS

    def close(self) -> None:
        """Close the ports."""
        for port in self._ports:
            port.port.close()

    def _make_rover(self) -> Rover:
        settings = self.settings
        source = settings.base_source if settings.base_source is not None else settings.source
        mount = source.partition("://")[2] or source
        memory = self._bases_file.load(memory_from_text) or BaseMemory()
        bases = BaseWatch(memory, mount[:300], settings.confirmed_bases)
        return Rover(settings.engine, settings.base_ecef_m, bases)

    def _save_bases(self, memory: BaseMemory) -> None:
        if self._bases_file.path is None or not memory.changed:
            return
        memory.changed = False
        self._bases_file.save(memory_as_text(memory.bases))

    def _open_ports(self) -> list[_StreamPort]:
        settings = self.settings
        password = settings.ntrip_password
        access = NtripAccess(
            user=settings.ntrip_user,
            password=None if password is None else password.get_secret_value(),
            version=settings.ntrip_version,
            ca_file=settings.ntrip_ca_file,
            position=self._gga,
            position_interval_s=settings.position_interval_s,
        )
        wanted: list[tuple[Stream, StreamProtocol, str | None]] = [
            ("base", settings.base_protocol, settings.base_source),
            ("rover", settings.protocol, settings.source),
        ]
        return [
            _StreamPort(
                stream,
                protocol,
                url,
                open_stream(url, on_data=self.bus.wake, ntrip=access, silence_s=settings.silence_s),
            )
            for stream, protocol, url in wanted
            if url is not None and url != "bus"
        ]

    def _gga(self) -> str | None:
        """GGA of the last position, for casters of virtual reference stations; called from another thread."""
        fix = self._last_fix
        if fix is None:
            return None
        solution = ReceiverSolution(
            time_ns=fix.time_ns,
            latitude_rad=fix.latitude_rad,
            longitude_rad=fix.longitude_rad,
            height_m=fix.height_m,
            quality=SolutionQuality.SINGLE,
            satellites=fix.satellites,
        )
        return format_gga(solution, geoid_separation_m=0.0).decode("ascii")

    def _read(self, port: _StreamPort) -> None:
        stream = port.port
        for _ in range(stream.failures - port.failures):
            port.failures += 1
            self.bus.issue("source_lost", f"{port.name}: {stream.last_failure}")
        if stream.lost_bytes > port.lost_bytes:
            self.bus.issue(
                "source_overflow", f"{port.name}: {stream.lost_bytes} bytes lost, they came too fast"
            )
            port.lost_bytes = stream.lost_bytes
        data = stream.take()
        if data:
            self._feed(port.stream, port.protocol, port.name, data)

    def _receive(self, received: ReceiverBytes) -> None:
        """Bytes from the bus; not for a stream that has a port."""
        if any(port.stream == received.stream for port in self._ports):
            self._leave_out(f"{received.stream}.{received.protocol}")
            return
        self._feed(received.stream, received.protocol, received.stream, received.payload.tobytes())

    def _feed(self, stream: Stream, protocol: StreamProtocol, name: str, data: bytes) -> None:
        if stream == "base" and self.settings.forward_corrections:
            self._forward(data)
            return
        unused = ("pos", "nmea") if self._solves else ("rinex", "rtcm")
        if protocol in unused or not (self._solves or stream == "rover"):
            self._leave_out(f"{stream}.{protocol}")
            return
        reader = self._reader(stream, protocol, name)
        self._dispatch(reader.feed(data))
        self._report_damage(reader, protocol)

    def _forward(self, data: bytes) -> None:
        """Send the base's bytes to the receiver, as they are."""
        receiver = next(port for port in self._ports if port.stream == "rover")
        if receiver.port.send(data):
            self.bus.count("corrections.sent_bytes", len(data))
        else:
            self.bus.issue(
                "corrections_not_sent", f"{receiver.name}: it has not taken all of {len(data)} bytes"
            )

    def _reader(self, stream: Stream, protocol: StreamProtocol, name: str) -> StreamReader:
        """Reader of a stream; a new one where this machine's clock was set: weeks were resolved wrongly."""
        now_ns = self.bus.now_ns()
        if (
            abs(now_ns - self._fed_ns.get((stream, protocol), now_ns)) > _CLOCK_WAS_SET_NS
            and protocol in _WEEKLESS
        ):
            del self._readers[stream, protocol]
        self._fed_ns[stream, protocol] = now_ns
        reader = self._readers.get((stream, protocol))
        if reader is None:
            reader = StreamReader(stream, protocol, name, near_ns=now_ns, utc_date=self.settings.nmea_date)
            self._readers[stream, protocol] = reader
        return reader

    def _report_damage(self, reader: StreamReader, protocol: StreamProtocol) -> None:
        """Count and report unusable parts of a stream, whenever there are more."""
        damage, before = reader.damage(), self._damage.get(reader, {})
        if damage == before:
            return
        self._damage[reader] = damage
        for what, count in damage.items():
            self.bus.count(f"{reader.name}.{what}", count - before.get(what, 0))
        text = ", ".join(f"{what} {count}" for what, count in damage.items())
        expected = "" if protocol == "mixed" else f"; expected {protocol} alone (several on one port: mixed)"
        self.bus.issue(
            "damaged_input", f"{reader.name}: {text}{expected if 'bytes_skipped' in damage else ''}"
        )

    def _leave_out(self, what: str) -> None:
        """Count an unused stream, and report it once."""
        if what not in self._left_out:
            self._left_out.add(what)
            expected = (
                "observations or ephemerides: ubx, sbf, rtcm, mixed or rinex"
                if self._solves
                else "the receiver's positions: rover.pos, .nmea, .ubx, .sbf or .mixed; or positions = engine"
            )
            self.bus.issue("stream_not_used", f"{what}: expected {expected}")
        self.bus.count(f"not_used.{what}")

    def _dispatch(self, items: list[StreamItem]) -> None:
        for stream, item in items:
            match item:
                case FormatError():
                    self.bus.issue("unreadable_input", str(item))
                case ReceiverIntegrity():
                    self.bus.publish("receiver_integrity", item)
                case ReceiverSolution():
                    if not (self._solves or self._is_refused(item.time_ns)):
                        self._publish_fix(partial(fix_from, item, self.settings.datum))
                case SatelliteReport():
                    self._publish_reported_satellites(item)
                case _ if self._rover is not None:
                    self._rover.receive(stream, item)

    def _publish_solved(self, solved: SolvedEpoch) -> None:
        solution = solved.solution
        self.bus.count(f"epochs.{solution.quality}")
        if solution.quality != "fixed":
            self.bus.count(f"not_fixed.{solution.reason}")
        if self.settings.publish_observations:
            self._publish("observations", lambda: observations_from(solved.epoch, "rover"))
        self._publish_satellites(solved)
        velocity = solution.velocity
        if velocity is not None:
            self._publish("velocity", lambda: velocity_from(velocity, solved.heading))
        subsets = subset_agreement(solution, self._criteria) if self._criteria is not None else "unknown"
        self._publish_fix(
            lambda: fix_from_solution(solution, self.settings.datum, solved.base_station, subsets)
        )
        self._last_ns = solution.time_ns

    def _publish_satellites(self, solved: SolvedEpoch) -> None:
        """Publish the satellites in view, now and then: a message costs a quarter of an epoch's time."""
        solution = solved.solution
        if self._rests(solution.time_ns):
            return
        columns = satellite_columns(solved.epoch, solution, self._masks)
        if columns is not None:
            self._satellites_ns = solution.time_ns
            self._publish("satellites", lambda: satellites_from(solution.time_ns, solution.quality, columns))

    def _publish_reported_satellites(self, report: SatelliteReport) -> None:
        """Publish the receiver's satellites where its positions are published, as often as those of the engine."""
        refusal = refuse(report.time_ns, self._satellites_ns, self.bus.now_ns())
        if not (self._solves or refusal is not None or self._rests(report.time_ns)):
            self._satellites_ns = report.time_ns
            self._publish("satellites", lambda: satellites_from_report(report))

    def _rests(self, time_ns: int) -> bool:
        """Whether satellites were published less than the set time before."""
        every_ns = self.settings.satellites_every_s * NS_PER_SECOND - _EPOCH_JITTER_NS
        return 0 <= time_ns - self._satellites_ns < every_ns

    def _is_refused(self, time_ns: int) -> bool:
        refusal = refuse(time_ns, self._last_ns, self.bus.now_ns())
        if refusal is not None:
            self.bus.issue(refusal, f"epoch {time_ns} ns after {self._last_ns} ns")
        return refusal is not None

    def _publish_fix(self, make: Callable[[], Fix | None]) -> None:
        fix = self._publish("fix", make)
        if fix is not None:
            self._last_ns, self._last_fix = fix.time_ns, fix

    def _publish(self, channel: str, make: Callable[[], M | None]) -> M | None:
        """Publish a message; values that no message can have are reported instead."""
        try:
            message = make()
        except ValidationError as error:
            self.bus.issue("implausible_epoch", str(first_refused(error)))
            return None
        if message is not None:
            self.bus.publish(channel, message)
        return message

    def _estimates(self, request: EstimatesRequest) -> Estimates:
        if self._rover is not None:
            return self._rover.recent.estimates(request)
        reason = "the receiver's own solution; there are no raw observations"
        return Estimates(time_ns=request.time_ns, fix_id=request.fix_id, status="unavailable", reason=reason)


SERVICE = GnssService
