"""Velocity of a receiver and drift of its clock from one epoch's Doppler shifts.

Sources: Kikuchi (TUMSAT), `D_i = (f/c)(V_si − V_ui + s)·R_i`, four unknowns; IS-GPS-200N, 20.3.3.4.3.3.2 (earth's
rotation during the travel). Signs as in RINEX, positive when satellite and receiver approach one another:

    −(c/f) D = dρ/dt + c (drift − clock rate of the satellite).

With ρ(t) = |R(ω ρ/c) s(t − ρ/c) − r(t)| the rate is on both sides: dρ/dt = u · (v_s − v_r) / (1 + κ), where v_s is
rotated as the position is, u points from the receiver to the satellite and κ = (u · v_s − ω (u_x y − u_y x)) / c.

All bands of a satellite make one row, their mean by weight, as what moves the satellite's or the receiver's end moves
all of them. Variance of a band: (noise 10^((45 − C/N0) / 20))²; of a satellite that of the mean and (background / sin
el)², reflections that the bands share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers, ObservationEpoch
from camber.gnss.observations.satellite_states import (
    EARTH_ROTATION_RAD_S,
    enu_from_ecef_rotation,
    geodetic,
    range_to,
)
from camber.gnss.observations.signal_pairs import CARRIER_HZ, CHANNEL_HZ, MOST_BANDS, Booleans
from camber.gnss.position.robust_least_squares import (
    INCONSISTENT,
    OK,
    RobustFit,
    consistent_fit,
    empty_fit,
    empty_model,
    horizontal_dilution,
)
from camber.gnss.position.single_point import SinglePoint

Status = Literal["ok", "too_few", "degenerate", "inconsistent", "no_position"]
"""`no_position`: there is no approximate position, so there are no directions."""
_UNKNOWN = np.full((3, 3), np.nan)
_UNKNOWN.flags.writeable = False
_STATUS: tuple[Status, ...] = ("ok", "too_few", "degenerate", "inconsistent", "no_position")
_NO_POSITION = 4  # a status after those of `robust_least_squares`
_GREATEST_DOPPLER_HZ = 1.0e5  # derived: satellites 5 kHz, a receiver's clock at 50 ppm 80 kHz
# Chosen: mask, false-alarm rate of the test and standard deviations of the error model above.
_LOWEST_SINE = math.sin(math.radians(10.0))
_FALSE_ALARM = 1.0e-4  # chosen: one epoch in 10,000
_NOISE_M_S, _BACKGROUND_M_S = 0.03, 0.01


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DopplerVelocity:
    """Velocity over ground of one epoch; columns (m,) in the order of `SinglePoint.satellite`.

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
    used: Booleans
    excluded: Booleans


def doppler_velocity(epoch: ObservationEpoch, single: SinglePoint) -> DopplerVelocity:
    """Velocity of an epoch whose single point is known; it need not be consistent: 30 m off is 1 mm/s off.

    Never raises for what an epoch holds.
    """
    fit, excluded, hdop = _velocity(
        epoch.signal,
        epoch.doppler_hz,
        epoch.cn0_dbhz,
        satellite=single.satellite,
        place=single.codes.place,
        position_m=single.states.position_m,
        channel=single.states.channel,
        velocity_m_s=single.states.velocity_m_s,
        clock_rate=single.states.clock_rate,
        receiver_ecef_m=single.approximate_ecef_m,
    )
    ok = fit.status == OK
    return DopplerVelocity(
        time_ns=epoch.time_ns,
        status=_STATUS[fit.status],
        velocity_enu_m_s=fit.value[:3] if ok else _UNKNOWN[0],
        covariance_enu_m2_s2=fit.covariance[:3, :3] if ok else _UNKNOWN,
        clock_drift_m_s=float(fit.value[3]) if ok else np.nan,
        hdop=hdop,
        chi_squared=fit.chi_squared,
        degrees=fit.degrees,
        used=fit.used,
        excluded=excluded,
    )


