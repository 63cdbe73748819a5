"""Short simulated drives without houses for the engine: rover, base, ephemerides and the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import (
    SPEED_OF_LIGHT_M_S,
    Ephemeris,
    ObservationEpoch,
    carrier_hz,
    signal_name,
)
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from camber.simulator.satellites.observations import simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER, SignalParameters
from camber.simulator.satellites.track import AntennaTrack, static_track
from support.canyon_statistics import BASE_M, FIRST_NS, FRAME, SPEED_M_S
from support.rtklib_runs import ecef_of
from support.street_canyon import drive_through, street_canyon

COLUMNS = (
    "satellite", "signal", "pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz", "lock_time_s",
    "loss_of_lock", "half_cycle",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Drive:
    """Epochs of rover and base at the same times, ephemerides, true antenna positions (n, 3) in ECEF."""

    rover: list[ObservationEpoch]
    base: list[ObservationEpoch]
    ephemerides: list[Ephemeris]
    store: EphemerisStore
    true_ecef_m: NDArray[np.float64]


def base_ecef_m() -> NDArray[np.float64]:
    return ecef_of(FRAME, np.array([BASE_M]))[0]


def open_sky_drive(seed: int = 1, seconds: int = 10, rate_hz: int = 1, begin_ns: int = FIRST_NS) -> Drive:
    """A car at 8 m/s, 3 km from its base."""
    canyon = street_canyon(seed, 0.7, SPEED_M_S * seconds)
    track = drive_through(canyon, begin_ns, float(seconds), rate_hz)
    true = true_ephemerides(begin_ns, int(track.time_ns[-1]), seed)
    rover = simulate_signals(track, FRAME, true, ROVER, seed, "rover")
    base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, seed, "base")
    ephemerides = broadcast_ephemerides(true, seed)
    epochs, truth_m = (list(rover.epochs()), list(base.epochs())), ecef_of(FRAME, track.antenna_m)
    return Drive(*epochs, ephemerides, store_of(ephemerides), truth_m)


def store_of(ephemerides: Iterable[Ephemeris]) -> EphemerisStore:
    store = EphemerisStore(most_of_satellite=1000)
    for e in ephemerides:
        store.add(e)
    return store


def received(
    track: AntennaTrack, seed: int, parameters: SignalParameters = ROVER
) -> tuple[tuple[ObservationEpoch, ...], EphemerisStore]:
    """What a receiver on a track observes under an open sky, and the ephemerides that are broadcast."""
    true = true_ephemerides(int(track.time_ns[0]), int(track.time_ns[-1]), seed)
    signals = simulate_signals(track, FRAME, true, parameters, seed, "rover")
    return tuple(signals.epochs()), store_of(broadcast_ephemerides(true, seed))


def engine_of(drive: Drive, options: EngineSettings | None = None) -> Engine:
    """An engine that knows the ephemerides and the base's position."""
    engine = Engine(options or EngineSettings(), base_ecef_m())
    for e in drive.ephemerides:
        engine.add_ephemeris(e)
    return engine


def solved(drive: Drive, engine: Engine | None = None) -> list[Solution]:
    """All epochs, each after the base's of the same time."""
    engine = engine or engine_of(drive)
    solutions = []
    for rover, base in zip(drive.rover, drive.base, strict=True):
        engine.add_base(base)
        solutions.append(engine.solve(rover))
    return solutions


def some_rows(epoch: ObservationEpoch, rows: NDArray[np.bool_] | NDArray[np.int64]) -> ObservationEpoch:
    """Some rows of an epoch, or all in another order."""
    return replace(epoch, **{name: getattr(epoch, name)[rows] for name in COLUMNS})


def of_systems(epoch: ObservationEpoch, systems: str) -> ObservationEpoch:
    return some_rows(epoch, np.isin(epoch.satellite >> 8, [ord(letter) for letter in systems]))


def seconds_later(epoch: ObservationEpoch, seconds: float) -> ObservationEpoch:
    """The same with another time tag."""
    return replace(epoch, time_ns=epoch.time_ns + round(seconds * NS_PER_SECOND))


def wavelengths_m(epoch: ObservationEpoch) -> NDArray[np.float64]:
    """Of each row (n,)."""
    rows = zip(epoch.satellite.tolist(), epoch.signal.tolist(), strict=True)
    return np.array([SPEED_OF_LIGHT_M_S / carrier_hz(chr(s >> 8), signal_name(g)) for s, g in rows])


def clock_ahead(epoch: ObservationEpoch, seconds: float) -> ObservationEpoch:
    """Of a receiver whose clock is ahead: a later time tag, longer ranges by code and phase alike."""
    ahead_m = seconds * SPEED_OF_LIGHT_M_S
    return replace(
        seconds_later(epoch, seconds),
        pseudorange_m=epoch.pseudorange_m + ahead_m,
        carrier_phase_cycles=epoch.carrier_phase_cycles + ahead_m / wavelengths_m(epoch),
    )
