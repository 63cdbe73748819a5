"""Observations of a simulated receiver: consistent with each other, repeatable, hurt by faults as they should be."""

from dataclasses import replace

import numpy as np
import pytest

from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.injected_faults import Fault, Jamming, Spoofing
from camber.simulator.satellites.carrier_locks import locks
from camber.simulator.satellites.constellation import true_ephemerides
from camber.simulator.satellites.observations import SimulatedSignals, simulate_signals
from camber.simulator.satellites.orbits import SPEED_OF_LIGHT_M_S
from camber.simulator.satellites.parameters import ROVER, Receiver
from camber.simulator.satellites.track import AntennaTrack

BEGIN_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 6, 0, 0))
FRAME = LocalFrame(np.deg2rad(35.17), np.deg2rad(136.9), 0.0)
TRUE = true_ephemerides(BEGIN_NS, BEGIN_NS + 60 * NS_PER_SECOND, 3)
RATE_HZ = 5
QUIET = replace(
    ROVER, code_noise_m=0.0, phase_noise_m=0.0, background_code_m=0.0, background_phase_m=0.0, doppler_noise_m_s=0.0,
    slips_per_s=0.0, half_cycle_after_lock=0.0,
)  # fmt: skip


def drive(seconds: int = 40) -> AntennaTrack:
    n = seconds * RATE_HZ
    s = np.arange(n) / RATE_HZ
    velocity = np.tile([9.0, -4.0, 0.2], (n, 1))
    place = np.array([50.0, 20.0, 60.0]) + s[:, None] * velocity
    time_ns = BEGIN_NS + (s * NS_PER_SECOND).astype(np.int64)
    return AntennaTrack(time_ns=time_ns, antenna_m=place, antenna_velocity_m_s=velocity)


def simulated(*faults: Fault, parameters=ROVER) -> SimulatedSignals:
    return simulate_signals(drive(), FRAME, TRUE, parameters, 3, "rover", faults=faults)


def test_phase_changes_at_the_rate_of_the_doppler():
    signals = simulated(parameters=QUIET)
    change = np.diff(signals.carrier_phase_cycles, axis=0) * RATE_HZ
    mean = -0.5 * (signals.doppler_hz[1:] + signals.doppler_hz[:-1])
    tracked = signals.levels.phase_tracked
    held = ~signals.locks.loss_of_lock[1:] & tracked[1:] & tracked[:-1]
    assert held.mean() > 0.7
    assert np.max(np.abs(change - mean)[held]) < 0.01


def test_code_minus_phase_is_twice_the_ionosphere_and_a_whole_number_of_wavelengths():
    signals = simulated(parameters=QUIET)
    code, wave = signals.pseudorange_m, SPEED_OF_LIGHT_M_S / signals.carrier_hz
    phase = (signals.carrier_phase_cycles - signals.locks.ambiguity_cycles) * wave
    twice = (code - phase) / (1575.42e6 / signals.carrier_hz) ** 2
    # Group delays are alike at all times: only the ionosphere's change in 40 s is left.
    assert np.max(np.ptp(twice, axis=0)) < 0.2
    assert np.median(twice) > 2.0
    assert np.all(signals.locks.ambiguity_cycles == np.rint(signals.locks.ambiguity_cycles))


def test_noise_at_45_dbhz_is_that_of_the_parameters():
    parameters = replace(ROVER, background_code_m=0.0, background_phase_m=0.0)
    signals = simulated(parameters=parameters)
    near = np.abs(signals.levels.cn0_dbhz - 45.0) < 0.5
    code = signals.levels.code_error_m[..., 0][near[..., 0]]
    assert np.std(code) == pytest.approx(0.30, rel=0.1)
    assert np.std(signals.levels.code_error_m[..., 1][near[..., 1]]) == pytest.approx(0.21, rel=0.1)
    assert np.std(signals.levels.phase_error_m[near]) == pytest.approx(1.5e-3, rel=0.1)


def test_jamming_lowers_carrier_to_noise_only_while_it_lasts():
    plain, jammed = simulated(), simulated(Jamming(kind="jamming", onset_s=9.0, end_s=21.0, loss_db=15.0))
    loss = np.mean(plain.levels.cn0_dbhz - jammed.levels.cn0_dbhz, axis=(1, 2))
    since = (plain.time_ns - BEGIN_NS) / NS_PER_SECOND
    assert np.allclose(loss[(since >= 11.0) & (since <= 19.0)], 15.0)
    assert np.allclose(loss[(since < 9.0) | (since > 21.0)], 0.0)
    inside = (since >= 11.0) & (since <= 19.0)
    assert jammed.levels.phase_tracked[inside].mean() < 0.2 * plain.levels.phase_tracked[inside].mean()


