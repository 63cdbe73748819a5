"""Satellite observations and broadcast ephemerides of RINEX, RTCM, UBX and SBF, independent of the format.

Satellites are `system letter × 256 + number` as in `camber.schemas.gnss.Observations` (QZSS: J and the RINEX number,
J01 is PRN 193); signals are the two characters of RINEX 3 (`1C`) as ASCII, first × 256 + second. Times are GPS time
in ns since 1980-01-06.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_SECOND

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SPEED_OF_LIGHT_M_S = 299_792_458.0  # exact, SI
GPS_MINUS_BDT_NS = 14 * NS_PER_SECOND
"""BeiDou time has no leap seconds since 2006-01-01: BDS-SIS-ICD-B1I, 3.2."""
MAX_SATELLITE_NUMBER = {"G": 63, "J": 10, "E": 63, "C": 63, "R": 32}
"""Six bits in RTCM 10403.3 (DF009, DF252, DF488); QZSS has PRN 193 to 202 (IS-QZSS-PNT); slots of GLONASS are 1 to 24,
and u-blox numbers up to 32 (UBX-18010854, 1.5.2)."""

CARRIER_OF_BAND_HZ: dict[str, dict[str, float]] = {
    "G": {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6},
    "J": {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6, "6": 1278.75e6},
    "E": {"1": 1575.42e6, "5": 1176.45e6, "6": 1278.75e6, "7": 1207.14e6, "8": 1191.795e6},
    "C": {"1": 1575.42e6, "2": 1561.098e6, "5": 1176.45e6, "6": 1268.52e6, "7": 1207.14e6, "8": 1191.795e6},
    "R": {"1": 1602.0e6, "2": 1246.0e6, "3": 1202.025e6, "4": 1600.995e6, "6": 1248.06e6},
}
"""Carrier frequency by system and band, the first character of a signal's code (RINEX 3.04, tables 4 to 9); in bands 1
and 2 of GLONASS that of channel 0."""
CHANNEL_STEP_HZ = {"1": 562.5e3, "2": 437.5e3}
"""By band of GLONASS, the distance of neighbouring frequency channels (ICD GLONASS 5.1, 3.3.1.1)."""
GLONASS_CHANNELS = range(-7, 14)
"""ICD GLONASS 5.1, 3.3.1.1: −7 to 6 since 2005, 0 to 13 before."""


def carrier_hz(system: str, signal: str) -> float:
    """Return the carrier of a signal such as `1C` (GLONASS: of channel 0); KeyError for a band that is not used."""
    return CARRIER_OF_BAND_HZ[system][signal[0]]


def satellite_number(name: str) -> int:
    """Return the number of a satellite such as `G05`."""
    return ord(name[0]) * 256 + int(name[1:])


def satellite_name(number: int) -> str:
    """Return the name of a satellite, such as `G05`."""
    return f"{chr(number >> 8)}{number & 255:02d}"


def signal_number(name: str) -> int:
    """Return the number of a signal such as `1C`."""
    return ord(name[0]) * 256 + ord(name[1])


def signal_name(number: int) -> str:
    """Return the name of a signal, such as `1C`."""
    return f"{chr(number >> 8)}{chr(number & 255)}"


OBSERVABLES = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz")
"""Columns of an `ObservationEpoch` in RINEX's order."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObservationEpoch:
    """One epoch at one receiver: columns (n,) with one row per signal; NaN where a value was not observed.

    `time_ns` is the receiver's time tag. `loss_of_lock`: the phase is not continuous with that of the last epoch.
    `half_cycle`: half-cycle ambiguity not resolved. `lock_time_s`: time since the last loss of lock.
    """

    time_ns: int
    satellite: Integers
    signal: Integers
    pseudorange_m: Floats
    carrier_phase_cycles: Floats
    doppler_hz: Floats
    cn0_dbhz: Floats
    lock_time_s: Floats
    loss_of_lock: NDArray[np.bool_]
    half_cycle: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ephemeris:
    """One broadcast ephemeris: the Keplerian set of IS-GPS-200 20.3.3.4.3, also used by QZSS, Galileo and BeiDou.

    Angles in rad, rates in rad/s, `sqrt_a` in √m. `toe_ns`, `toc_ns`, `transmission_ns` are GPS time for every system.
    `clock` is (af0 s, af1 s/s, af2 s/s²). `other` contains the system-specific values, named as in RINEX 3.04:
    `tgd_s`, `iodc`, `fit_interval_h`, `bgd_e5a_s`, `bgd_e5b_s`, `data_sources`, `tgd1_s`, `tgd2_s`, `aodc`.
    """

    satellite: int
    toe_ns: int
    toc_ns: int
    transmission_ns: int
    iode: int
    clock: tuple[float, float, float]
    sqrt_a: float
    eccentricity: float
    inclination_rad: float
    inclination_rate_rad_s: float
    ascending_node_rad: float
    ascending_node_rate_rad_s: float
    perigee_rad: float
    mean_anomaly_rad: float
    mean_motion_difference_rad_s: float
    cuc: float
    cus: float
    crc_m: float
    crs_m: float
    cic: float
    cis: float
    accuracy_m: float
    health: int
    other: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class GlonassEphemeris:
    """One broadcast ephemeris of GLONASS: a state that is integrated (ICD GLONASS 5.1, 4.4, A.3.1.2).

    `toe_ns` is t_b, `transmission_ns` the frame's time, both GPS time. Position [m], velocity [m/s] and acceleration by
    moon and sun [m/s²] at t_b are in PZ-90 (ECEF). `clock` is (−τ_n s, γ_n s/s): the satellite's clock minus its
    system's time. `channel`: frequency channel. `health` is zero if the satellite is healthy. `group_delay_s`: Δτ_n,
    delay of L2 less that of L1; NaN where it is not known.
    """

    satellite: int
    toe_ns: int
    transmission_ns: int
    iode: int
    channel: int
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]
    clock: tuple[float, float]
    health: int
    group_delay_s: float

    @property
    def toc_ns(self) -> int:
        """Reference time of the clock: t_b, too."""
        return self.toe_ns


BroadcastEphemeris = Ephemeris | GlonassEphemeris
"""An ephemeris of any system."""
