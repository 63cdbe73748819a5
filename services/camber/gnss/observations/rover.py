"""Dispatch of decoded streams to the engine; velocity and heading of each solved epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, GlonassEphemeris, ObservationEpoch
from camber.gnss.candidates.engine_candidates import RecentEpochs
from camber.gnss.observations.base_move_detection import BaseWatch
from camber.gnss.observations.receiver_streams import DecodedItem, StationPosition, Stream
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from camber.gnss.velocity.heading_filter import HeadingEstimate, HeadingFilter
from camber.schemas.motion import Motion

_WHEEL_AGE_NS = 500_000_000  # chosen: five messages of a 10 Hz bus


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SolvedEpoch:
    """Observations of one epoch, the engine's solution, the heading where known.

    `base_station` is the name of the base that it was differenced with, None without differences.
    """

    epoch: ObservationEpoch
    solution: Solution
    heading: HeadingEstimate | None
    base_station: str | None = None


class Rover:
    """Feeds the engine with decoded items, base before rover, so that an epoch meets the base's of the same time.

    A configured base position overrides that of the stream.
    """

    def __init__(
        self,
        settings: EngineSettings,
        base_ecef_m: tuple[float, float, float] | None = None,
        bases: BaseWatch | None = None,
    ) -> None:
        self.engine = Engine(settings)
        self.recent = RecentEpochs(settings)
        self.bases = bases if bases is not None else BaseWatch()
        self._base_is_given = base_ecef_m is not None
        if base_ecef_m is not None:
            self._move_base(StationPosition(position_ecef_m=base_ecef_m, label="given"))
        self._heading = HeadingFilter()
        self._wheel_speed_m_s: float | None = None
        self._wheel_ns = 0
        self._pending: list[ObservationEpoch] = []

    def receive(self, stream: Stream, item: DecodedItem) -> None:
        """Use one item of a stream; solutions and integrity statements of a receiver are not used here."""
        match item:
            case ObservationEpoch() if stream == "base":
                self.engine.add_base(item)
            case ObservationEpoch() if stream == "rover":
                self._pending.append(item)
            case Ephemeris() | GlonassEphemeris():
                self.engine.add_ephemeris(item)
            case IonosphereCoefficients() if item.system == "G":
                self.engine.ionosphere = np.array((*item.alpha, *item.beta))
            case StationPosition() if stream == "base" and not self._base_is_given:
                self._move_base(item)

    def _move_base(self, station: StationPosition) -> None:
        self.engine.set_base_position(np.array(station.position_ecef_m))
        self.bases.station_stated(self.engine.base, station, is_given=self._base_is_given)

    def receive_motion(self, motion: Motion) -> None:
        """Use the vehicle's sensors for the heading alone: no position depends on them."""
        if motion.yaw_rate_rad_s is not None:
            self._heading.add_yaw_rate(motion.time_ns, motion.yaw_rate_rad_s)
        if motion.wheel_speed_m_s is not None:
            self._wheel_speed_m_s, self._wheel_ns = motion.wheel_speed_m_s, motion.time_ns

    def take_pending(self) -> list[ObservationEpoch]:
        """Remove and return the receiver's pending epochs, in the order of arrival."""
        pending, self._pending = self._pending, []
        return pending

    def solve(self, epoch: ObservationEpoch) -> SolvedEpoch:
        """Solve one epoch with everything received so far."""
        solution = self.engine.solve(epoch)
        self.bases.remember(self.engine.base)
        self.recent.keep(solution)
        velocity, wheel = solution.velocity, self._wheel_speed_m_s
        # A recent wheel speed gives the direction of travel.
        recent = abs(epoch.time_ns - self._wheel_ns) <= _WHEEL_AGE_NS
        if velocity is not None and velocity.status == "ok" and wheel is not None and recent:
            self._heading.add_velocity(velocity, wheel)
        differenced = solution.quality in ("fixed", "float")
        return SolvedEpoch(
            epoch=epoch,
            solution=solution,
            heading=self._heading.at(epoch.time_ns),
            base_station=self.engine.base.name if differenced else None,
        )
