"""Observations of a receiver whose antenna moves through a place, from the satellites to the antenna's cable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.formats.observations import Ephemeris, ObservationEpoch, carrier_hz, signal_number
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.injected_faults import Fault, antenna_offset_m, cn0_loss_db
from camber.simulator.satellites.atmosphere import Atmosphere
from camber.simulator.satellites.carrier_locks import Locks, locks
from camber.simulator.satellites.orbits import SPEED_OF_LIGHT_M_S, OrbitTable, newest_in_use
from camber.simulator.satellites.parameters import DATA_ONLY, Receiver, SignalParameters
from camber.simulator.satellites.propagation import Surroundings, open_sky, propagation
from camber.simulator.satellites.ranges import Ranges, ranges
from camber.simulator.satellites.signal_errors import Levels, levels
from camber.simulator.satellites.track import AntennaTrack, GeodeticTrack, geodetic_track
from camber.simulator.scene import Booleans, Floats, Integers

_LOOK_NS = 60 * NS_PER_SECOND


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SimulatedSignals:
    """All that was simulated of one receiver, per epoch, satellite and frequency, tracked or not.

    `satellite` (m,), `signal`, `carrier_hz` (m, 2); `pseudorange_m`, `carrier_phase_cycles`, `doppler_hz` (n, m, 2);
    `antenna_offset_m` (n, 3): where the signals say the antenna is, off the true one, by spoofing.
    """

    time_ns: Integers
    antenna_offset_m: Floats
    satellite: Integers
    signal: Integers
    carrier_hz: Floats
    pseudorange_m: Floats
    carrier_phase_cycles: Floats
    doppler_hz: Floats
    geometry: Ranges
    levels: Levels
    locks: Locks

    def epochs(self) -> list[ObservationEpoch]:
        """As the receiver gives them: tracked signals only, in the order of satellites and frequencies."""
        satellite = np.broadcast_to(self.satellite[:, None], self.signal.shape)
        epochs = []
        for k, time_ns in enumerate(self.time_ns.tolist()):
            rows = self.levels.code_tracked[k]
            phase = self.levels.phase_tracked[k][rows]
            epochs.append(
                ObservationEpoch(
                    time_ns=time_ns,
                    satellite=satellite[rows],
                    signal=self.signal[rows],
                    pseudorange_m=self.pseudorange_m[k][rows],
                    carrier_phase_cycles=np.where(phase, self.carrier_phase_cycles[k][rows], np.nan),
                    doppler_hz=self.doppler_hz[k][rows],
                    cn0_dbhz=self.levels.cn0_dbhz[k][rows],
                    lock_time_s=np.where(phase, self.locks.lock_time_s[k][rows], 0.0),
                    loss_of_lock=phase & self.locks.loss_of_lock[k][rows],
                    half_cycle=phase & self.locks.half_cycle[k][rows],
                )
            )
        return epochs


def simulate_signals(
    track: AntennaTrack,
    frame: LocalFrame,
    ephemerides: Sequence[Ephemeris],
    parameters: SignalParameters,
    seed: int,
    receiver: str,
    surroundings: Surroundings | None = None,
    faults: Sequence[Fault] = (),
    atmosphere: Atmosphere | None = None,
) -> SimulatedSignals:
    """What a receiver at the track's antenna observes of the satellites in the (true) ephemerides.

    `receiver` names the random streams: two receivers with one seed share the atmosphere and nothing else. Without
    surroundings the sky is open. Raises ValueError where the track has no epochs or its times do not rise.
    """
    time_ns = track.time_ns
    if not len(time_ns) or bool(np.any(np.diff(time_ns) <= 0)):
        raise ValueError("time_ns of the track must have rising times")
    one = Receiver(name=receiver, seed=seed, parameters=parameters)
    atmosphere = atmosphere or Atmosphere.drawn(seed)
    clock, drift = _receiver_clock(time_ns, one)
    offset, offset_rate = antenna_offset_m(faults, time_ns)
    antenna = track.antenna_m - clock[:, None] * track.antenna_velocity_m_s
    reported = geodetic_track(frame, antenna + offset, track.antenna_velocity_m_s + offset_rate)
    sets = newest_in_use(ephemerides, int(time_ns[len(time_ns) // 2]))
    sets = [e for e in sets if chr(e.satellite >> 8) in parameters.signals]
    lowest = np.deg2rad(parameters.lowest_elevation_deg - 1.0)
    sets = [sets[k] for k in _rising(sets, (time_ns, clock), reported, frame, lowest_rad=lowest)]
    table = OrbitTable.of(sets)
    geometry = ranges(table, (time_ns, clock), reported, frame)
    signal, carrier, data_only = _signals_of(table.satellite, parameters)

    paths = open_sky(len(time_ns), len(sets))
    elevation = geometry.elevation_rad
    if surroundings is not None:
        paths = propagation(antenna, geometry.direction, elevation, surroundings, parameters=parameters)
    loss_db = cn0_loss_db(faults, time_ns)
    arriving = levels(track, elevation, carrier, paths, cn0_loss_db=loss_db, receiver=one)
    held = locks(
        time_ns,
        arriving.phase_tracked,
        arriving.cn0_dbhz,
        data_only=data_only,
        direct=paths.direct,
        receiver=one,
    )

    ionosphere, troposphere = atmosphere.delays_m(
        time_ns, reported[:3], antenna[:, :2], (geometry.azimuth_rad, elevation)
    )
    delay = _group_delays_s(ephemerides, table.satellite, carrier)
    dispersive = ionosphere[..., None] * (1575.42e6 / carrier) ** 2
    common = geometry.range_m + SPEED_OF_LIGHT_M_S * (clock[:, None] - geometry.clock_s) + troposphere
    code = common[..., None] + dispersive + SPEED_OF_LIGHT_M_S * delay + arriving.code_error_m
    wavelength = SPEED_OF_LIGHT_M_S / carrier
    phase = (common[..., None] - dispersive + arriving.phase_error_m) / wavelength + held.ambiguity_cycles
    rate = geometry.rate_m_s + SPEED_OF_LIGHT_M_S * (drift[:, None] - geometry.clock_rate)
    air_rate = np.zeros_like(dispersive)
    if len(time_ns) > 1:
        # What the atmosphere changes by: low satellites' troposphere, centimetres a second.
        since_s = (time_ns - time_ns[0]) / NS_PER_SECOND
        air_rate = np.gradient(troposphere[..., None] - dispersive, since_s, axis=0)
    return SimulatedSignals(
        time_ns=time_ns,
        antenna_offset_m=offset,
        satellite=table.satellite,
        signal=signal,
        carrier_hz=carrier,
        pseudorange_m=code,
        carrier_phase_cycles=phase,
        doppler_hz=-(rate[..., None] + air_rate + arriving.rate_error_m_s) / wavelength,
        geometry=geometry,
        levels=arriving,
        locks=held,
    )


def _rising(
    sets: list[Ephemeris],
    times: tuple[Integers, Floats],
    track: GeodeticTrack,
    frame: LocalFrame,
    *,
    lowest_rad: float,
) -> list[int]:
    """Which satellites rise above an elevation, looked at once a minute."""
    time_ns, clock_s = times
    rows = np.searchsorted(time_ns, np.arange(time_ns[0], time_ns[-1], _LOOK_NS))
    every = np.unique(np.append(rows, len(time_ns) - 1))
    coarse = ranges(OrbitTable.of(sets), (time_ns[every], clock_s[every]), track.rows(every), frame)
    return np.flatnonzero(np.max(coarse.elevation_rad, axis=0) >= lowest_rad).tolist()


def _signals_of(satellite: Integers, parameters: SignalParameters) -> tuple[Integers, Floats, Booleans]:
    """Number and carrier of each satellite's signals (m, 2), and whether they have no pilot."""
    signals = [(chr(s >> 8), name) for s in satellite for name in parameters.signals[chr(s >> 8)]]
    numbers = np.array([signal_number(name) for _, name in signals], np.int64)
    carriers = np.array([carrier_hz(system, name) for system, name in signals], np.float64)
    data_only = np.array([name in DATA_ONLY[system] for system, name in signals], np.bool_)
    return numbers.reshape(-1, 2), carriers.reshape(-1, 2), data_only.reshape(-1, 2)


