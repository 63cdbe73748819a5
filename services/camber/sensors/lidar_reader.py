"""A LiDAR's packets as they arrived → its sweeps in GPS time, and the issues with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from camber.formats.lidar_can.firings import Decoded, Firings, Int64, LidarDecoder
from camber.schemas.lidar import Sweep
from camber.sensors.sender_filter import SenderFilter
from camber.sensors.sensor_clock import SensorClock
from camber.sensors.sweep_assembly import SweepCutter

ISSUES = dict.fromkeys(("size", "flag", "mode", "stamp", "azimuth", "type", "empty"), "lidar_packets")
ISSUES |= dict.fromkeys(("model", "turn"), "lidar_model")
"""Why a packet is refused → the issue under which health names it."""


class LidarReader:
    """One sensor. `issues` are those of the last call: code and text.

    Two sensors of one model cannot be distinguished by their packets: those of one sender are read, and no others.
    """

    def __init__(self, sensor: str, decoder: LidarDecoder, clock: SensorClock, least_share: float) -> None:
        self.counts: Counter[str] = Counter()
        self.issues: list[tuple[str, str]] = []
        self._decoder, self._clock = decoder, clock
        self._cutter = SweepCutter(sensor, decoder.interval_ns, decoder.beam_after_ns, least_share)
        self._session: int | None = None
        self._senders = SenderFilter()

    def take(
        self, payloads: Sequence[bytes], arrivals_ns: Sequence[int], senders: Sequence[str] = ()
    ) -> list[Sweep]:
        """Packets, the GPS times at which they arrived, in that order, and from where; returns the sweeps of them."""
        kept = self._senders.kept(arrivals_ns, senders or [""] * len(payloads))
        self.counts["packets.of_others"] += len(payloads) - len(kept)
        self.issues = self._senders.issues()
        if len(kept) < len(payloads):
            payloads = [payloads[number] for number in kept]
            arrivals_ns = [arrivals_ns[number] for number in kept]
        decoded = self._decoder.decode(payloads)
        self.counts["packets.read"] += len(payloads)
        for reason, n in decoded.refused.items():
            self.counts[f"packets.refused_{reason}"] += n
        self.issues += sorted((ISSUES[reason], text) for reason, text in decoded.details.items())
        self._check_session(decoded)
        sweeps: list[Sweep] = []
        for first, times in self._runs(decoded, arrivals_ns):
            if first:
                self._cutter.start_anew()
            if decoded.firings is not None and times:
                sweeps += self._add(decoded.firings, times)
        self._count()
        return sweeps

    def finish(self) -> list[Sweep]:
        """The recording has ended, or goes on at another time."""
        sweeps = self._cutter.finish()
        self._cutter.start_anew()
        self._clock.go_on()
        self._count()
        return sweeps

    def _count(self) -> None:
        self.counts.update({name: n - self.counts[name] for name, n in self._cutter.counts.items()})

    def _check_session(self, decoded: Decoded) -> None:
        if decoded.session is None or decoded.session == self._session:
            return
        if self._session is not None:
            self._cutter.start_anew()
            self.issues.append(("lidar_started_again", f"the sensor's session is {decoded.session} now"))
        self._session = decoded.session

    def _runs(self, decoded: Decoded, arrivals_ns: Sequence[int]) -> list[tuple[bool, dict[int, int]]]:
        """Packets between which no clock was set: whether one was before them, and the time of each."""
        runs: list[tuple[bool, dict[int, int]]] = [(False, {})]
        filled_ns = self._filled_ns(decoded)
        for number, (stamp_ns, arrival_ns) in enumerate(zip(decoded.stamp_ns, arrivals_ns, strict=True)):
            if number in decoded.wrong_rotation:
                runs.append((True, {}))  # what fitted by chance is of the same turn
            if stamp_ns is None:
                continue
            time_ns = self._clock.time_ns(stamp_ns, arrival_ns - int(filled_ns[number]))
            if self._clock.jump:
                self.counts["clock.jumps"] += 1
                self.issues.append(("lidar_clock_jumped", self._clock.jump))
                runs.append((True, {}))
            if time_ns is None:
                self.counts["packets.refused_time"] += 1
                self.issues.append(("lidar_clock", self._clock.refusal))
            else:
                self._senders.mark_used(arrival_ns)
                runs[-1][1][number] = time_ns
        return runs

    def _filled_ns(self, decoded: Decoded) -> Int64:
        """From the first to the last measurement of each packet: only then it leaves the sensor."""
        filled_ns = np.zeros(len(decoded.stamp_ns), np.int64)
        if decoded.firings is not None:
            np.maximum.at(filled_ns, decoded.firings.packet, decoded.firings.after_ns)
            filled_ns += int(self._decoder.beam_after_ns.max())
        return filled_ns

    def _add(self, firings: Firings, times: dict[int, int]) -> list[Sweep]:
        of_packet = np.full(int(firings.packet.max()) + 1, -1, np.int64)
        for number, time_ns in times.items():
            if number < len(of_packet):
                of_packet[number] = time_ns
        begin_ns = of_packet[firings.packet]
        known = begin_ns >= 0
        chosen = firings if known.all() else firings.chosen(known)
        return self._cutter.add(begin_ns[known] + chosen.after_ns, chosen) if len(chosen) else []
