"""The engine on recordings of real receivers, beside rnx2rtkp on the same files; needs CAMBER_DATA."""

import functools
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar, geodetic_from_ecef_scalar
from camber.geodesy.gps_time import NS_PER_SECOND, gps_ns_from_week_tow, nanoseconds_from_decimal
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from support.engine_drives import some_rows
from support.gnss_files import read_navigation, read_observations, recorded_place_m, recording
from support.rtklib_runs import OPTIONS, RNX2RTKP

FUJISAWA_BASE_M = np.array([-3959400.631, 3385704.533, 3667523.111])
HEIGHTS_M = 47.27, 47.62
"""Of the road under the antenna, as the recording's README has it."""


@functools.cache
def files(name: str):
    """Rover, base, ephemerides, the base's place, and the three files."""
    if name == "fujisawa":
        at, names = recording("fujisawa-2021-09-22"), ("SEPT265G.21O", "3034265G.21O", "SEPT2650.21P")
        base_m = FUJISAWA_BASE_M
    else:
        at, names = recording("rooftop-2024-06-24"), ("rover.obs", "base.obs", "base.nav")
        base_m = recorded_place_m(at / "base_position.txt")
    paths = [at / name for name in names]
    rover, base = (list(read_observations(path).epochs) for path in paths[:2])
    return rover, base, read_navigation(paths[2]).ephemerides, base_m, paths


def rooftop_m() -> np.ndarray:
    """Where the rover's antenna of the rooftop is."""
    return recorded_place_m(recording("rooftop-2024-06-24") / "rover_position.txt")


def engine_of(name: str, options: EngineSettings, up_m: float = 0.0) -> Engine:
    """An engine with all ephemerides, and the base's position or one above it."""
    _, _, ephemerides, base_m, _ = files(name)
    engine = Engine(options, base_m + up_m * base_m / np.linalg.norm(base_m))
    for e in ephemerides:
        engine.add_ephemeris(e)
    return engine


@functools.cache
def solved(name: str, options: EngineSettings) -> tuple[Solution, ...]:
    """Every epoch after the newest of the base's that is not yet to come."""
    rover, base, *_ = files(name)
    engine = engine_of(name, options)
    solutions, k = [], 0
    for epoch in rover:
        while k < len(base) and base[k].time_ns <= epoch.time_ns + NS_PER_SECOND // 2:
            engine.add_base(base[k])
            k += 1
        solutions.append(engine.solve(epoch))
    assert not {w for w in engine.warnings if w != "ephemeris_missing"}
    return tuple(solutions)


class Options(EngineSettings):
    """Hashable by identity, to be remembered by."""

    __hash__ = object.__hash__


DEFAULTS, ALONE = Options(), Options(doppler_aided=False)
ROOFTOP = {
    "all": DEFAULTS,
    "all, alone": ALONE,
    "GPS": Options(gps_bands="125", galileo_bands="", beidou_bands=""),
    "GPS, two bands": Options(gps_bands="12", galileo_bands="", beidou_bands=""),
    "GPS, two bands, alone": Options(gps_bands="12", galileo_bands="", beidou_bands="", doppler_aided=False),
}
GALILEO = Options(gps_bands="", galileo_bands="157", beidou_bands="", doppler_aided=False)
LIKE_RTKLIB = Options(
    gps_bands="12",
    galileo_bands="17",
    beidou_bands="",
    lowest_elevation_deg=15.0,
    least_cn0_dbhz=0.0,
    doppler_aided=False,
)
"""Systems, bands, mask and ratio of the peer's run below, each epoch by itself."""


@functools.cache
def rnx2rtkp(name: str) -> dict[int, tuple[bool, np.ndarray]]:
    """By time rounded to a second: fixed or not, and the position in ECEF."""
    if RNX2RTKP is None:
        pytest.skip("rnx2rtkp is not installed (Debian: rtklib)")
    *_, base_m, paths = files(name)
    with tempfile.TemporaryDirectory() as scratch:
        at = "".join(f"ant2-pos{k + 1}={v:.4f}\n" for k, v in enumerate(base_m))
        (Path(scratch) / "options.conf").write_text(OPTIONS.replace("navsys=57", "navsys=25") + at)
        subprocess.run(
            [RNX2RTKP, "-k", "options.conf", "-o", "out.pos", *map(str, paths)],
            cwd=scratch, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=120,
        )  # fmt: skip
        lines = (Path(scratch) / "out.pos").read_text().splitlines()
    by_epoch = {}
    for line in lines:
        if line and not line.startswith("%"):
            week, tow, latitude, longitude, height_m, quality, *_ = line.split()
            time_ns = gps_ns_from_week_tow(int(week), nanoseconds_from_decimal(tow))
            latitude_rad, longitude_rad = np.deg2rad([float(latitude), float(longitude)])
            position = np.array(ecef_from_geodetic_scalar(latitude_rad, longitude_rad, float(height_m)))
            by_epoch[second(time_ns)] = (quality == "1", position)
    return by_epoch


def second(time_ns: int) -> int:
    return round(time_ns / NS_PER_SECOND)


def fixes(solutions) -> dict[int, np.ndarray]:
    return {second(s.time_ns): s.position_ecef_m for s in solutions if s.quality == "fixed"}


@pytest.mark.parametrize("name", ROOFTOP)
def test_on_the_rooftop_every_epoch_with_five_satellites_is_fixed_to_a_centimetre_and_a_half(name):
    truth_m = rooftop_m()
    solutions = solved("rooftop", ROOFTOP[name])
    assert len(solutions) == 301
    for s in solutions:
        assert s.quality == "fixed" or s.satellites < 5
        if s.quality == "fixed":
            assert np.linalg.norm(s.position_ecef_m - truth_m) <= 0.015


