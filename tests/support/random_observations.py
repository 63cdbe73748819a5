"""Random but valid observations and ephemerides, for the writers and readers of streams."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from camber.formats.observations import Ephemeris, ObservationEpoch, satellite_number, signal_number

LIGHT_M_S = 299_792_458.0
SECOND_NS = 1_000_000_000
WEEK_NS = 604_800 * SECOND_NS
Carriers = Mapping[str, Mapping[str, float]]
"""By system and signal, Hz."""
COMMON: Carriers = {
    "G": {"1C": 1575.42e6, "2W": 1227.6e6, "2L": 1227.6e6, "5Q": 1176.45e6},
    "E": {"1C": 1575.42e6, "5Q": 1176.45e6, "7Q": 1207.14e6},
    "J": {"1C": 1575.42e6, "2L": 1227.6e6, "5Q": 1176.45e6},
    "C": {"2I": 1561.098e6, "7I": 1207.14e6, "6I": 1268.52e6, "5P": 1176.45e6, "1P": 1575.42e6},
}
MAX_NUMBER = {"G": 63, "E": 50, "J": 10, "C": 63}


def random_epoch(
    rng: np.random.Generator,
    time_ns: int,
    *,
    satellites: int = 12,
    carriers: Carriers = COMMON,
    missing: float = 0.15,
    most_range_m: float = 7.6e7,
) -> ObservationEpoch:
    """Random satellites of each system, each with some of its signals; a part `missing` of the values is NaN."""
    names, signals, wavelengths = [], [], []
    for system, known in carriers.items():
        count = int(rng.integers(0, min(satellites, MAX_NUMBER[system]) + 1))
        for number in rng.choice(np.arange(1, MAX_NUMBER[system] + 1), count, replace=False).tolist():
            chosen = [name for name in known if rng.random() < 0.7]
            names += [f"{system}{number:02d}"] * len(chosen)
            signals += chosen
            wavelengths += [LIGHT_M_S / known[name] for name in chosen]
    n = len(names)
    shuffled = rng.permutation(n)
    satellite = np.array([satellite_number(name) for name in names], np.int64)[shuffled]
    signal = np.array([signal_number(name) for name in signals], np.int64)[shuffled]
    wavelength = np.array(wavelengths)[shuffled]
    _, of = np.unique(satellite, return_inverse=True)
    groups = int(of.max()) + 1 if n else 0
    common = rng.uniform(1e3, most_range_m, groups)[of]
    pseudorange = common + rng.uniform(-140.0, 140.0, n)
    rate = rng.uniform(-8190.0, 8190.0, groups)[of] + rng.uniform(-0.55, 0.55, n)

    def holes(values: np.ndarray) -> np.ndarray:
        return np.where(rng.random(n) < missing, np.nan, values)

    return ObservationEpoch(
        time_ns=time_ns,
        satellite=satellite,
        signal=signal,
        pseudorange_m=holes(pseudorange),
        carrier_phase_cycles=holes((common + rng.uniform(-800.0, 800.0, n)) / wavelength),
        doppler_hz=holes(-rate / wavelength),
        cn0_dbhz=holes(rng.uniform(0.1, 63.9, n)),
        lock_time_s=holes(10.0 ** rng.uniform(-3.0, 5.5, n)),
        loss_of_lock=rng.random(n) < 0.1,
        half_cycle=rng.random(n) < 0.2,
    )


def random_toe_ns(rng: np.random.Generator, name: str, week: int) -> int:
    """A reference time of a satellite's ephemeris, often at the beginning or the end of its system's week."""
    step = {"C": 8, "E": 60}.get(name[0], 16)
    second = int(rng.choice([0, 604_800 - step, int(rng.integers(0, 604_800 // step)) * step]))
    return week * WEEK_NS + (second + (14 if name[0] == "C" else 0)) * SECOND_NS


def random_ephemeris(rng: np.random.Generator, name: str, toe_ns: int) -> Ephemeris:
    """Every field within the range of its system, often near the limit."""

    def around(most: float) -> float:
        return float(most * rng.choice([-0.96, 0.96, *rng.uniform(-0.96, 0.96, 4)]))

    system = name[0]
    # Half of the signed range: width and resolution by the interface documents.
    semicircle = math.pi
    angle = 2.0**17 * 2.0**-31 if system == "C" else 2.0**15 * 2.0**-29
    length = 2.0**17 * 2.0**-6 if system == "C" else 2.0**15 * 2.0**-5
    clock = {
        "C": (2.0**23 * 2.0**-33, 2.0**21 * 2.0**-50, 2.0**10 * 2.0**-66),
        "E": (2.0**30 * 2.0**-34, 2.0**20 * 2.0**-46, 2.0**5 * 2.0**-59),
    }.get(system, (2.0**21 * 2.0**-31, 2.0**15 * 2.0**-43, 2.0**7 * 2.0**-55))
    step_ns = {"C": 8, "E": 60}.get(system, 16) * SECOND_NS
    iode = int(rng.integers(0, {"C": 32, "E": 1024}.get(system, 256)))
    if system == "E":
        other = {"bgd_e5a_s": around(2.0**-23), "bgd_e5b_s": around(2.0**-23), "data_sources": 517.0}
    elif system == "C":
        other = {"tgd1_s": around(51.1e-9), "tgd2_s": around(51.1e-9), "aodc": float(rng.integers(0, 32))}
    else:
        other = {"tgd_s": around(2.0**-24), "iodc": float(rng.integers(0, 1024))}
        other["fit_interval_h"] = float(rng.choice([2.0, 4.0, 6.0]))
    return Ephemeris(
        satellite=satellite_number(name),
        toe_ns=toe_ns,
        toc_ns=toe_ns + int(rng.integers(-3, 4)) * 3 * 5 * 8 * step_ns,
        transmission_ns=toe_ns,
        iode=iode,
        clock=(around(clock[0]), around(clock[1]), around(clock[2])),
        sqrt_a=float(rng.uniform(5000.0, 8191.0)),
        eccentricity=float(rng.uniform(0.0, 0.499)),
        inclination_rad=around(semicircle),
        inclination_rate_rad_s=around(2.0**13 * 2.0**-43 * semicircle),
        ascending_node_rad=around(3.0 * semicircle),
        ascending_node_rate_rad_s=around(2.0**23 * 2.0**-43 * semicircle),
        perigee_rad=around(3.0 * semicircle),
        mean_anomaly_rad=around(3.0 * semicircle),
        mean_motion_difference_rad_s=around(2.0**15 * 2.0**-43 * semicircle),
        cuc=around(angle),
        cus=around(angle),
        crc_m=around(length),
        crs_m=around(length),
        cic=around(angle),
        cis=around(angle),
        accuracy_m=float(rng.uniform(0.0, 7.0)),
        health=int(rng.integers(0, {"C": 2, "E": 512}.get(system, 64))),
        other=other,
    )
