"""What receiver and base say, in order, until there is an epoch to solve; its velocity and heading with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.gnss.candidates.engine_candidates import LastEpochs
from camber.gnss.observations.base_station import station_name
from camber.gnss.observations.receiver_streams import Said, StationPosition, Stream
from camber.gnss.position.rtk_engine import Engine, EngineOptions, Solution
from camber.gnss.velocity.doppler_velocity import DopplerVelocity
from camber.gnss.velocity.heading_filter import Heading, HeadingFilter
from camber.schemas.motion import Motion

_WHEEL_AGE_NS = 500_000_000


@dataclass(frozen=True, slots=True, eq=False)
class SolvedEpoch:
    """One epoch of the receiver: its observations, what the engine made of them, its heading where one is known.

    `base_station` is the name of the base that it was differenced with, None where it was not.
    """

    epoch: ObservationEpoch
    solution: Solution
    heading: Heading | None
    base_station: str | None = None


class Rover:
    """Feeds the engine with what was said, base before rover, so that an epoch meets the base's of the same time.

    A base whose position is configured keeps it, whatever its stream says.
    """

    def __init__(self, options: EngineOptions, base_ecef_m: tuple[float, float, float] | None = None) -> None:
        self.engine = Engine(options, None if base_ecef_m is None else np.array(base_ecef_m))
        self.last = LastEpochs(options)
        self._base_is_given = base_ecef_m is not None
        self._base_station = station_name("given", self.engine.base.position_ecef_m)
        self._heading = HeadingFilter()
        self._wheel_speed_m_s: float | None = None
        self._wheel_ns = 0
        self._waiting: list[ObservationEpoch] = []

    def hear(self, stream: Stream, said: Said) -> None:
        """One thing that a stream said; solutions and statements of a receiver are of no use here."""
        match said:
            case ObservationEpoch() if stream == "base":
                self.engine.add_base(said)
            case ObservationEpoch() if stream == "rover":
                self._waiting.append(said)
            case Ephemeris():
                self.engine.add_ephemeris(said)
            case IonosphereCoefficients() if said.system == "G":
                self.engine.ionosphere = np.array((*said.alpha, *said.beta))
            case StationPosition() if stream == "base" and not self._base_is_given:
                position = np.array(said.position_ecef_m)
                self.engine.set_base_position(position)
                self._base_station = station_name(said.told, position)

    def moved(self, motion: Motion) -> None:
        """The vehicle's own sensors, for the heading alone: no position rests on them."""
        if motion.yaw_rate_rad_s is not None:
            self._heading.add_yaw_rate(motion.time_ns, motion.yaw_rate_rad_s)
        if motion.wheel_speed_m_s is not None:
            self._wheel_speed_m_s, self._wheel_ns = motion.wheel_speed_m_s, motion.time_ns

    def take(self) -> list[ObservationEpoch]:
        """All epochs of the receiver that wait, in the order in which they came."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def solve(self, epoch: ObservationEpoch) -> SolvedEpoch:
        """One epoch, with all that was heard until now."""
        solution = self.engine.solve(epoch)
        self.last.keep(solution)
        if solution.velocity is not None:
            self._turn(epoch.time_ns, solution.velocity)
        differenced = solution.quality in ("fixed", "float")
        base_station = self._base_station if differenced else None
        return SolvedEpoch(epoch, solution, self._heading.at(epoch.time_ns), base_station)

    def _turn(self, time_ns: int, found: DopplerVelocity) -> None:
        """The heading goes with the velocity, where the wheels say forward or backward."""
        wheel = self._wheel_speed_m_s
        if found.status != "ok" or wheel is None or abs(time_ns - self._wheel_ns) > _WHEEL_AGE_NS:
            return
        east, north, _ = found.velocity_enu_m_s.tolist()
        covariance = found.covariance_enu_m2_s2
        plane = (float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1]))
        self._heading.add_velocity(time_ns, east, north, plane, found.hdop, wheel)
