"""An Ouster's IMU packets as they arrived → samples in GPS time, and the issues with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from pydantic import ValidationError

from camber.formats.lidar_can.firings import Float64
from camber.formats.lidar_can.ouster_imu import OusterImuSample, read_imu_packet
from camber.schemas.motion import Imu
from camber.schemas.refused_field import first_refused
from camber.sensors.sender_filter import SenderFilter
from camber.sensors.sensor_clock import SensorClock

_ISSUES = {"packet": "lidar_packets", "time": "lidar_clock"}
"""Why a packet is refused → the issue under which health names it."""


class ImuReader:
    """The inertial unit of one sensor. `issues` are those of the last call: code and text."""

    def __init__(self, sensor_from_imu: Float64, clock: SensorClock) -> None:
        self.counts: Counter[str] = Counter()
        self.issues: list[tuple[str, str]] = []
        self._sensor_from_imu, self._clock = sensor_from_imu, clock
        self._senders = SenderFilter()

    def take(
        self, payloads: Sequence[bytes], arrivals_ns: Sequence[int], senders: Sequence[str]
    ) -> list[Imu]:
        """Packets, the GPS times at which they arrived, in that order, and from where; returns their samples."""
        kept = self._senders.kept(arrivals_ns, senders)
        self.counts["packets.of_others"] += len(payloads) - len(kept)
        self.counts["packets.read"] += len(kept)
        refused: dict[str, str] = {}
        samples = []
        for number in kept:
            try:
                samples.append(self._sample(payloads[number], arrivals_ns[number]))
            except _RefusedPacketError as error:
                self.counts[f"packets.refused_{error.reason}"] += 1
                refused[_ISSUES[error.reason]] = f"IMU: {error}"
        self.issues = [*self._senders.issues(), *sorted(refused.items())]
        return samples

    def go_on(self) -> None:
        """The recording goes on at another time."""
        self._clock.go_on()

    def _sample(self, payload: bytes, arrival_ns: int) -> Imu:
        sample = read_imu_packet(payload, self._sensor_from_imu)
        if not isinstance(sample, OusterImuSample):
            raise _RefusedPacketError("packet", sample)
        time_ns = self._clock.time_ns(sample.stamp_ns, arrival_ns)
        if time_ns is None:
            raise _RefusedPacketError("time", self._clock.refusal)
        try:
            message = Imu(
                time_ns=time_ns,
                angular_rate_rad_s=sample.angular_rate_rad_s,
                specific_force_m_s2=sample.specific_force_m_s2,
            )
        except ValidationError as error:
            raise _RefusedPacketError("packet", str(first_refused(error))) from None
        self._senders.mark_used(arrival_ns)
        return message


class _RefusedPacketError(ValueError):
    """A packet that is not read; its reason is a key of `_ISSUES`."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason
