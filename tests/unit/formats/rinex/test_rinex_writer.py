"""Written RINEX files, decoded by simple readers that follow the columns of the standard's tables."""

from dataclasses import replace

import numpy as np
import pytest

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, ObservationEpoch, satellite_number, signal_number
from camber.formats.rinex.writer import StationHeader, navigation_text
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst
from support.gnss_files import observation_text
from support.random_observations import random_ephemeris
from support.simple_rinex import epochs_of, header_of

BEGIN_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 23, 59, 59, 900_000_000))
STATION = StationHeader(marker="ROVER", position_ecef_m=(-3810975.7625, 3566658.9114, 3653334.735))


def epoch(number: int, rng: np.random.Generator) -> ObservationEpoch:
    pairs = [("C01", "2I"), ("C01", "7I"), ("E05", "1X"), ("G02", "1C"), ("G02", "2L"), ("J07", "2L")]
    n = len(pairs)
    phase = rng.uniform(-1e6, 2e8, n)
    phase[2] = np.nan
    return ObservationEpoch(
        time_ns=BEGIN_NS + number * NS_PER_SECOND // 10,
        satellite=np.array([satellite_number(s) for s, _ in pairs]),
        signal=np.array([signal_number(s) for _, s in pairs]),
        pseudorange_m=rng.uniform(2e7, 4e7, n),
        carrier_phase_cycles=phase,
        doppler_hz=rng.uniform(-5e3, 5e3, n),
        cn0_dbhz=np.array([20.0, 30.1, 45.0, 53.9, 60.0, 3.0]),
        lock_time_s=np.full(n, 2.0),
        loss_of_lock=np.array([True, False, False, False, True, False]),
        half_cycle=np.array([False, True, False, False, True, False]),
    )


def test_indicators_follow_the_values():
    ((_, values),) = epochs_of(observation_text([epoch(0, np.random.default_rng(1))], STATION))
    keys = (("C01", "L2I"), ("C01", "L7I"), ("G02", "L1C"), ("G02", "L2L"), ("J07", "L2L"))
    assert [values[key][1] for key in keys[:4]] == ["1", "2", " ", "3"]
    assert [values[key][2] for key in keys] == ["3", "5", "8", "9", "1"]


def test_header_has_all_required_records_in_80_columns():
    text = observation_text([epoch(k, np.random.default_rng(1)) for k in range(2)], STATION)
    labels, _ = header_of(text)
    required = (
        "RINEX VERSION / TYPE", "PGM / RUN BY / DATE", "MARKER NAME", "MARKER TYPE", "OBSERVER / AGENCY",
        "REC # / TYPE / VERS", "ANT # / TYPE", "APPROX POSITION XYZ", "ANTENNA: DELTA H/E/N", "SYS / # / OBS TYPES",
        "TIME OF FIRST OBS", "SYS / PHASE SHIFT", "END OF HEADER",
    )  # fmt: skip
    assert set(required) <= set(labels)
    head = text[: text.index("END OF HEADER")].splitlines()
    assert max(map(len, head)) <= 80
    assert text.isascii()


def test_empty_file_and_repeated_signal_are_refused():
    with pytest.raises(ValueError, match="needs an epoch"):
        observation_text([], STATION)
    twice = epoch(0, np.random.default_rng(1))
    twice.signal[1] = twice.signal[0]
    with pytest.raises(ValueError, match="C01 has 2I twice"):
        observation_text([twice], STATION)


def ephemeris(name: str, **other: float) -> Ephemeris:
    toe_ns = BEGIN_NS // (3600 * NS_PER_SECOND) * 3600 * NS_PER_SECOND
    return replace(
        random_ephemeris(np.random.default_rng(satellite_number(name)), name, toe_ns),
        toc_ns=BEGIN_NS // NS_PER_SECOND * NS_PER_SECOND,
        transmission_ns=BEGIN_NS - 600 * NS_PER_SECOND,
        iode=77,
        accuracy_m=2.0,
        health=0,
        other=other,
    )