def test_on_the_rooftop_all_integers_go_on_and_fixes_are_within_their_covariances():
    solutions, truth_m = solved("rooftop", DEFAULTS), rooftop_m()
    assert {s.continuity for s in solutions[1:]} == {"continuous"}
    assert {s.continuous_since_ns for s in solutions} == {solutions[0].time_ns}
    for s in solutions:
        error = s.position_ecef_m - truth_m
        assert error @ np.linalg.solve(s.covariance_ecef_m2, error) < 16.0


@pytest.mark.parametrize("options", [DEFAULTS, ALONE], ids=["defaults", "alone"])
def test_in_fujisawa_most_epochs_are_fixed_on_the_road(options):
    solutions = solved("fujisawa", options)
    by_epoch = fixes(solutions)
    assert (len(solutions), len(by_epoch) >= 300) == (360, True)
    heights_m = [geodetic_from_ecef_scalar(*at)[2] for at in by_epoch.values()]
    # The issue allows half a metre on either side.
    assert min(heights_m) > HEIGHTS_M[0] - 0.3
    assert max(heights_m) < HEIGHTS_M[1] + 0.35


def test_in_fujisawa_no_fix_is_off_the_consensus():
    """Of three configurations and rnx2rtkp; an epoch has a consensus where three are within 10 cm of each other."""
    parts = [
        fixes(solved("fujisawa", DEFAULTS)),
        fixes(solved("fujisawa", ROOFTOP["GPS, two bands, alone"])),
        fixes(solved("fujisawa", GALILEO)),
        {t: at for t, (fixed, at) in rnx2rtkp("fujisawa").items() if fixed},
    ]
    compared = 0
    for t, at in parts[0].items():
        others = [part[t] for part in parts if t in part]
        apart = np.linalg.norm(np.array(others)[:, None] - np.array(others)[None], axis=2)
        near = (apart < 0.1).sum(axis=1)
        if near.max() >= 3:
            consensus = np.median(np.array(others)[apart[near.argmax()] < 0.1], axis=0)
            assert np.linalg.norm(at - consensus) < 0.3
            compared += 1
    assert compared > 200


def test_in_fujisawa_fixes_move_as_a_car_does():
    """No fix lies apart from those a second before and after by more than a car's acceleration."""
    by_epoch = fixes(solved("fujisawa", DEFAULTS))
    bends = [
        np.linalg.norm(by_epoch[t + 1] - 2.0 * at + by_epoch[t - 1])
        for t, at in by_epoch.items()
        if t - 1 in by_epoch and t + 1 in by_epoch
    ]
    assert len(bends) > 280
    assert max(bends) < 5.0


@pytest.mark.parametrize("name", ["fujisawa", "rooftop"])
def test_as_many_fixes_as_rnx2rtkp_with_the_same_satellites_and_within_five_centimetres(name):
    ours = fixes(solved(name, LIKE_RTKLIB))
    theirs = {t: at for t, (fixed, at) in rnx2rtkp(name).items() if fixed}
    assert len(ours) >= len(theirs) > 200
    both = ours.keys() & theirs.keys()
    assert len(both) > 200
    assert max(np.linalg.norm(ours[t] - theirs[t]) for t in both) < 0.05
    defaults = fixes(solved(name, DEFAULTS))
    assert max(np.linalg.norm(defaults[t] - theirs[t]) for t in defaults.keys() & theirs.keys()) < 0.05


@pytest.mark.parametrize(("offset_m", "with_ionosphere"), [(37.0, True), (-37.0, True), (400.0, False)])
def test_another_height_of_the_rooftops_base_is_detected(offset_m, with_ionosphere):
    """37 m are the geoid's height in much of Japan: a height above the sea that was taken for an ellipsoidal one."""
    rover, base, _, _, paths = files("rooftop")
    engine = engine_of("rooftop", EngineSettings(), offset_m)
    if with_ionosphere:
        coefficients = read_navigation(paths[2]).klobuchar["G"]
        engine.ionosphere = np.array([*coefficients.alpha, *coefficients.beta])
    for r, b in zip(rover[:10], base[:10], strict=True):
        engine.add_base(b)
        assert engine.solve(r).reason == "base_position_wrong"


def test_a_few_satellites_of_the_rooftop_make_no_wrong_fix():
    """Eleven of thirty-six, others in each epoch: fixed or not, never wrong."""
    truth_m = rooftop_m()
    rover, base, *_ = files("rooftop")
    rng = np.random.default_rng(1)
    engine = engine_of("rooftop", ALONE)
    fixed = 0
    for r, b in zip(rover, base, strict=True):
        chosen = rng.choice(np.unique(r.satellite), 11, replace=False)
        engine.add_base(b)
        solution = engine.solve(some_rows(r, np.isin(r.satellite, chosen)))
        if solution.quality == "fixed":
            fixed += 1
            assert np.linalg.norm(solution.position_ecef_m - truth_m) < 0.3
    assert fixed > 20


def test_slips_and_half_cycles_put_into_the_rooftop_make_no_wrong_fix():
    truth_m = rooftop_m()
    rover, base, *_ = files("rooftop")
    rng = np.random.default_rng(2)
    engine = engine_of("rooftop", DEFAULTS)
    wrong = 0
    for r, b in zip(rover[:150], base[:150], strict=True):
        cycles = rng.choice([0.0, 0.5, 0.25, 1.0], r.satellite.size, p=[0.8, 0.1, 0.05, 0.05])
        engine.add_base(b)
        solution = engine.solve(replace(r, carrier_phase_cycles=r.carrier_phase_cycles + cycles))
        wrong += solution.quality == "fixed" and np.linalg.norm(solution.position_ecef_m - truth_m) > 0.3
    assert wrong == 0
