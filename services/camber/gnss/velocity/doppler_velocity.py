"""Velocity of a receiver and drift of its clock from one epoch's Doppler shifts.

Sources: R (`D_i = (f/c)(V_si − V_ui + s)·R_i`, four unknowns); IS-GPS-200N, 20.3.3.4.3.3.2 (earth's rotation during the
travel). Signs as in RINEX: a Doppler shift is positive when satellite and receiver approach one another, so that

    −(c/f) D = dρ/dt + c (drift − clock rate of the satellite).

With ρ(t) = |R(ω ρ/c) s(t − ρ/c) − r(t)| the rate stands on both sides: dρ/dt = u · (v_s − v_r) / (1 + κ), where v_s is
turned as the position is, u points from the receiver to the satellite and κ = (u · v_s − ω (u_x y − u_y x)) / c.

All bands of a satellite make one row, their mean by weight, as what moves the satellite's or the receiver's end moves
all of them. Variance of a band: (noise 10^((45 − C/N0) / 20))²; of a satellite that of the mean and (background / sin
el)², reflections that the bands share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers, ObservationEpoch, satellite_name
from camber.gnss.observations.satellite_states import (
    EARTH_ROTATION_RAD_S,
    MOST_BANDS,
    SatelliteStates,
    enu_from_ecef_rotation,
    geodetic,
    range_to,
)
from camber.gnss.position.robust_least_squares import (
    DEGENERATE,
    INCONSISTENT,
    OK,
    TOO_FEW,
    Booleans,
    consistent_fit,
    dilutions,
)
from camber.gnss.position.single_point import CARRIER_HZ, SinglePoint

Status = Literal["ok", "too_few", "degenerate", "inconsistent", "no_position"]
"""`no_position`: the single point did not come anywhere, so there are no directions."""
_STATUS: dict[int, Status] = {
    OK: "ok",
    TOO_FEW: "too_few",
    DEGENERATE: "degenerate",
    INCONSISTENT: "inconsistent",
}


_GREATEST_DOPPLER_HZ = 1.0e5  # satellites 5 kHz, a receiver's clock at 50 ppm 80 kHz


class DopplerOptions(NamedTuple):
    """Mask, test and standard deviations of the module's error model."""

    lowest_elevation_rad: float = math.radians(10.0)
    false_alarm: float = 1.0e-4
    noise_m_s: float = 0.03
    background_m_s: float = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class DopplerVelocity:
    """Of one epoch, over the ground, at the epoch; columns (m,) in the order of `SinglePoint.satellite`.

    `velocity_enu_m_s` (3,), `covariance_enu_m2_s2` (3, 3), `clock_drift_m_s` (of the receiver, times c) and `hdop` are
    NaN unless the status is `ok`. `used`, `excluded`, `degrees` as in `SinglePoint`.
    """

    time_ns: int
    status: Status
    velocity_enu_m_s: Floats
    covariance_enu_m2_s2: Floats
    clock_drift_m_s: float
    hdop: float
    chi_squared: float
    degrees: int
    satellite: Integers
    used: Booleans
    excluded: Booleans
    residual_m_s: Floats

    @property
    def excluded_names(self) -> list[str]:
        """The satellites that contradicted the others, `["G05"]`."""
        return [satellite_name(s) for s in self.satellite[self.excluded].tolist()]


def doppler_velocity(
    epoch: ObservationEpoch,
    single: SinglePoint,
    options: DopplerOptions = DopplerOptions(),  # noqa: B008 (immutable)
) -> DopplerVelocity:
    """Velocity of an epoch whose single point is known; it need not be consistent: 30 m off is 1 mm/s off.

    Never raises for what an epoch holds.
    """
    status, velocity, covariance, numbers, degrees, used, excluded, residual = _velocity(
        single.satellite,
        single.codes.place,
        single.states,
        single.approximate_ecef_m,
        epoch.signal,
        epoch.doppler_hz,
        epoch.cn0_dbhz,
        options,
    )
    drift, hdop, chi_squared = numbers.tolist()
    return DopplerVelocity(
        epoch.time_ns, _STATUS.get(status, "no_position"), velocity, covariance, drift, hdop, chi_squared, degrees,
        single.satellite, used, excluded, residual,
    )  # fmt: skip


@compiled
def range_rate_m_s(
    position_m: Floats, velocity_m_s: Floats, receiver_ecef_m: Floats, direction: Floats
) -> tuple[float, float]:
    """dρ/dt of a receiver that stands on the ground, and what its own velocity along `direction` (3,) is divided by.

    `direction` is written: the unit vector from the receiver to the satellite, in the frame of reception.
    """
    distance = range_to(position_m, receiver_ecef_m, direction)
    angle = EARTH_ROTATION_RAD_S * distance / SPEED_OF_LIGHT_M_S
    x = position_m[0] + angle * position_m[1]
    y = position_m[1] - angle * position_m[0]
    vx = velocity_m_s[0] + angle * velocity_m_s[1]
    vy = velocity_m_s[1] - angle * velocity_m_s[0]
    along = direction[0] * vx + direction[1] * vy + direction[2] * velocity_m_s[2]
    turning = EARTH_ROTATION_RAD_S * (direction[0] * y - direction[1] * x)
    slope = 1.0 + (along - turning) / SPEED_OF_LIGHT_M_S
    return along / slope, slope