SETS = [
    ephemeris("G05", tgd_s=-1e-8, iodc=77.0, fit_interval_h=4.0),
    ephemeris("J02", tgd_s=2e-9, iodc=77.0, fit_interval_h=2.0),
    ephemeris("E11", bgd_e5a_s=1e-9, bgd_e5b_s=2e-9, data_sources=517.0),
    ephemeris("C30", tgd1_s=3e-9, tgd2_s=-4e-9, aodc=1.0),
]


def read_navigation(text: str):
    """Numbers of each record by its satellite, and its calendar time."""
    lines = text.splitlines()
    at = next(k for k, line in enumerate(lines) if line[60:].startswith("END OF HEADER")) + 1
    decoded = {}
    for k in range(at, len(lines), 8):
        calendar = tuple(int(v) for v in lines[k][3:23].split())
        numbers = [float(lines[k][c : c + 19]) for c in (23, 42, 61)]
        for line in lines[k + 1 : k + 8]:
            numbers += [float(line[c : c + 19]) for c in range(4, len(line), 19)]
        decoded[lines[k][:3]] = (calendar, numbers)
    return decoded


@pytest.mark.parametrize("e", SETS, ids=lambda e: chr(e.satellite >> 8))
def test_written_ephemerides_have_12_digits_in_system_time(e):
    system = chr(e.satellite >> 8)
    ((calendar, n),) = read_navigation(navigation_text([e])).values()
    shift_ns = 14 * NS_PER_SECOND if system == "C" else 0
    assert gps_ns_from_gpst(CalendarTime(*calendar)) + shift_ns == e.toc_ns
    weeks = 1356 if system == "C" else 0
    week_ns = 7 * 86400 * NS_PER_SECOND
    assert round((n[21] + weeks) * week_ns + n[11] * 1e9) + shift_ns == e.toe_ns
    assert round((n[21] + weeks) * week_ns + n[27] * 1e9) + shift_ns == e.transmission_ns
    broadcast = [
        *e.clock, float(e.iode), e.crs_m, e.mean_motion_difference_rad_s, e.mean_anomaly_rad, e.cuc, e.eccentricity,
        e.cus, e.sqrt_a, n[11], e.cic, e.ascending_node_rad, e.cis, e.inclination_rad, e.crc_m, e.perigee_rad,
        e.ascending_node_rate_rad_s, e.inclination_rate_rad_s,
    ]  # fmt: skip
    assert n[:20] == pytest.approx(broadcast, rel=1e-12, abs=1e-30)
    assert n[23:25] == [e.accuracy_m, 0.0]
    delays = {"E": ("bgd_e5a_s", "bgd_e5b_s"), "C": ("tgd1_s", "tgd2_s")}.get(system, ("tgd_s", "iodc"))
    assert n[25:27] == [e.other[name] for name in delays]
    # Data sources; hours; a flag: not more than two hours.
    index, value = {"E": (20, 517.0), "G": (28, 4.0), "J": (28, 0.0), "C": (28, 1.0)}[system]
    assert n[index] == value


def test_header_contains_the_ionosphere_and_unknown_systems_are_refused():
    gps = IonosphereCoefficients(
        system="G", alpha=(1e-8, 2e-8, -6e-8, -1.2e-7), beta=(1e5, 1.8e5, -1.3e5, -4.6e5)
    )
    text = navigation_text(SETS, [gps])
    assert "GPSA   1.0000E-08  2.0000E-08 -6.0000E-08 -1.2000E-07" in text
    assert len(read_navigation(text)) == 4
    with pytest.raises(ValueError, match="R01"):
        navigation_text([replace(SETS[0], satellite=satellite_number("R01"))])
    with pytest.raises(ValueError, match="ionosphere of system E"):
        navigation_text(SETS, [replace(gps, system="E")])
    with pytest.raises(ValueError, match="needs an ephemeris"):
        navigation_text([])
