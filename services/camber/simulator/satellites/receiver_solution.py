"""What a common receiver would have reported: fixes on right and wrong integers, floats, single positions.

A state machine over the geometry of each epoch: a fix is taken when the success rate of its ambiguities allows and no
phase stands out of the rest, after a while of search; it may then be a wrong point of the lattice, the more easily the
weaker the geometry and the larger the code's error is. Wrong integers are held until the receiver finds out or has too
few satellites. What is left out is left out by elevation, C/N0 and residuals, so a right fix carries the reflections
that fit. Whether a fix is *wrong* is another question, of its distance from the truth: `formats.drive.truth_csv`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.satellites.differenced_geometry import DifferencedGeometry, differenced_geometry
from camber.simulator.satellites.observations import SimulatedSignals
from camber.simulator.satellites.parameters import SolutionParameters
from camber.simulator.satellites.track import AntennaTrack
from camber.simulator.satellites.wrong_integers import (
    PhaseSignals,
    integers_at,
    shift_of,
    wrong_integers,
)
from camber.simulator.scene import Booleans, Floats, Integers

_P = SolutionParameters()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SimulatedSolutions:
    """`solutions` in the order of time, none where the receiver had none; and their truth.

    Columns over all n epochs of the track: `quality` (0: none), `error_m` (n, 3), spoofing included, and
    `wrong_integers`, which may move a fix by less than what is called wrong.
    """

    solutions: list[ReceiverSolution]
    quality: Integers
    error_m: Floats
    wrong_integers: Booleans


def receiver_solutions(
    rover: SimulatedSignals, base: SimulatedSignals, track: AntennaTrack, frame: LocalFrame, seed: int
) -> SimulatedSolutions:
    """Of a simulated rover whose antenna truly moved along the track; both have the same times."""
    p, geometry = _P, differenced_geometry(rover, base, _P)
    rng = stream(seed, "satellites/solution")
    n = len(track.time_ns)
    dt = np.diff(track.time_ns, prepend=track.time_ns[:1]) / NS_PER_SECOND
    ready = (
        (geometry.success >= p.success_to_fix)
        & (geometry.ambiguities >= p.fewest_ambiguities)
        & geometry.phase_fits
        & (_dilution(geometry.phase_normal) <= p.largest_dop)
    )
    fixed, wrong, shift = _fixes(rover, geometry, ready, dt, rng=rng)

    has_code = (np.linalg.det(geometry.code_normal) > 1e-6) & (geometry.code_satellites >= 4)
    differenced = has_code & (geometry.phase_satellites >= 4)
    smooth = _smoothed(geometry.code_solution_m, differenced, dt, p.float_smoothing_s)
    slow = gauss_markov(rng.normal(size=(n, 3)), memory_of(dt, 300.0))
    single = p.single_factor * geometry.code_solution_m + p.single_bias_m * slow * np.array([1.0, 1.0, 2.0])
    spread = np.array([p.fix_plane_sigma_m, p.fix_plane_sigma_m, p.fix_up_sigma_m])
    unexplained = spread * gauss_markov(rng.normal(size=(n, 3)), memory_of(dt, p.fix_time_s))
    states = [fixed, differenced, has_code]
    qualities = (SolutionQuality.FIX, SolutionQuality.FLOAT, SolutionQuality.SINGLE)
    quality = np.select(states, [int(one) for one in qualities], 0)
    errors = [geometry.phase_solution_m + unexplained + shift, smooth, single]
    error = np.select([state[:, None] for state in states], errors, 0.0)
    error = np.where(quality[:, None] > 0, error + rover.antenna_offset_m, 0.0)
    ratio_of_fix = p.ratio_to_fix * (1.0 + rng.exponential(np.where(wrong, 0.4, 4.0)))
    ratio = np.where(fixed, ratio_of_fix, 1.0 + rng.random(n))
    velocity = track.antenna_velocity_m_s + p.velocity_sigma_m_s * rng.normal(size=(n, 3))
    place = track.antenna_m + error
    geodetic = frame.geodetic_from_east_north_array(place[:, :2], place[:, 2])
    rows = np.flatnonzero(quality).tolist()
    columns = (track.time_ns, np.column_stack(geodetic), quality, ratio, velocity)
    solutions = [_solution(geometry, k, *(column[k] for column in columns)) for k in rows]
    return SimulatedSolutions(
        solutions=solutions, quality=quality.astype(np.int64), error_m=error, wrong_integers=wrong
    )


def _dilution(normal: Floats) -> Floats:
    """√ trace N⁻¹ (n,), infinite where N has no inverse."""
    solvable = np.linalg.det(normal) > 1e-6
    inverse = np.linalg.inv(np.where(solvable[:, None, None], normal, np.eye(3)))
    return np.where(solvable, np.sqrt(np.trace(inverse, axis1=1, axis2=2)), np.inf)


def _fixes(
    rover: SimulatedSignals,
    geometry: DifferencedGeometry,
    ready: Booleans,
    dt: Floats,
    *,
    rng: np.random.Generator,
) -> tuple[Booleans, Booleans, Floats]:
    """Is there a fix (n,), is it on wrong integers, and the shift by them (n, 3)."""
    p, n = _P, len(ready)
    fixed, wrong = np.zeros((2, n), np.bool_)
    shift = np.zeros((n, 3))
    draws = rng.random((n, 2))
    code_off = np.sqrt(np.sum(geometry.code_solution_m**2, axis=1))
    doubt = p.wrong_by_doubt * (1.0 - geometry.success) + p.wrong_by_code * np.maximum(code_off - 2.0, 0)
    risk = np.minimum(doubt, p.wrong_at_most)
    holds_wrong, offset = False, np.zeros(geometry.wavelength_m.shape)
    known, moved = np.zeros((0, 0), np.bool_), np.zeros(3)
    for k in range(n):
        if not ready[k]:
            holds_wrong = False
            continue
        if k and fixed[k - 1] and not holds_wrong:
            fixed[k] = True
            continue
        signals = PhaseSignals(
            directions=rover.geometry.direction[k],
            used=geometry.phase_used[k],
            group=geometry.group,
            wavelength_m=geometry.wavelength_m,
        )
        if holds_wrong:
            shifted = None
            if draws[k, 0] >= dt[k] / p.wrong_lasts_s:
                offset = integers_at(moved, offset, known, signals)
                shifted = shift_of(offset, signals)
            if shifted is None or not offset.any():
                holds_wrong = False
                continue
            known, moved = signals.used, shifted
        elif draws[k, 0] < (1.0 if k == 0 else 1.0 - np.exp(-dt[k] / p.search_s)):
            if draws[k, 1] < risk[k]:
                normal, error_m = geometry.code_normal[k], geometry.code_solution_m[k]
                new = wrong_integers(signals, normal, error_m, engine=p, rng=rng)
                if new is not None:
                    holds_wrong, (offset, at), known = True, new, signals.used
                    shifted = shift_of(offset, signals)
                    moved = at if shifted is None else shifted
        else:
            continue
        fixed[k] = True
        if holds_wrong:
            wrong[k], shift[k] = True, moved
    return fixed, wrong, shift


def _smoothed(error: Floats, valid: Booleans, dt: Floats, time_s: float) -> Floats:
    """Code errors averaged along the phase, begun anew where there was a gap."""
    out = np.zeros_like(error)
    age = 0.0
    for k in range(len(error)):
        if not valid[k]:
            age = 0.0
            continue
        step = float(dt[k]) if dt[k] > 0.0 else 1.0
        age = min(age + step, time_s)
        gain = step / age if age > 0.0 else 1.0
        out[k] = error[k] if gain >= 1.0 else out[k - 1] + gain * (error[k] - out[k - 1])
    return out


def _solution(geometry: DifferencedGeometry, k: int, *columns: Any) -> ReceiverSolution:
    """Of epoch k: time, latitude, longitude and height, quality, ratio, velocity."""
    time_ns, (latitude, longitude, height), quality, ratio, velocity = columns
    p, is_fix, is_single = _P, quality == SolutionQuality.FIX, quality == SolutionQuality.SINGLE
    normal = geometry.phase_normal[k] if is_fix else geometry.code_normal[k]
    sigma = p.phase_sigma_m if is_fix else p.code_sigma_m * (3.0 if is_single else 1.0)
    c = np.linalg.inv(normal) * sigma**2
    if is_fix:
        c += np.diag([p.fix_plane_sigma_m**2, p.fix_plane_sigma_m**2, p.fix_up_sigma_m**2])
    age_s = float(time_ns % NS_PER_SECOND) / NS_PER_SECOND
    v = p.velocity_sigma_m_s**2
    return ReceiverSolution(
        time_ns=int(time_ns),
        latitude_rad=float(latitude),
        longitude_rad=float(longitude),
        height_m=float(height),
        quality=SolutionQuality(int(quality)),
        satellites=int((geometry.phase_satellites if is_fix else geometry.code_satellites)[k]),
        covariance_enu_m2=tuple(c[np.triu_indices(3)].tolist()),
        age_s=None if is_single else age_s,
        ratio=None if is_single else float(ratio),
        velocity_enu_m_s=tuple(velocity.tolist()),
        velocity_covariance_enu_m2_s2=(v, 0.0, 0.0, v, 0.0, v),
    )
