"""RTKLIB's convbin decodes observations and ephemerides of all systems, from UBX and from RTCM."""

import shutil
import subprocess
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest

from camber.formats.observations import ObservationEpoch, satellite_number, signal_number
from camber.formats.rtcm.writer import format_ephemeris, format_observations, format_reference_station
from camber.formats.ubx.subframe_schedule import subframes_between
from camber.formats.ubx.writer import format_raw_measurements, format_subframe
from support.random_observations import COMMON, LIGHT_M_S, SECOND_NS, WEEK_NS, random_ephemeris
from support.simple_rinex import epochs_of

CONVBIN = shutil.which("convbin")
pytestmark = pytest.mark.skipif(CONVBIN is None, reason="convbin is not installed (Debian: rtklib)")
SATELLITES = ("G05", "G31", "E11", "E36", "J02", "C01", "C19", "C30", "C60")
SIGNALS = {"G": ("1C", "2L"), "E": ("1C", "7Q"), "J": ("1C", "2L"), "C": ("2I", "7I")}
BEGIN_NS = 2400 * WEEK_NS + 200_010 * SECOND_NS
# Long enough for the ten pages of a geostationary satellite from their beginning.
SECONDS = 45
# RINEX 3.04, tables A6, A8, A12, A14: the elements in order after the clock.
ELEMENTS = (
    *("iode", "crs_m", "mean_motion_difference_rad_s", "mean_anomaly_rad", "cuc", "eccentricity", "cus"),
    "sqrt_a",
    *("toe", "cic", "ascending_node_rad", "cis", "inclination_rad", "crc_m", "perigee_rad"),
    *("ascending_node_rate_rad_s", "inclination_rate_rad_s"),
)
PI = np.pi
# Half a step of the coarsest system; RINEX itself has 13 digits.
TOLERANCES = {
    "crs_m": 2.0**-6, "crc_m": 2.0**-6, "cuc": 2.0**-30, "cus": 2.0**-30, "cic": 2.0**-30, "cis": 2.0**-30,
    "eccentricity": 2.0**-34, "sqrt_a": 2.0**-20, "iode": 0.0, "toe": 0.0,
}  # fmt: skip


