"""What a common receiver would have said: fixes on right and wrong integers, floats, single positions.

A state machine over the geometry of each epoch: a fix is taken when the success rate of its ambiguities allows and no
phase stands out of the rest, after a while of search; it may then be a wrong point of the lattice, the more easily the
weaker the geometry and the larger the code's error is. Wrong integers are held until the receiver finds out or has too
few satellites. What is left out is left out by elevation, C/N0 and residuals, so a right fix carries the reflections
that fit. Whether a fix is *wrong* is another question, of its distance from the truth: `formats.drive.truth_csv`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.satellites.differenced_geometry import (
    DifferencedGeometry,
    Screening,
    differenced_geometry,
)
from camber.simulator.satellites.observations import SimulatedSignals
from camber.simulator.satellites.track import AntennaTrack
from camber.simulator.satellites.wrong_integers import integers_at, shift_of, wrong_integers

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SolutionParameters:
    """The receiver's engine. Sigmas are of one signal, rover and base together."""

    elevation_mask_deg: float = 15.0
    cn0_mask_dbhz: float = 33.0
    code_sigma_m: float = 0.6
    phase_sigma_m: float = 0.006
    sigmas_left_out: float = 4.0
    largest_dop: float = 25.0
    success_to_fix: float = 0.9
    fewest_ambiguities: int = 5
    search_s: float = 1.5
    wrong_at_best: float = 0.0
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


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSolutions:
    """`solutions` in the order of time, none where the receiver had none; and the truth beside them.

    Columns over all n epochs of the track: `quality` (0: none), `error_m` (n, 3), spoofing included,
    `wrong_integers`, which may move a fix by less than what is called wrong, and `wrong_integers_since_ns`, the
    beginning of the episode, −1 where the integers are right or there is no fix.
    """

    solutions: list[ReceiverSolution]
    time_ns: Integers
    quality: Integers
    error_m: Floats
    wrong_integers: Booleans
    wrong_integers_since_ns: Integers


def receiver_solutions(
    rover: SimulatedSignals,
    base: SimulatedSignals,
    track: AntennaTrack,
    frame: LocalFrame,
    seed: int,
    parameters: SolutionParameters | None = None,
) -> SimulatedSolutions:
    """Of a simulated rover whose antenna truly moved along the track. Raises ValueError where their times differ."""
    if not np.array_equal(rover.time_ns, track.time_ns):
        raise ValueError("rover and track have different times")
    p = parameters or SolutionParameters()
    screening = Screening(
        float(np.deg2rad(p.elevation_mask_deg)), p.cn0_mask_dbhz, p.sigmas_left_out, p.sigmas_left_out
    )
    geometry = differenced_geometry(rover, base, p.code_sigma_m, p.phase_sigma_m, screening)
    rng = stream(seed, "satellites/solution")
    n = len(track.time_ns)
    dt = np.diff(track.time_ns, prepend=track.time_ns[:1]) / NS_PER_SECOND
    ready = (
        (geometry.success >= p.success_to_fix)
        & (geometry.ambiguities >= p.fewest_ambiguities)
        & geometry.phase_fits
        & (_dilution(geometry.phase_normal) <= p.largest_dop)
        & rover.running
    )
    fixed, since, shift = _fixes(rover, geometry, ready, dt, p, rng)
    wrong = since >= 0

    has_code = (np.linalg.det(geometry.code_normal) > 1e-6) & (geometry.code_satellites >= 4) & rover.running
    differenced = has_code & (geometry.phase_satellites >= 4)
    smooth = _smoothed(geometry.code_solution_m, differenced, dt, p.float_smoothing_s)
    slow = gauss_markov(rng.normal(size=(n, 3)), memory_of(dt, 300.0))
    single = p.single_factor * geometry.code_solution_m + p.single_bias_m * slow * np.array([1.0, 1.0, 2.0])
    spread = np.array([p.fix_plane_sigma_m, p.fix_plane_sigma_m, p.fix_up_sigma_m])
    unexplained = spread * gauss_markov(rng.normal(size=(n, 3)), memory_of(dt, p.fix_time_s))
    quality = np.select(
        [fixed, differenced, has_code],
        [int(SolutionQuality.FIX), int(SolutionQuality.FLOAT), int(SolutionQuality.SINGLE)],
        0,
    )
    error = np.select(
        [fixed[:, None], differenced[:, None], has_code[:, None]],
        [geometry.phase_solution_m + unexplained + shift, smooth, single],
        0.0,
    )
    error = np.where(quality[:, None] > 0, error + rover.antenna_offset_m, 0.0)
    ratio = np.where(
        fixed, p.ratio_to_fix * (1.0 + rng.exponential(np.where(wrong, 0.4, 4.0))), 1.0 + rng.random(n)
    )
    velocity = track.antenna_velocity_m_s + p.velocity_sigma_m_s * rng.normal(size=(n, 3))
    solutions = _as_solutions(rover, geometry, track, frame, quality, error, ratio, velocity, p)
    since_ns = np.where(wrong, track.time_ns[np.maximum(since, 0)], -1)
    return SimulatedSolutions(solutions, track.time_ns, quality.astype(np.int64), error, wrong, since_ns)


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
    p: SolutionParameters,
    rng: np.random.Generator,
) -> tuple[Booleans, Integers, Floats]:
    """Is there a fix (n,), the row where its wrong episode began or −1, the shift by its wrong integers (n, 3)."""
    n = len(ready)
    fixed = np.zeros(n, np.bool_)
    since = np.full(n, -1, np.int64)
    shift = np.zeros((n, 3))
    draws = rng.random((n, 2))
    code_off = np.sqrt(np.sum(geometry.code_solution_m**2, axis=1))
    doubt = (
        p.wrong_at_best
        + p.wrong_by_doubt * (1.0 - geometry.success)
        + p.wrong_by_code * np.maximum(code_off - 2.0, 0)
    )
    risk = np.minimum(doubt, p.wrong_at_most)
    began, offset, known, moved = (
        -1,
        np.zeros(geometry.wavelength_m.shape),
        np.zeros((0, 0), np.bool_),
        np.zeros(3),
    )
    for k in range(n):
        used, directions = geometry.phase_used[k], rover.geometry.direction[k]
        if not ready[k]:
            began = -1
            continue
        if k and fixed[k - 1] and began < 0:
            fixed[k] = True
            continue
        if began >= 0:
            found = None
            if draws[k, 0] >= dt[k] / p.wrong_lasts_s:
                offset = integers_at(
                    moved, offset, known, directions, used, geometry.group, geometry.wavelength_m
                )
                found = shift_of(offset, directions, used, geometry.group, geometry.wavelength_m)
            if found is None or not offset.any():
                began = -1
                continue
            known, moved = used, found
        elif draws[k, 0] < (1.0 if k == 0 else 1.0 - np.exp(-dt[k] / p.search_s)):
            if draws[k, 1] < risk[k]:
                new = wrong_integers(
                    directions, used, geometry.group, geometry.wavelength_m, geometry.code_normal[k],
                    geometry.code_solution_m[k], p.code_sigma_m, p.phase_sigma_m, rng,
                )  # fmt: skip
                if new is not None:
                    began, offset, known = k, new.offset_cycles, used
                    found = shift_of(offset, directions, used, geometry.group, geometry.wavelength_m)
                    moved = new.shift_m if found is None else found
        else:
            continue
        fixed[k] = True
        if began >= 0:
            since[k], shift[k] = began, moved
    return fixed, since, shift


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


