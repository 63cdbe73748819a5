"""What arrives: strength and errors of each signal, by its propagation.

Sources: ITU-R P.526-15, 4.1 eq. 31 (loss over a knife's edge); M. S. Braasch, "Multipath effects", in Parkinson and
Spilker, Global Positioning System: Theory and Applications I (1996): one reflection of amplitude α and phase ψ makes
errors of atan2(α sin ψ, 1 + α cos ψ) in phase and α Δ cos ψ / (1 + α cos ψ) in code, up to half the correlator's
spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.random_processes import gauss_markov, memory_of, switched
from camber.simulator.satellites.orbits import SPEED_OF_LIGHT_M_S
from camber.simulator.satellites.parameters import Receiver
from camber.simulator.satellites.propagation import Propagation
from camber.simulator.satellites.track import AntennaTrack
from camber.simulator.scene import Booleans, Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Levels:
    """Per epoch, satellite and frequency (n, m, 2): errors in metres, and whether code and phase can be tracked."""

    cn0_dbhz: Floats
    code_error_m: Floats
    phase_error_m: Floats
    rate_error_m_s: Floats
    code_tracked: Booleans
    phase_tracked: Booleans


def levels(
    track: AntennaTrack,
    elevation_rad: Floats,
    carrier_hz: Floats,
    paths: Propagation,
    *,
    cn0_loss_db: Floats,
    receiver: Receiver,
) -> Levels:
    """Of n epochs, m satellites with carriers (m, 2); elevation (n, m), `cn0_loss_db` (n,)."""
    p, rng = receiver.parameters, receiver.stream
    n, m = elevation_rad.shape

    def on(name: str, share: Floats, time_s: float) -> Booleans:
        draws = rng(name)
        return switched(draws.random((n, m)), draws.random((n, m)), memory_of(dt, time_s), share)

    velocity_m_s = track.antenna_velocity_m_s
    dt = np.diff(track.time_ns, prepend=track.time_ns[:1]) / NS_PER_SECOND
    driven = np.sqrt(np.sum(velocity_m_s**2, axis=1)) * dt
    sin_el = np.sin(np.maximum(elevation_rad, np.deg2rad(p.lowest_elevation_deg)))
    high = elevation_rad >= np.deg2rad(p.lowest_elevation_deg)
    bent = ~paths.direct & np.isfinite(paths.bent_rad)
    wall = np.isfinite(paths.excess_m)
    straight = high & (paths.direct | bent)
    by_wall = high & ~straight & wall & on("by wall", np.full(n, p.reflected_tracked), p.reflected_time_s)
    cn0 = p.zenith_cn0_dbhz - p.horizon_cn0_loss_db * (1.0 - sin_el) - cn0_loss_db[:, None]
    crown_db = np.minimum(p.crown_loss_db_per_m * paths.crown_m, p.crown_loss_most_db)
    cn0 = cn0 - np.where(straight, crown_db, p.reflected_cn0_loss_db)
    cn0 = np.repeat(cn0[..., None], 2, axis=2)
    cn0[..., 1] -= p.second_cn0_loss_db
    cn0 -= np.where(bent[..., None], _edge_loss_db(paths.bent_rad, paths.edge_m, carrier_hz), 0.0)

    code, phase = np.zeros((2, n, m, 2))
    memory = memory_of(driven, p.reflection_length_m) * memory_of(dt, p.reflection_time_s)

    both = straight & wall
    draws = rng("reflection")
    spread = 1.0 + p.reflection_spread * gauss_markov(draws.normal(size=(n, m)), memory)
    amplitude = p.reflection_amplitude * np.clip(spread, 0.0, 3.0)
    turn = np.arctan2(*(gauss_markov(draws.normal(size=(n, m)), memory) for _ in range(2)))
    excess = np.where(wall, paths.excess_m, 0.0)
    psi = 2.0 * np.pi * excess[..., None] * (carrier_hz / SPEED_OF_LIGHT_M_S) + turn[..., None]
    a = np.where(both, amplitude, 0.0)[..., None]
    in_phase = 1.0 + a * np.cos(psi)
    code += a * np.minimum(excess, p.code_envelope_m)[..., None] * np.cos(psi) / in_phase
    phase += np.arctan2(a * np.sin(psi), in_phase) * SPEED_OF_LIGHT_M_S / (2.0 * np.pi * carrier_hz)
    cn0 += 10.0 * np.log10(np.maximum(in_phase**2 + (a * np.sin(psi)) ** 2, 1e-3))

    late = np.where(by_wall, excess, 0.0)[..., None]
    code += late
    phase += late
    rate = np.where(by_wall, np.einsum("nmk,nk->nm", paths.excess_per_m, velocity_m_s), 0.0)

    bent_rad, edge_m = np.nan_to_num(paths.bent_rad), np.nan_to_num(paths.edge_m)
    depth = np.where(bent, bent_rad / max(np.deg2rad(p.diffraction_reach_deg), 1e-9), 0.0)
    # The path over an edge at distance d is longer by d θ² / 2; far edges bend less than that, many being before them.
    detour = np.minimum(0.5 * edge_m * bent_rad**2, p.diffraction_phase_m * depth**2)
    scatter = np.tanh(np.abs(gauss_markov(rng("edge").normal(size=(n, m)), memory)))
    code += (depth * scatter * p.diffraction_code_m)[..., None]
    phase += np.where(bent, detour, 0.0)[..., None]

    # Leaves scatter: errors that grow with the loss, the same on both frequencies.
    draws = rng("crown")
    for error, per_db in ((code, p.crown_code_m_per_db), (phase, p.crown_phase_m_per_db)):
        scattered = gauss_markov(draws.normal(size=(n, m)), memory)
        error += (np.where(straight, crown_db * per_db, 0.0) * scattered)[..., None]

    draws = rng("background")
    slow = memory_of(dt, p.background_time_s)
    for f in range(2):
        for error, sigma in ((code, p.background_code_m), (phase, p.background_phase_m)):
            error[..., f] += p.noise_factor * sigma / sin_el * gauss_markov(draws.normal(size=(n, m)), slow)

    draws = rng("noise")
    cn0 += p.cn0_noise_db * draws.normal(size=(n, m, 2))
    scale = p.noise_factor * 10.0 ** (-(cn0 - 45.0) / 20.0)
    code += scale * p.code_noise_m * np.array([1.0, p.second_code_factor]) * draws.normal(size=(n, m, 2))
    phase += scale * p.phase_noise_m * draws.normal(size=(n, m, 2))
    rates = rate[..., None] + scale * p.doppler_noise_m_s * draws.normal(size=(n, m, 2))

    tracked = (straight | by_wall)[..., None] & (cn0 > p.code_tracked_above_dbhz)
    share = p.second_absent * np.clip(paths.enclosure / p.second_absent_enclosure, 0.0, 1.0)
    tracked[..., 1] &= tracked[..., 0] & ~on("second", share, p.second_absent_time_s)
    locked = tracked & (cn0 > p.phase_tracked_above_dbhz)
    no_phase = by_wall & on("phase", np.full(n, p.reflected_phase_absent), p.reflected_time_s)
    locked &= ~no_phase[..., None]
    return Levels(
        cn0_dbhz=cn0,
        code_error_m=code,
        phase_error_m=phase,
        rate_error_m_s=rates,
        code_tracked=tracked,
        phase_tracked=locked,
    )


def _edge_loss_db(bent_rad: Floats, edge_m: Floats, carrier_hz: Floats) -> Floats:
    scale = 2.0 * np.nan_to_num(edge_m)[..., None] * carrier_hz / SPEED_OF_LIGHT_M_S
    nu = np.nan_to_num(bent_rad)[..., None] * np.sqrt(scale)
    return 6.9 + 20.0 * np.log10(np.sqrt((nu - 0.1) ** 2 + 1.0) + nu - 0.1)