def test_spoofed_ranges_are_those_of_the_place_that_drifts_off():
    drift = (0.3, -0.2, 0.0)  # level: the troposphere changes with height
    begin = BEGIN_NS + 10 * NS_PER_SECOND
    spoof = Spoofing(kind="spoofing", onset_s=10.0, end_s=60.0, east_m_s=drift[0], north_m_s=drift[1])
    plain, spoofed = simulated(), simulated(spoof)
    since = np.maximum((plain.time_ns - begin) / NS_PER_SECOND, 0.0)
    expected = -np.einsum("nmk,k->nm", plain.geometry.direction, np.array(drift)) * since[:, None]
    assert np.max(np.abs((spoofed.pseudorange_m - plain.pseudorange_m)[..., 0] - expected)) < 2e-3


def test_only_signals_without_pilot_lose_half_a_cycle_and_it_is_flagged():
    always = replace(ROVER, half_cycle_after_lock=1.0, half_cycle_wrong_when_weak=0.0, slips_per_s=0.0)
    jam = Jamming(kind="jamming", onset_s=3.0, end_s=8.0, loss_db=60.0)
    signals = simulated(jam, parameters=always)
    since = (signals.time_ns - BEGIN_NS) / NS_PER_SECOND - 8.0
    assert not signals.levels.code_tracked[(since > -2.9) & (since < -2.1)].any()
    tracked = signals.levels.phase_tracked[since > -2.5]
    first = np.diff(tracked.astype(int), axis=0, prepend=0) == 1
    assert signals.locks.loss_of_lock[since > -2.5][first].all()  # every lock is a new one
    off = signals.locks.ambiguity_cycles % 1.0 == 0.5
    letters = [chr(s >> 8) for s in signals.satellite]
    data = np.array([[letter in "GJC", letter == "C"] for letter in letters])
    assert off[:, data].any()
    assert not off[:, ~data].any()
    assert not signals.locks.half_cycle[:, ~data].any()
    assert np.all(signals.locks.half_cycle[off])
    # Resolved within three seconds, and the jump says that it is one.
    assert not signals.locks.half_cycle[since > 3.0].any()
    jumps = (np.diff(off, axis=0) != 0) & signals.levels.phase_tracked[1:] & signals.levels.phase_tracked[:-1]
    assert jumps.any()
    assert np.all(signals.locks.loss_of_lock[1:][jumps])


def locked_at(cn0_dbhz, direct=False, count=4000):
    """Many signals without pilot that are lost for a while and come back with this C/N0, over twenty seconds."""
    time_ns = BEGIN_NS + np.arange(20 * RATE_HZ, dtype=np.int64) * (NS_PER_SECOND // RATE_HZ)
    tracked = np.ones((len(time_ns), count, 2), np.bool_)
    tracked[5:10] = False
    always = replace(ROVER, slips_per_s=0.0, half_cycle_after_lock=1.0)
    return locks(
        time_ns,
        tracked,
        np.full(tracked.shape, cn0_dbhz),
        data_only=np.ones((count, 2), np.bool_),
        direct=np.full((len(time_ns), count), direct),
        receiver=Receiver(name="rover", seed=3, parameters=always),
    )


def unflagged_half_cycles(held):
    return (held.ambiguity_cycles % 1.0 == 0.5) & ~held.half_cycle


def test_half_cycles_without_a_flag_happen_to_weak_signals_out_of_sight():
    unflagged = {}
    for cn0 in (33.0, 37.0, 45.0):
        hidden = unflagged_half_cycles(locked_at(cn0))
        unflagged[cn0] = float(np.mean(hidden.any(axis=0)))
        # Never for longer than until the next subframe.
        assert hidden.sum(axis=0).max() <= 6 * RATE_HZ + 1
    assert unflagged[33.0] == pytest.approx(0.01, rel=0.3)
    assert unflagged[37.0] == pytest.approx(0.001, rel=0.8)
    assert unflagged[45.0] < 3e-4
    in_sight = locked_at(33.0, direct=True)
    assert not unflagged_half_cycles(in_sight).any()
    assert (in_sight.half_cycle & (in_sight.ambiguity_cycles % 1.0 == 0.5)).any()


def test_a_track_without_rising_times_is_refused():
    track = drive()
    with pytest.raises(ValueError, match="rising"):
        simulate_signals(replace(track, time_ns=track.time_ns[::-1].copy()), FRAME, TRUE, ROVER, 3, "rover")