def epochs(rng):
    rows = [(name, signal) for name in SATELLITES for signal in SIGNALS[name[0]]]
    satellite = np.array([satellite_number(name) for name, _ in rows])
    signal = np.array([signal_number(signal) for _, signal in rows])
    wavelength = np.array([LIGHT_M_S / COMMON[name[0]][signal] for name, signal in rows])
    n = len(rows)
    distance = np.repeat(rng.uniform(2e7, 4e7, n // 2), 2)
    rate = np.repeat(rng.uniform(-700.0, 700.0, n // 2), 2)
    for k in range(SECONDS):
        metres = distance + rate * k
        yield ObservationEpoch(
            time_ns=BEGIN_NS + k * SECOND_NS,
            satellite=satellite,
            signal=signal,
            pseudorange_m=metres + rng.normal(size=n),
            carrier_phase_cycles=metres / wavelength + np.arange(n),
            doppler_hz=-rate / wavelength + rng.normal(size=n) * 0.1,
            cn0_dbhz=rng.integers(42, 55, n).astype(float),
            lock_time_s=np.full(n, 5.0 + k),
            loss_of_lock=np.zeros(n, np.bool_),
            half_cycle=np.zeros(n, np.bool_),
        )


def converted(folder, data: bytes, kind: str):
    (folder / "stream").write_bytes(data)
    when = datetime(1980, 1, 6) + timedelta(seconds=BEGIN_NS // SECOND_NS)
    command = [CONVBIN, "-r", kind, "-v", "3.04", "-od", "-os", "-o", "obs", "-n", "nav"]
    command += ["-tr", when.strftime("%Y/%m/%d"), when.strftime("%H:%M:%S"), "stream"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=60)
    values = {
        (time_ns // SECOND_NS % 86_400, *key): value
        for time_ns, row in epochs_of((folder / "obs").read_text())
        for key, (value, _, _) in row.items()
    }
    return values, read_navigation((folder / "nav").read_text())


def read_navigation(text):
    sets = {}
    for line in text.split("END OF HEADER")[1].splitlines()[1:]:
        if line[0] != " ":
            satellite = line[:3]
            sets[satellite] = []
        begin = 23 if line[0] != " " else 4
        fields = [line[at : at + 19].strip() for at in range(begin, len(line), 19)]
        sets[satellite] += [float(field.replace("D", "E")) if field else np.nan for field in fields]
    return sets


def assert_same_observations(values, sent, dropped_digits):
    for epoch in sent:
        second = epoch.time_ns // SECOND_NS % 86_400
        for row in range(epoch.satellite.size):
            letter, number = chr(epoch.satellite[row] >> 8), epoch.satellite[row] & 255
            signal = chr(epoch.signal[row] >> 8) + chr(epoch.signal[row] & 255)
            for kind, value, tolerance in (
                ("C", epoch.pseudorange_m[row], 0.0011),
                ("L", epoch.carrier_phase_cycles[row], 0.0011),
                ("D", epoch.doppler_hz[row], 0.0011),
                ("S", epoch.cn0_dbhz[row], dropped_digits),
            ):
                decoded = values.pop((second, f"{letter}{number:02d}", kind + signal))
                assert abs(decoded - value) <= tolerance, (letter, number, kind, signal)
    assert not values


def assert_same_elements(sets, ephemerides):
    assert sets.keys() == ephemerides.keys()
    for name, values in sets.items():
        ephemeris = ephemerides[name]
        offset_ns = 14 * SECOND_NS if name[0] == "C" else 0
        assert values[:3] == pytest.approx(ephemeris.clock, rel=0.0, abs=2.0**-31)
        assert values[1] == pytest.approx(ephemeris.clock[1], rel=0.0, abs=2.0**-43)
        for element, value in zip(ELEMENTS, [*values[3:19], values[19]], strict=True):
            wanted = getattr(ephemeris, element, (ephemeris.toe_ns - offset_ns) % WEEK_NS / SECOND_NS)
            if element.endswith("_rad"):
                assert abs(np.remainder(value - wanted + PI, 2.0 * PI) - PI) < PI * 2.0**-31, (name, element)
            else:
                tolerance = TOLERANCES.get(element, PI * 2.0**-44)
                assert abs(value - wanted) <= tolerance * (1.0 + 1e-6) + 1e-12 * abs(wanted), (name, element)


@pytest.fixture(scope="module")
def ephemerides():
    rng = np.random.default_rng(8)
    made = {}
    for name in SATELLITES:
        offset_ns = 14 * SECOND_NS if name[0] == "C" else 0
        toe_ns = 2400 * WEEK_NS + 201_600 * SECOND_NS + offset_ns
        made_here = random_ephemeris(rng, name, toe_ns)
        # RTKLIB wants toe and toc of BeiDou alike, and IODE to be the lower bits of IODC, as satellites have it.
        other = {**made_here.other, **({"iodc": 256.0 + made_here.iode} if name[0] in "GJ" else {})}
        # It takes an eccentricity above 0.25 in D2 for a negative one; none is so great.
        made[name] = replace(made_here, toc_ns=toe_ns, health=0, other=other, eccentricity=0.2 * rng.random())
    return made


def test_rtklib_decodes_the_ubx_stream(tmp_path, ephemerides):
    sent = list(epochs(np.random.default_rng(3)))
    stream = b""
    for epoch in sent:
        stream += format_raw_measurements(epoch)
        for ephemeris in ephemerides.values():
            for subframe in subframes_between(ephemeris, epoch.time_ns, epoch.time_ns + SECOND_NS):
                stream += format_subframe(subframe)
    values, sets = converted(tmp_path, stream, "ubx")
    assert_same_observations(values, sent, 0.5)
    assert_same_elements(sets, ephemerides)


def test_rtklib_decodes_the_rtcm_stream(tmp_path, ephemerides):
    sent = list(epochs(np.random.default_rng(4)))
    stream = format_reference_station((-3.8e6, 3.5e6, 3.6e6), station_id=7)
    stream += b"".join(frame for ephemeris in ephemerides.values() for frame in format_ephemeris(ephemeris))
    stream += b"".join(frame for epoch in sent for frame in format_observations(epoch, station_id=7))
    values, sets = converted(tmp_path, stream, "rtcm3")
    # C/N0 comes in steps of 1/16.
    assert_same_observations(values, sent, 0.04)
    assert_same_elements(sets, ephemerides)