@compiled
def _velocity(
    satellite: Integers,
    place: Integers,
    states: SatelliteStates,
    receiver_ecef_m: Floats,
    signal: Integers,
    doppler_hz: Floats,
    cn0_dbhz: Floats,
    options: DopplerOptions,
) -> tuple[int, Floats, Floats, Floats, int, Booleans, Booleans, Floats]:
    m = satellite.size
    velocity, covariance, numbers = np.full(3, np.nan), np.full((3, 3), np.nan), np.full(3, np.nan)
    none = np.zeros(m, np.bool_)
    latitude, longitude, _ = geodetic(receiver_ecef_m)
    if not abs(latitude) < 2.0:
        return -1, velocity, covariance, numbers, 0, none, none, np.full(m, np.nan)
    rotation = enu_from_ecef_rotation(latitude, longitude)
    rate, weight = _mean_rates(satellite, place, signal, doppler_hz, cn0_dbhz, options)
    design, observed, sigma = np.zeros((m, 4)), np.zeros(m), np.ones(m)
    candidate, direction = np.zeros(m, np.bool_), np.empty(3)
    for k in range(m):
        if not (weight[k] > 0.0 and states.clock_rate[k] == states.clock_rate[k]):
            continue
        standing, slope = range_rate_m_s(
            states.position_m[k], states.velocity_m_s[k], receiver_ecef_m, direction
        )
        for axis in range(3):
            design[k, axis] = -(
                rotation[axis, 0] * direction[0]
                + rotation[axis, 1] * direction[1]
                + rotation[axis, 2] * direction[2]
            )
        sine = -design[k, 2]
        if not sine >= math.sin(options.lowest_elevation_rad):
            continue
        for axis in range(3):
            design[k, axis] /= slope
        design[k, 3] = 1.0
        observed[k] = rate[k] - standing + SPEED_OF_LIGHT_M_S * states.clock_rate[k]
        sigma[k] = math.sqrt(1.0 / weight[k] + (options.background_m_s / sine) ** 2)
        candidate[k] = True
    fit = consistent_fit(design, observed, sigma, np.full(4, np.inf), candidate, options.false_alarm)
    numbers[2] = fit.chi_squared
    excluded = candidate & ~fit.used
    if fit.status == OK:
        velocity[:], covariance[:, :] = fit.value[:3], fit.covariance[:3, :3]
        numbers[0] = fit.value[3]
        _, numbers[1], _ = dilutions(design, fit.used, np.eye(3))
    elif fit.status != INCONSISTENT:
        return fit.status, velocity, covariance, numbers, fit.degrees, none, none, fit.residual
    return fit.status, velocity, covariance, numbers, fit.degrees, fit.used, excluded, fit.residual


@compiled
def _mean_rates(
    satellite: Integers,
    place: Integers,
    signal: Integers,
    doppler_hz: Floats,
    cn0_dbhz: Floats,
    options: DopplerOptions,
) -> tuple[Floats, Floats]:
    """−(c/f) D of each satellite (m,) and its weight, 0 where there is none; of each band the best C/N0 counts."""
    m = satellite.size
    total, weight = np.zeros(m), np.zeros(m)
    best = np.full((m, MOST_BANDS), -1, np.int64)
    sigma = np.full((m, MOST_BANDS), np.inf)
    for i in range(place.size):
        k = place[i]
        if k < 0 or not abs(doppler_hz[i]) < _GREATEST_DOPPLER_HZ:
            continue
        band = (signal[i] >> 8) - 48
        level = cn0_dbhz[i] if 0.0 <= cn0_dbhz[i] < 100.0 else 40.0
        of_row = options.noise_m_s * 10.0 ** ((45.0 - level) / 20.0)
        if of_row < sigma[k, band]:
            best[k, band], sigma[k, band] = i, of_row
    for k in range(m):
        for band in range(MOST_BANDS):
            if best[k, band] >= 0:
                of_band = 1.0 / (sigma[k, band] * sigma[k, band])
                metres = SPEED_OF_LIGHT_M_S / CARRIER_HZ[satellite[k] >> 8, band]
                total[k] -= of_band * doppler_hz[best[k, band]] * metres
                weight[k] += of_band
        if weight[k] > 0.0:
            total[k] /= weight[k]
    return total, weight