def _as_solutions(
    rover: SimulatedSignals,
    geometry: DifferencedGeometry,
    track: AntennaTrack,
    frame: LocalFrame,
    quality: Integers,
    error_m: Floats,
    ratio: Floats,
    velocity_m_s: Floats,
    p: SolutionParameters,
) -> list[ReceiverSolution]:
    place = track.antenna_m + error_m
    latitude, longitude, height = frame.geodetic_from_east_north_array(place[:, :2], place[:, 2])
    fix, single = int(SolutionQuality.FIX), int(SolutionQuality.SINGLE)
    velocity_variance = p.velocity_sigma_m_s**2
    said = []
    for k in np.nonzero(quality)[0]:
        is_fix = quality[k] == fix
        normal = geometry.phase_normal[k] if is_fix else geometry.code_normal[k]
        sigma = p.phase_sigma_m if is_fix else p.code_sigma_m * (3.0 if quality[k] == single else 1.0)
        c = np.linalg.inv(normal) * sigma**2
        if is_fix:
            c += np.diag([p.fix_plane_sigma_m**2, p.fix_plane_sigma_m**2, p.fix_up_sigma_m**2])
        covariance: EnuCovariance = (c[0, 0], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2])
        used = geometry.phase_satellites[k] if is_fix else geometry.code_satellites[k]
        differential = quality[k] != single
        said.append(
            ReceiverSolution(
                time_ns=int(track.time_ns[k]),
                latitude_rad=float(latitude[k]),
                longitude_rad=float(longitude[k]),
                height_m=float(height[k]),
                quality=SolutionQuality(int(quality[k])),
                satellites=int(used),
                covariance_enu_m2=tuple(float(v) for v in covariance),  # type: ignore[arg-type]
                age_s=float(track.time_ns[k] % NS_PER_SECOND) / NS_PER_SECOND if differential else None,
                ratio=float(ratio[k]) if differential else None,
                velocity_enu_m_s=tuple(float(v) for v in velocity_m_s[k]),  # type: ignore[arg-type]
                velocity_covariance_enu_m2_s2=(
                    velocity_variance,
                    0.0,
                    0.0,
                    velocity_variance,
                    0.0,
                    velocity_variance,
                ),
            )
        )
    return said
