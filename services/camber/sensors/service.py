"""The process of the sensors: packets of a LiDAR and frames of a CAN bus become sweeps and motion on the bus."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from camber.formats.drive.timed_file import TimedFile
from camber.formats.lidar_can.candump import CandumpDecoder, CanFrame
from camber.formats.lidar_can.pcap import Datagram, PcapDecoder
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.schemas.base import Message
from camber.schemas.motion import Suspension
from camber.sensors.can_motion import quantities_in
from camber.sensors.inputs import Live, Played, gps_ns
from camber.sensors.settings import SensorsSettings
from camber.sensors.sources import can_source, lidar_source
from camber.transport.packet_ports import CanPort, UdpPort

_OF_LIDAR = ("sweep", "imu")
"""Channels of the LiDAR; on the others each quantity is watched by itself."""


class SensorsService(Service[SensorsSettings]):
    """What arrives is published as soon as it is whole; errors are counted and reported as issues."""

    NAME = "sensors"
    SETTINGS = SensorsSettings

    def __init__(self, settings: SensorsSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._packets = self._open_lidar()
        self._imu_packets = self._open_imu()
        self._frames = self._open_can()
        self._played = [each for each in (self._packets, self._frames) if isinstance(each, Played)]
        self._lidar = None if self._packets is None else settings.lidar.reader()
        self._imu = None if self._packets is None else settings.lidar.imu_reader()
        self._can = None if self._frames is None else settings.can.reader()
        self._sweeps_ended = False
        self._reported_silent: frozenset[str] = frozenset()
        self._bus_name = settings.can.bus  # of frames; unset: that of the first one
        self._start_playing(bus.now_ns())
        expected = [] if self._lidar is None else ["sweep"]
        expected += [] if self._imu is None else ["imu"]
        expected += [] if self._can is None else self._can.quantities
        # By a clock that is never set: a silent input stays so when this machine's clock is set back.
        self._given_s = dict.fromkeys(expected, time.monotonic())

    def _open_lidar(self) -> Live[Datagram] | Played[Datagram] | None:
        if self.settings.lidar.source is None:
            return None
        where = lidar_source(self.settings.lidar.source)
        if where[0] == "udp":
            return Live("lidar", UdpPort(where[1], where[2]))
        return Played("lidar", TimedFile(where[1], PcapDecoder(where[1].name)))

    def _open_imu(self) -> Live[Datagram] | None:
        """The port of the IMU packets; in a recording they are between those of the lidar."""
        source, number = self.settings.lidar.source, self.settings.lidar.imu_port
        if source is None or number is None:
            return None
        where = lidar_source(source)
        return Live("lidar", UdpPort(where[1], number)) if where[0] == "udp" else None

    def _open_can(self) -> Live[CanFrame] | Played[CanFrame] | None:
        if self.settings.can.source is None:
            return None
        where = can_source(self.settings.can.source)
        if where[0] == "socketcan":
            return Live("can", CanPort(where[1]))
        return Played("can", TimedFile(where[1], CandumpDecoder(where[1].name)))

    def _start_playing(self, now_ns: int) -> None:
        firsts = [first for played in self._played if (first := played.first_ns()) is not None]
        for played in self._played:
            if firsts:
                played.start(min(firsts), now_ns, dated_now=self.settings.recordings == "now")

    def _pass_steps(self, now_ns: int) -> None:
        """Where the time of recordings steps they go on at once; together, lest sweeps and motion part."""
        steps_ns = [played.step_ns(now_ns) for played in self._played if not played.ended]
        if not steps_ns or not all(steps_ns):
            return
        if self._lidar is not None and self._packets in self._played:
            for sweep in self._lidar.finish():
                self._give("sweep", sweep, self._packets.shift_ns)
            if self._imu is not None:
                self._imu.go_on()
        self._start_playing(now_ns)
        text = f"the recording goes on {steps_ns[0] / 1e9:+.3f} s from where it was"
        self.bus.issue("recording_stepped", text)

    def advance(self, now_ns: int) -> None:
        """Read what has come, publish what is whole."""
        try:
            self._pass_steps(now_ns)
            self._work_lidar(now_ns)
        finally:  # a fault in the one is none in the other
            self._work_can(now_ns)
            self._report_silent()

    def healthy(self) -> bool:
        """Does every input give something?"""
        return not self._silent()

    def _silent(self) -> frozenset[str]:
        since_s = time.monotonic() - self.settings.silence_s
        return frozenset(what for what, given_s in self._given_s.items() if given_s < since_s)

    def _report_silent(self) -> None:
        silent = self._silent()
        for what in sorted(silent - self._reported_silent):
            name = "lidar" if what in _OF_LIDAR else "can"
            self.bus.issue("sensor_silent", f"{name}: no {what} for {self.settings.silence_s:g} s")
        self._reported_silent = silent

    def close(self) -> None:
        """Close ports and files."""
        for one in (self._packets, self._imu_packets, self._frames):
            if one is not None:
                one.close()

    def _work_lidar(self, now_ns: int) -> None:
        if self._packets is None or self._lidar is None or self._sweeps_ended:
            return
        settings = self.settings.lidar
        received = self._packets.take(now_ns)
        self._work_imu(received, now_ns)
        packets = [
            one
            for one in received
            if self._is_of_sender(one)
            and (self._packets not in self._played or one.port == settings.udp_port())
        ]
        of_imu = sum(one.port == settings.imu_port for one in received)
        self._lidar.counts["packets.of_others"] += len(received) - len(packets) - of_imu
        sweeps = self._lidar.take(
            [one.payload for one in packets],
            [gps_ns(one.time_ns) for one in packets],
            [one.source for one in packets],
        )
        issues = [*self._packets.issues, *self._lidar.issues]
        if self._packets.ended:
            self._sweeps_ended = True
            sweeps += self._lidar.finish()
        for sweep in sweeps:
            self._give("sweep", sweep, self._packets.shift_ns)
        self._report("lidar", issues, {**self._packets.counts, **self._lidar.counts})

    def _work_imu(self, received: Sequence[Datagram], now_ns: int) -> None:
        """Read IMU packets: from their port, or among those of a recording."""
        if self._imu is None or self._packets is None:
            return
        port = self._imu_packets
        packets = [
            one
            for one in (received if port is None else port.take(now_ns))
            if one.port == self.settings.lidar.imu_port and self._is_of_sender(one)
        ]
        samples = self._imu.take(
            [one.payload for one in packets],
            [gps_ns(one.time_ns) for one in packets],
            [one.source for one in packets],
        )
        for sample in samples:
            self._give("imu", sample, self._packets.shift_ns)
        issues = [] if port is None else [(code, f"IMU: {text}") for code, text in port.issues]
        counts = {} if port is None else port.counts
        self._report("imu", [*issues, *self._imu.issues], {**counts, **self._imu.counts})

    def _is_of_sender(self, packet: Datagram) -> bool:
        return self.settings.lidar.sender in (None, packet.source)

    def _work_can(self, now_ns: int) -> None:
        if self._frames is None or self._can is None:
            return
        settings = self.settings.can
        offset_ns = round(settings.clock_offset_s * 1e9)
        frames, others = self._frames.take(now_ns), set[str]()
        for frame in frames:
            if self._bus_name is None:
                self._bus_name = frame.bus
            if frame.bus != self._bus_name:
                self.bus.count("can.frames.of_other_buses")
                others.add(frame.bus)
                continue
            for message in self._can.take(frame, gps_ns(frame.time_ns) + offset_ns):
                channel = "suspension" if isinstance(message, Suspension) else "motion"
                self._give(channel, message, self._frames.shift_ns)
        if others and settings.bus is None:
            names = ", ".join(sorted(others))
            self.bus.issue("can_recording", f"frames of {names}, not only of {self._bus_name}: set bus")
        self._report("can", self._frames.issues, {**self._frames.counts, **self._can.counts})

    def _give(self, channel: str, message: Message, shift_ns: int) -> None:
        if shift_ns:
            message = message.model_copy(update={"time_ns": message.time_ns + shift_ns})
        names = [channel] if channel in _OF_LIDAR else quantities_in(message)
        self._given_s.update(dict.fromkeys(names, time.monotonic()))
        self.bus.publish(channel, message)

    def _report(self, name: str, issues: list[tuple[str, str]], counts: Mapping[str, int]) -> None:
        for code, text in issues:
            self.bus.issue(code, text)
        for what, n in counts.items():
            self.bus.count(f"{name}.{what}", n - self.bus.counters[f"{name}.{what}"])


SERVICE = SensorsService
