"""A receiver's fixes along a trajectory: errors of right ones, a fault that all share, episodes of wrong integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.scene import Booleans, Floats, Integers, Trajectory
from camber.validation.common_faults.fault_cases import CommonFault
from camber.validation.common_faults.wrong_episodes import WrongEpisodes

RATE_HZ = 5  # as the recorded drive of Nagoya
_STEP = 100 // RATE_HZ  # rows of a trajectory of 100 Hz


@dataclass(frozen=True, slots=True, kw_only=True)
class FixErrors:
    """σ in metres, east, north, up: of the part that changes within `correlation_s`, white, and as claimed.

    In the open: 6 mm at 95 % in the plane (docs/simulator.md, `open-sky`). In streets: 7 cm at 95 % in space
    (`canyon`). A receiver claims white noise only.
    """

    slow_m: tuple[float, float, float] = (0.003, 0.003, 0.008)
    white_m: tuple[float, float, float] = (0.002, 0.002, 0.004)
    claimed_m: tuple[float, float, float] = (0.006, 0.006, 0.012)
    correlation_s: float = 30.0


OPEN = FixErrors()
STREET = FixErrors(
    slow_m=(0.015, 0.015, 0.03),
    white_m=(0.005, 0.005, 0.01),
    claimed_m=(0.01, 0.01, 0.02),
    correlation_s=10.0,
)
_FEWER_IN_STREETS = 6  # chosen: 10 to 17, as a common receiver uses there
_VELOCITY_SIGMA_M_S = np.array((0.02, 0.02, 0.04))  # chosen: Doppler of a common receiver in the open
_VELOCITY_TIME_S = 1.0  # as the judge assumes of reflections


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixSeries:
    """Solutions at epochs (n,), and how far each is off the antenna, (n, 3): east, north, up [m]."""

    time_ns: Integers
    solutions: tuple[ReceiverSolution, ...]
    error_m: Floats

    @property
    def wrong(self) -> Booleans:
        """Farther off than 0.5 m, in space (n,)."""
        wrong: Booleans = np.linalg.norm(self.error_m, axis=1) > 0.5
        return wrong


def fix_series(
    trajectory: Trajectory,
    frame: LocalFrame,
    fault: CommonFault,
    *,
    seed: int,
    lasts_s: float,
    errors: FixErrors = OPEN,
    episodes: WrongEpisodes | None = None,
) -> FixSeries:
    """Fixes at `RATE_HZ`; the trajectory must go on where `fault` leads beyond `lasts_s`."""
    rows = np.arange(0, min(len(trajectory.time_ns), round(lasts_s * 100.0) + 1), _STEP)
    time_ns = trajectory.time_ns[rows]
    time_s = (time_ns - time_ns[0]) / 1e9
    offset_m, extra_m_s = _common_offset(trajectory, rows, fault, time_s)
    noise_m = _noise(stream(seed, "fix slow"), errors.slow_m, len(rows), errors.correlation_s)
    noise_m += stream(seed, "fix white").standard_normal((len(rows), 3)) * errors.white_m
    error_m = offset_m + noise_m
    if episodes is not None:
        error_m += episodes.offset_m(time_s)
    velocity = trajectory.antenna_velocity_m_s[rows] + extra_m_s
    velocity = velocity + _noise(
        stream(seed, "velocity slow"), _VELOCITY_SIGMA_M_S, len(rows), _VELOCITY_TIME_S
    )
    place = trajectory.antenna_m[rows] + error_m
    latitude, longitude, _ = frame.geodetic_from_east_north_array(place[:, :2], place[:, 2])
    ee, nn, uu = (sigma_m**2 for sigma_m in errors.claimed_m)
    ve, vn, vu = (_VELOCITY_SIGMA_M_S**2).tolist()
    satellites = _satellites(seed, len(rows), episodes, time_s)
    solutions = tuple(
        ReceiverSolution(
            time_ns=t,
            latitude_rad=lat,
            longitude_rad=lon,
            height_m=up,
            quality=SolutionQuality.FIX,
            satellites=count,
            covariance_enu_m2=(ee, 0.0, 0.0, nn, 0.0, uu),
            age_s=1.0,
            ratio=5.0,
            velocity_enu_m_s=(v[0], v[1], v[2]),
            velocity_covariance_enu_m2_s2=(ve, 0.0, 0.0, vn, 0.0, vu),
        )
        for t, lat, lon, up, count, v in zip(
            time_ns.tolist(), latitude.tolist(), longitude.tolist(), place[:, 2].tolist(), satellites,
            velocity.tolist(), strict=True,
        )
    )  # fmt: skip
    return FixSeries(time_ns=time_ns, solutions=solutions, error_m=error_m)


def _noise(
    rng: np.random.Generator, sigma: Floats | tuple[float, ...], count: int, correlation_s: float
) -> Floats:
    white = rng.standard_normal((count, 3))
    memory = np.full(count, float(memory_of(np.array(1.0 / RATE_HZ), correlation_s)))
    noise: Floats = gauss_markov(white, memory) * np.asarray(sigma)
    return noise


def _satellites(seed: int, count: int, episodes: WrongEpisodes | None, time_s: Floats) -> list[int]:
    many = stream(seed, "satellites").integers(16, 24, count)
    if episodes is not None:
        many = many - _FEWER_IN_STREETS
        few = episodes.satellites(time_s)
        many = np.where(few > 0, few, many)
    return [int(one) for one in many.tolist()]


def _common_offset(
    trajectory: Trajectory, rows: Integers, fault: CommonFault, time_s: Floats
) -> tuple[Floats, Floats]:
    """Offsets of the fixes (n, 3) [m], and of their velocities [m/s]."""
    t = trajectory
    driven_m = np.append(0.0, np.cumsum(t.speed_m_s[:-1] * 0.01))
    since_s = np.maximum(time_s - fault.onset_s, 0.0)
    acts = time_s >= fault.onset_s
    here = t.antenna_m[rows]
    yaw = t.yaw_rad[rows]
    ahead_m = driven_m[rows] + fault.along_m_s * since_s
    # Where the vehicle stands several rows have one distance: the path goes on after the last.
    moves = np.append(np.diff(driven_m) > 0.0, True)
    there = np.column_stack([np.interp(ahead_m, driven_m[moves], t.antenna_m[moves, k]) for k in range(3)])
    offset = np.where((fault.along_m_s * since_s > 0.0)[:, None], there - here, 0.0)
    left = np.column_stack((-np.sin(yaw), np.cos(yaw)))
    offset[:, :2] += (fault.across_m_s * since_s)[:, None] * left
    onset_yaw = float(yaw[np.searchsorted(time_s, fault.onset_s).clip(0, len(yaw) - 1)])
    constant = np.array((fault.east_m, fault.north_m)) + fault.along_m * np.array(
        (np.cos(onset_yaw), np.sin(onset_yaw))
    )
    offset[:, :2] += acts[:, None] * constant
    if not fault.height_of_road:
        offset[:, 2] = 0.0
    ahead = np.column_stack((np.cos(yaw), np.sin(yaw)))
    extra = np.zeros((len(rows), 3))
    extra[:, :2] = acts[:, None] * (fault.along_m_s * ahead + fault.across_m_s * left)
    return offset, extra