@compiled
def range_rate_m_s(
    position_m: Floats, velocity_m_s: Floats, receiver_ecef_m: Floats, direction: Floats
) -> tuple[float, float]:
    """dρ/dt of a static receiver, and the divisor of its velocity along `direction` (3,).

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
    signal: Integers,
    doppler_hz: Floats,
    cn0_dbhz: Floats,
    satellite: Integers,
    place: Integers,
    channel: Floats,
    position_m: Floats,
    velocity_m_s: Floats,
    clock_rate: Floats,
    receiver_ecef_m: Floats,
) -> tuple[RobustFit, Booleans, float]:
    """Fit of velocity in east, north, up and clock drift to `_mean_rates`; excluded satellites (m,); HDOP.

    Unless the fit was tested, none is used or excluded. The columns cross to compiled code faster one by one than as
    tuples.
    """
    rate, weight = _mean_rates(
        signal, doppler_hz, cn0_dbhz, satellite=satellite, place=place, channel=channel
    )
    m = rate.size
    candidate, direction = np.zeros(m, np.bool_), np.empty(3)
    latitude, longitude, _ = geodetic(receiver_ecef_m)
    if not abs(latitude) < 2.0:
        return empty_fit(_NO_POSITION, m, 4), candidate, np.nan
    rotation = enu_from_ecef_rotation(latitude, longitude)
    model = empty_model(m, 4)
    for k in range(m):
        if not (weight[k] > 0.0 and clock_rate[k] == clock_rate[k]):
            continue
        static_rate, slope = range_rate_m_s(position_m[k], velocity_m_s[k], receiver_ecef_m, direction)
        for axis in range(3):
            model.design[k, axis] = -(
                rotation[axis, 0] * direction[0]
                + rotation[axis, 1] * direction[1]
                + rotation[axis, 2] * direction[2]
            )
        sine = -model.design[k, 2]
        if not sine >= _LOWEST_SINE:
            continue
        model.design[k, :3] /= slope
        model.design[k, 3] = 1.0
        model.observed[k] = rate[k] - static_rate + SPEED_OF_LIGHT_M_S * clock_rate[k]
        model.sigma[k] = math.sqrt(1.0 / weight[k] + (_BACKGROUND_M_S / sine) ** 2)
        candidate[k] = True
    fit = consistent_fit(model, candidate, _FALSE_ALARM)
    tested = fit.status in (OK, INCONSISTENT)
    for k in range(m):
        fit.used[k] &= tested
        candidate[k] &= tested and not fit.used[k]
    return fit, candidate, horizontal_dilution(model.design, fit.used) if fit.status == OK else np.nan


@compiled
def _mean_rates(
    signal: Integers,
    doppler_hz: Floats,
    cn0_dbhz: Floats,
    satellite: Integers,
    place: Integers,
    channel: Floats,
) -> tuple[Floats, Floats]:
    """−(c/f) D of each satellite (m,) and its weight, 0 where there is none; of each band the best C/N0 counts.

    `place` (n,) as in `Codes`.
    """
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
        of_row = _NOISE_M_S * 10.0 ** ((45.0 - level) / 20.0)
        if of_row < sigma[k, band]:
            best[k, band], sigma[k, band] = i, of_row
    for k in range(m):
        for band in range(MOST_BANDS):
            if best[k, band] >= 0:
                of_band = 1.0 / (sigma[k, band] * sigma[k, band])
                letter = satellite[k] >> 8
                carrier_hz = CARRIER_HZ[letter, band] + channel[k] * CHANNEL_HZ[letter, band]
                metres = SPEED_OF_LIGHT_M_S / carrier_hz
                total[k] -= of_band * doppler_hz[best[k, band]] * metres
                weight[k] += of_band
        if weight[k] > 0.0:
            total[k] /= weight[k]
    return total, weight
