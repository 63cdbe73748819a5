"""Everything that shapes simulated observations, with defaults under which RTKLIB behaves as on the road."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from camber.simulator.random_streams import stream

SIGNALS: Mapping[str, tuple[str, str]] = {
    "G": ("1C", "2L"),
    "J": ("1C", "2L"),
    "E": ("1X", "7X"),
    "C": ("2I", "7I"),
}
"""By system: the two signals a receiver tracks. GPS may be 1C and 2W, Galileo 1C and 7Q."""

DATA_ONLY: Mapping[str, tuple[str, ...]] = {
    "G": ("1C", "2S", "5I"),
    "J": ("1C", "2S", "5I"),
    "E": ("1B", "5I", "7I"),
    "C": ("2I", "6I", "7I"),
}
"""Signals without a pilot: their phase is known to half a cycle only, until the data give the sign."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalParameters:
    """Noise, obstruction and tracking. Probabilities are shares of time, `…_time_s` how long things last."""

    signals: Mapping[str, tuple[str, str]] = field(default_factory=lambda: dict(SIGNALS))
    lowest_elevation_deg: float = 5.0

    # Carrier to noise density: zenith, less by elevation, of the first and second frequency.
    zenith_cn0_dbhz: float = 49.0
    horizon_cn0_loss_db: float = 13.0
    second_cn0_loss_db: float = 2.0
    cn0_noise_db: float = 0.7
    code_tracked_above_dbhz: float = 24.0
    phase_tracked_above_dbhz: float = 33.0

    # One standard deviation at 45 dB-Hz, growing as 10^(−ΔC/N0 / 20).
    code_noise_m: float = 0.30
    second_code_factor: float = 0.7
    phase_noise_m: float = 1.5e-3
    doppler_noise_m_s: float = 0.03
    noise_factor: float = 1.0

    # What antenna and ground reflect: correlated, and larger as 1 / sin elevation.
    background_code_m: float = 0.2
    background_phase_m: float = 1.0e-3
    background_time_s: float = 8.0

    # Reflections of a signal that also comes directly: amplitude against it, its spread, how far one drives in one.
    reflection_amplitude: float = 0.2
    reflection_spread: float = 0.5
    reflection_length_m: float = 1.5
    reflection_time_s: float = 60.0
    reflection_reach_m: float = 100.0
    code_envelope_m: float = 15.0

    # Signals that come only by a wall.
    reflected_tracked: float = 0.3
    reflected_time_s: float = 4.0
    reflected_cn0_loss_db: float = 8.0
    reflected_phase_absent: float = 0.9

    # Signals bent over an edge: how far below it, and the errors there; code grows with the depth, phase as its square.
    diffraction_reach_deg: float = 6.0
    diffraction_code_m: float = 1.5
    diffraction_phase_m: float = 0.12

    # The second frequency is lost first: share of time between walls, none in the open.
    second_absent: float = 0.4
    second_absent_time_s: float = 3.0
    second_absent_enclosure: float = 0.4

    # Crowns of trees: a single one takes 10 to 20 dB at 869 MHz, 12 dB in the middle (W. J. Vogel and J. Goldhirsh,
    # IEEE Transactions on Antennas and Propagation 34 (1986)), along some eight metres.
    crown_loss_db_per_m: float = 1.3
    crown_loss_most_db: float = 20.0
    crown_code_m_per_db: float = 0.05
    crown_phase_m_per_db: float = 5.0e-4

    # Slips of the phase, at 45 dB-Hz per second and signal, ten times as many every 10 dB lower.
    slips_per_s: float = 2.0e-4
    slip_unseen: float = 0.02

    # After a lock of a signal without pilot its sign is known from data that the receiver can predict, or else, for
    # such a share, only after one to some subframe words of 0.6 s (IS-GPS-200N, 20.3.2); until then a flag says so. Of
    # signals that come over an edge or by a wall it is taken wrongly now and then, since they fade, and no flag says so
    # until the preamble of the next subframe, 6 s: so often at the weakest phase that is tracked, a tenth of that every
    # so many dB above. Noise alone does not do it: 33 dB-Hz are 16 dB for each bit, one wrong bit in 10¹⁸.
    half_cycle_after_lock: float = 0.3
    half_cycle_least_s: float = 0.6
    half_cycle_most_s: float = 3.0
    half_cycle_wrong_when_weak: float = 0.02
    half_cycle_wrong_decade_db: float = 4.0
    half_cycle_wrong_lasts_s: float = 6.0

    # The receiver's own clock: what is left of it after steering, and its drift.
    clock_bias_s: float = 2.0e-5
    clock_drift_s_s: float = 1.0e-8
    clock_walk_s_per_root_s: float = 1.0e-10


ROVER = SignalParameters()
BASE = SignalParameters(noise_factor=0.7, clock_bias_s=1.0e-7, clock_drift_s_s=1.0e-10)
"""A base station's antenna and receiver are better: noise and background by 0.7."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """One receiver of a simulation; its name and the seed make its random streams."""

    name: str
    seed: int
    parameters: SignalParameters

    def stream(self, name: str) -> np.random.Generator:
        """The generator of one of its errors."""
        return stream(self.seed, f"satellites/{self.name}/{name}")


@dataclass(frozen=True, slots=True, kw_only=True)
class SolutionParameters:
    """The receiver's engine. Sigmas are of one signal, rover and base together.

    Signals below the masks are left out, and what stands out of the rest by `sigmas_left_out`. The risk of wrong
    integers grows with the doubt (one less the success rate) and with the metres by which the code is off beyond two.
    """

    elevation_mask_deg: float = 15.0
    cn0_mask_dbhz: float = 33.0
    code_sigma_m: float = 0.6
    phase_sigma_m: float = 0.006
    sigmas_left_out: float = 4.0
    largest_dop: float = 25.0
    success_to_fix: float = 0.9
    fewest_ambiguities: int = 5
    search_s: float = 1.5
    wrong_by_doubt: float = 2.0
    wrong_by_code: float = 0.05
    wrong_at_most: float = 0.5
    wrong_lasts_s: float = 8.0
    # What antenna, air and filter do to right fixes beyond the signals' errors: half of them are within 0.013 m, in the
    # plane and up (u-blox, ZED-F9R integration manual, UBX-20039643, 2.1.4: 0.01 m + 1 ppm CEP; here 3 km).
    fix_plane_sigma_m: float = 0.011
    fix_up_sigma_m: float = 0.019
    fix_time_s: float = 30.0
    float_smoothing_s: float = 20.0
    single_bias_m: float = 0.8
    single_factor: float = 1.5
    velocity_sigma_m_s: float = 0.03
    ratio_to_fix: float = 3.0
