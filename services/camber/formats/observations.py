"""Satellite observations and broadcast ephemerides as tables: what RINEX, RTCM and UBX hold, whatever the format.

Satellites are `system letter × 256 + number` as in `camber.schemas.gnss.Observations` (QZSS: J and the RINEX number,
J01 is PRN 193); signals are the two characters of RINEX 3 (`1C`) as ASCII, first × 256 + second. Times are GPS time
in ns since 1980-01-06.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SPEED_OF_LIGHT_M_S = 299_792_458.0

CARRIER_OF_BAND_HZ: dict[str, dict[str, float]] = {
    "G": {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6},
    "J": {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6, "6": 1278.75e6},
    "E": {"1": 1575.42e6, "5": 1176.45e6, "6": 1278.75e6, "7": 1207.14e6, "8": 1191.795e6},
    "C": {"1": 1575.42e6, "2": 1561.098e6, "5": 1176.45e6, "6": 1268.52e6, "7": 1207.14e6, "8": 1191.795e6},
}
"""Carrier frequency by system and band, the first character of a signal's code (RINEX 3.04, tables 4 to 9)."""


def carrier_hz(system: str, signal: str) -> float:
    """Of a signal such as `1C` of a system letter; KeyError for a band that the system has not got."""
    return CARRIER_OF_BAND_HZ[system][signal[0]]


def satellite_number(name: str) -> int:
    """`G05` → its number."""
    return ord(name[0]) * 256 + int(name[1:])


def satellite_name(number: int) -> str:
    """The other way."""
    return f"{chr(number >> 8)}{number & 255:02d}"


def signal_number(name: str) -> int:
    """`1C` → its number."""
    return ord(name[0]) * 256 + ord(name[1])


def signal_name(number: int) -> str:
    """The other way."""
    return f"{chr(number >> 8)}{chr(number & 255)}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObservationEpoch:
    """One epoch at one receiver: one row a signal, columns (n,); NaN where a value was not observed.

    `time_ns` is the receiver's own time tag. `loss_of_lock`: the phase is not continuous with the last epoch's.
    `half_cycle`: the phase may be off by half a cycle. `lock_time_s`: since the phase was last broken.
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
    """One broadcast ephemeris: the Keplerian set of IS-GPS-200 20.3.3.4.3, used alike by GPS, QZSS, Galileo, BeiDou.

    Angles in rad, rates in rad/s, `sqrt_a` in √m. `toe_ns`, `toc_ns`, `transmission_ns` are GPS time, whatever the
    system's own. `clock` is (af0 s, af1 s/s, af2 s/s²). `other` holds what only one system has, by RINEX 3.04's name
    in snake case: `tgd_s`, `iodc`, `fit_interval_h`, `bgd_e5a_s`, `bgd_e5b_s`, `data_sources`, `tgd1_s`, `tgd2_s`,
    `aodc`.
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
