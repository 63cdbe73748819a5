"""Many vehicles over one district at the level of measurements: what each would upload, without satellites or rays.

A vehicle's measurement of a road's height is off by its bias (antenna height, lever arm), by that of the drive (base
station, load), by correlated and white noise of its fixes, and in episodes, or for a whole drive, by wrong fixes. An
attacker adds a constant. The verdict is that of a height check against the map; epochs that fail it are
uploaded too.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.integrity.uploads import decimal_year
from camber.map_server.elevation_queries import ElevationMap
from camber.schemas.fleet import UploadBatch
from camber.schemas.gnss import Quality
from camber.schemas.integrity import VerdictValue
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers, Path

TOLERANCE_M = 0.2  # chosen: six σ of a vehicle's right heights, a quarter of the scale of the wrong ones
ROWS = 64  # chosen: records of one batch, as a vehicle sends them
_FIXED = get_args(Quality).index("fixed")
_CONFIRMED, _ERRONEOUS = (get_args(VerdictValue).index(value) for value in ("confirmed", "erroneous"))


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetErrors:
    """Standard deviations of what a vehicle's road height is off by, and how often its fixes are wrong."""

    vehicle_m: float = 0.02
    drive_m: float = 0.015
    correlated_m: float = 0.012
    correlated_s: float = 8.0
    white_m: float = 0.006
    antenna_sigma_m: float = 0.02
    sideways_m: float = 0.3
    sideways_s: float = 10.0
    wrong_episodes_per_s: float = 1.0 / 300.0
    wrong_episode_s: float = 2.5
    wrong_height_m: float = 0.8
    """Scale of the Laplace distribution of a wrong fix's height error."""
    wrong_drives: float = 0.0
    """Share of the drives of which every fix is wrong, all by the same."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FleetTrack:
    """A path as a fleet sees it: per sample (n,) the true road's height on the drive day and what the map has there.

    `surface_id` is −1 where the map knows no road; there nothing is uploaded.
    """

    step_m: float
    latitude_rad: Floats
    longitude_rad: Floats
    crossfall: Floats
    across_latitude_rad_m: Floats
    across_longitude_rad_m: Floats
    road_m: Floats
    map_m: Floats
    surface_id: Integers

    @property
    def length_m(self) -> float:
        """Of the whole path."""
        return self.step_m * (len(self.road_m) - 1)


def track_of(path: Path, origin: LocalFrame, the_map: ElevationMap) -> FleetTrack:
    """Look up once, for every sample of the path, which surface of the map it is on, by its link."""
    plane_m = np.column_stack((path.east_m, path.north_m))
    latitude, longitude, _ = origin.geodetic_from_east_north_array(plane_m, path.up_m)
    left_m = plane_m + np.column_stack((-np.sin(path.yaw_rad), np.cos(path.yaw_rad)))
    left_latitude, left_longitude, _ = origin.geodetic_from_east_north_array(left_m, path.up_m)
    surface_id, map_m = np.full(len(latitude), -1), np.full(len(latitude), np.nan)
    for link in np.unique(path.link_id).tolist():
        rows = np.flatnonzero(path.link_id == link)
        on_map = the_map.roads(latitude[rows], longitude[rows], (int(link),))
        surface_id[rows[on_map.known]] = on_map.surface_id
        map_m[rows[on_map.known]] = on_map.elevation_m
    return FleetTrack(
        step_m=path.step_m,
        latitude_rad=latitude,
        longitude_rad=longitude,
        crossfall=path.crossfall,
        across_latitude_rad_m=left_latitude - latitude,
        across_longitude_rad_m=left_longitude - longitude,
        road_m=path.up_m,
        map_m=map_m,
        surface_id=surface_id,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetVehicle:
    """One vehicle of the fleet and what is true of it."""

    name: str
    bias_m: float
    attack_m: float


def vehicles_of(count: int, attackers: float, errors: FleetErrors, seed: int) -> tuple[FleetVehicle, ...]:
    """The fleet. Attackers, a share of it, all report the same wrong height: that is what hurts a mean most."""
    rng = stream(seed, "fleet vehicles")
    bias_m = rng.normal(0.0, errors.vehicle_m, count)
    attack = np.zeros(count)
    attack[rng.permutation(count)[: round(attackers * count)]] = float(rng.choice([-1.0, 1.0])) * 0.25
    return tuple(
        FleetVehicle(name=f"car{number:05d}", bias_m=float(bias), attack_m=float(attacks))
        for number, (bias, attacks) in enumerate(zip(bias_m, attack, strict=True))
    )


def drive_days(vehicle: FleetVehicle, drives: int, days: int, seed: int) -> list[int]:
    """On which of the days each drive of a vehicle is: different ones, in order, where there are enough."""
    rng = stream(seed, f"fleet days {vehicle.name}")
    chosen = rng.permutation(days)[:drives] if drives <= days else rng.integers(0, days, drives)
    return sorted(chosen.tolist())


def drive_uploads(
    track: FleetTrack,
    vehicle: FleetVehicle,
    number: int,
    *,
    start_ns: int,
    duration_s: float,
    rate_hz: float,
    map_version: int,
    errors: FleetErrors,
    seed: int,
) -> Iterator[UploadBatch]:
    """What one drive of one vehicle uploads, in batches of ROWS records. `number` is that of its drive."""
    rng = stream(seed, f"fleet {vehicle.name} {number}")
    n = math.floor(duration_s * rate_hz)
    step_s = np.full(n, 1.0 / rate_hz)
    speed_m_s = float(np.clip(rng.normal(9.0, 2.0), 3.0, 15.0))
    along_m = rng.uniform(0.0, track.length_m) + speed_m_s * np.cumsum(step_s)
    sample = (along_m % track.length_m / track.step_m).astype(np.int64)
    white = rng.standard_normal((n, 2))
    sideways_m = errors.sideways_m * gauss_markov(white[:, :1], memory_of(step_s, errors.sideways_s))[:, 0]
    noise_m = errors.correlated_m * gauss_markov(white[:, 1:], memory_of(step_s, errors.correlated_s))[:, 0]
    error_m = noise_m + rng.normal(0.0, errors.white_m, n) + rng.normal(0.0, errors.drive_m)
    error_m += vehicle.bias_m + vehicle.attack_m + _wrong_fixes(rng, n, rate_hz, errors)
    if rng.random() < errors.wrong_drives:
        error_m += rng.laplace(0.0, errors.wrong_height_m)
    road_m = track.road_m[sample] + track.crossfall[sample] * sideways_m + error_m
    difference_m = np.abs(road_m - (track.map_m[sample] + track.crossfall[sample] * sideways_m))
    time_ns = start_ns + np.round(np.arange(n) * (1e9 / rate_hz)).astype(np.int64)
    sigma_m = math.hypot(errors.white_m, errors.correlated_m, errors.antenna_sigma_m)
    columns = {
        "positioning_time_ns": time_ns,
        "fix_id": time_ns // 1_000_000,
        "fix_quality": np.full(n, _FIXED, "|u1"),
        "surface_id": track.surface_id[sample],
        "verdict": np.where(difference_m <= TOLERANCE_M, _CONFIRMED, _ERRONEOUS).astype("|u1"),
        "latitude_rad": track.latitude_rad[sample] + track.across_latitude_rad_m[sample] * sideways_m,
        "longitude_rad": track.longitude_rad[sample] + track.across_longitude_rad_m[sample] * sideways_m,
        "horizontal_sigma_m": np.full(n, errors.correlated_m),
        "road_height_m": road_m,
        "road_height_sigma_m": np.full(n, sigma_m),
        "antenna_height_m": np.full(n, 1.6),
    }
    known = np.flatnonzero(columns["surface_id"] >= 0)
    for begin in range(0, len(known), ROWS):
        rows = known[begin : begin + ROWS]
        last_ns = int(time_ns[rows[-1]])
        name = hashlib.sha256(f"{seed} {vehicle.name} {number} {begin}".encode()).hexdigest()[:16]
        yield UploadBatch(
            time_ns=last_ns,
            vehicle=vehicle.name,
            batch_id=f"{last_ns}-{name}",
            datum="WGS84",
            epoch_year=decimal_year(int(time_ns[rows[0]])),
            map_version=map_version,
            **{key: column[rows] for key, column in columns.items()},
        )


def _wrong_fixes(rng: np.random.Generator, n: int, rate_hz: float, errors: FleetErrors) -> Floats:
    """Height errors (n,) of wrong fixes: constant within an episode, zero outside."""
    error_m = np.zeros(n)
    for _ in range(int(rng.poisson(errors.wrong_episodes_per_s * n / rate_hz))):
        begin = int(rng.integers(0, n))
        end = begin + 1 + int(rng.exponential(errors.wrong_episode_s) * rate_hz)
        error_m[begin:end] = rng.laplace(0.0, errors.wrong_height_m)
    return error_m