def _group_delays_s(ephemerides: Sequence[Ephemeris], satellite: Integers, carrier_hz: Floats) -> Floats:
    """What code on each frequency comes late by, (m, 2) [s], against the clock that is broadcast.

    IS-GPS-200N 20.3.3.3.3.2 (GPS, QZSS: γ TGD), Galileo OS SIS ICD 2.1, 5.1.5 (E1, E5b), BDS-SIS-ICD-B1I 5.2.4.10.
    """
    by_number = {e.satellite: e for e in ephemerides}
    delays = np.zeros(carrier_hz.shape)
    for k, number in enumerate(satellite):
        other = by_number[int(number)].other
        if "tgd1_s" in other:
            delays[k] = other["tgd1_s"], other["tgd2_s"]
        else:
            first = other["tgd_s"] if "tgd_s" in other else other["bgd_e5b_s"]
            delays[k] = first * (carrier_hz[k, 0] / carrier_hz[k]) ** 2
    return delays


def _receiver_clock(time_ns: Integers, receiver: Receiver) -> tuple[Floats, Floats]:
    """Receiver's clock minus true time (n,) [s] and its rate: a bias, a drift, and a drift that walks."""
    p, rng = receiver.parameters, receiver.stream("clock")
    dt = np.diff(time_ns, prepend=time_ns[:1]) / NS_PER_SECOND
    walk = np.cumsum(p.clock_walk_s_per_root_s * np.sqrt(dt) * rng.normal(size=len(dt)))
    drift = p.clock_drift_s_s * rng.normal() + walk
    mean = 0.5 * (drift + np.concatenate((drift[:1], drift[:-1])))
    bias = p.clock_bias_s * rng.normal() + np.cumsum(mean * dt)
    return bias, drift
