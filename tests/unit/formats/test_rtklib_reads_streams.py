"""RTKLIB's convbin decodes observations and ephemerides of all systems, from UBX, SBF and RTCM."""

import shutil
import subprocess
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest

from camber.formats.broadcast.ephemeris_fields import integers_from_ephemeris
from camber.formats.observations import (
    Ephemeris,
    ObservationEpoch,
    satellite_name,
    satellite_number,
    signal_number,
)
from camber.formats.rtcm.writer import format_ephemeris, format_observations, format_reference_station
from camber.formats.ubx.subframe_schedule import subframes_between
from camber.formats.ubx.writer import format_raw_measurements, format_subframe
from support.gnss_files import read_navigation
from support.random_observations import COMMON, LIGHT_M_S, SECOND_NS, WEEK_NS, random_ephemeris
from support.sbf_blocks import ephemeris_block, measurements_block
from support.simple_rinex import epochs_of

CONVBIN = shutil.which("convbin")
pytestmark = pytest.mark.skipif(CONVBIN is None, reason="convbin is not installed (Debian: rtklib)")
SATELLITES = ("G05", "G31", "E11", "E36", "J02", "C01", "C19", "C30", "C60")
SIGNALS = {"G": ("1C", "2L"), "E": ("1C", "7Q"), "J": ("1C", "2L"), "C": ("2I", "7I")}
BEGIN_NS = 2400 * WEEK_NS + 200_010 * SECOND_NS
# Long enough for the ten pages of a geostationary satellite from their beginning.
SECONDS = 45
# The orbit and the clock; RTKLIB has its own way with weeks, accuracies and health.
ELEMENTS = {*Ephemeris.__slots__, "toe_s", "toc_s", "af0_s", "af1", "af2"} - {"health"}


def epochs(rng, satellites=SATELLITES):
    rows = [(name, signal) for name in satellites for signal in SIGNALS[name[0]]]
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
    ephemerides = read_navigation(folder / "nav").ephemerides
    return values, {satellite_name(each.satellite): elements(each) for each in ephemerides}


def elements(ephemeris: Ephemeris) -> dict[str, int]:
    """As the integers that are broadcast."""
    return {name: n for name, n in integers_from_ephemeris(ephemeris).items() if name in ELEMENTS}


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
    assert sets == {name: elements(ephemeris) for name, ephemeris in ephemerides.items()}


def test_rtklib_decodes_the_blocks_of_sbf_that_our_decoder_is_tested_with(tmp_path, ephemerides):
    # RTKLIB 2.4.3 knows neither QZSS nor newer satellites in SBF, and of ephemerides those of GPS and Galileo.
    sent = list(epochs(np.random.default_rng(5), ("G05", "G31", "E11", "C01", "C19", "C30")))
    known = {name: ephemeris for name, ephemeris in ephemerides.items() if name[0] in "GE"}
    stream = b"".join(ephemeris_block(ephemeris, BEGIN_NS) for ephemeris in known.values())
    stream += b"".join(map(measurements_block, sent))
    values, sets = converted(tmp_path, stream, "sbf")
    # It scales C/N0 once too often, by its unit of 0.004 dB-Hz; three decimals are left of it.
    values = {key: value / 0.004 if key[2][0] == "S" else value for key, value in values.items()}
    assert_same_observations(values, sent, 0.26)
    assert sets == {name: elements(ephemeris) for name, ephemeris in known.items()}


def test_rtklib_decodes_the_rtcm_stream(tmp_path, ephemerides):
    sent = list(epochs(np.random.default_rng(4)))
    stream = format_reference_station((-3.8e6, 3.5e6, 3.6e6), station_id=7)
    stream += b"".join(frame for ephemeris in ephemerides.values() for frame in format_ephemeris(ephemeris))
    stream += b"".join(frame for epoch in sent for frame in format_observations(epoch, station_id=7))
    values, sets = converted(tmp_path, stream, "rtcm3")
    # C/N0 comes in steps of 1/16.
    assert_same_observations(values, sent, 0.04)
    assert sets == {name: elements(ephemeris) for name, ephemeris in ephemerides.items()}
