"""GLONASS in positions and velocities of recorded receivers: its codes count, its phases do not."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from camber.formats.observations import GlonassEphemeris, ObservationEpoch
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.observations.satellite_states import enu_from_ecef_rotation, geodetic
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from camber.gnss.position.single_point import single_point
from camber.gnss.velocity.doppler_velocity import doppler_velocity
from support.engine_drives import of_systems, some_rows
from support.gnss_files import read_navigation, read_observations, recorded_place_m, recording

GPS = EngineSettings(gps_bands="12", galileo_bands="", beidou_bands="", glonass_bands="", doppler_aided=False)
WITH_GLONASS = GPS.model_copy(update={"glonass_bands": "12"})


@functools.cache
def files():
    folder = recording("rooftop-2024-06-24")
    rover, base = (list(read_observations(folder / name).epochs)[::10] for name in ("rover.obs", "base.obs"))
    places = [recorded_place_m(folder / f"{name}_position.txt") for name in ("rover", "base")]
    return rover, base, read_navigation(folder / "base.nav").ephemerides, *places


def is_glonass(satellite: np.ndarray) -> np.ndarray:
    return satellite >> 8 == ord("R")


def solve(options: EngineSettings, change=lambda epoch, _: epoch) -> list[Solution]:
    rover, base, ephemerides, _, base_m = files()
    engine = Engine(options, base_m)
    for e in ephemerides:
        engine.add_ephemeris(e)
    solutions = []
    for k, (at_rover, at_base) in enumerate(zip(rover, base, strict=True)):
        engine.add_base(at_base)
        solutions.append(engine.solve(change(at_rover, k)))
    return solutions


def changed(epoch: ObservationEpoch, name: str, more: np.ndarray | float) -> ObservationEpoch:
    column = getattr(epoch, name).copy()
    column[is_glonass(epoch.satellite)] += more
    return replace(epoch, **{name: column})


def float_errors_m(solutions: list[Solution]) -> np.ndarray:
    rover_m = files()[3]
    latitude, longitude, _ = geodetic(rover_m)
    rotation = enu_from_ecef_rotation(latitude, longitude)
    return np.array([rotation @ (s.approximate_ecef_m + s.estimate.float_dx_m - rover_m) for s in solutions])


def test_glonass_adds_codes_and_no_ambiguity():
    for without, joined in zip(solve(GPS), solve(WITH_GLONASS), strict=True):
        assert joined.satellites > without.satellites
        of_glonass = is_glonass(joined.rows.satellite)
        assert of_glonass.sum() > 8
        assert np.isnan(joined.rows.phase_m[of_glonass]).all()
        assert np.isnan(joined.estimate.integer[of_glonass]).all()
        assert joined.estimate.code_used[of_glonass].any()
        assert joined.estimate.ambiguities == without.estimate.ambiguities
        assert joined.estimate.fixed <= without.estimate.ambiguities
        assert joined.estimate.phase_freedom == without.estimate.phase_freedom


def test_phases_of_glonass_change_nothing():
    rng = np.random.default_rng(5)
    # Any cycles, an epoch each: as if all slipped at every epoch.
    cycles = rng.integers(-1000, 1000, 40)
    plain = solve(WITH_GLONASS)
    slipped = solve(WITH_GLONASS, lambda e, k: changed(e, "carrier_phase_cycles", float(cycles[k])))
    for one, other in zip(plain, slipped, strict=True):
        np.testing.assert_array_equal(one.position_ecef_m, other.position_ecef_m)
        assert (one.ratio, one.quality, one.continuity) == (other.ratio, other.quality, other.continuity)


def test_in_a_narrow_sky_float_positions_are_better_with_glonass():
    narrow = {"lowest_elevation_deg": 30.0}
    errors = [float_errors_m(solve(options.model_copy(update=narrow))) for options in (GPS, WITH_GLONASS)]
    rms_m = [np.sqrt((of**2).mean(axis=0)) for of in errors]
    assert np.hypot(*rms_m[1][:2]) < 0.95 * np.hypot(*rms_m[0][:2])
    assert rms_m[1][2] < 0.85 * rms_m[0][2]


def test_with_four_satellites_of_gps_and_qzss_glonass_gives_float_positions():
    rng = np.random.default_rng(2)
    names = np.unique(files()[0][0].satellite)
    others = names[np.isin(names >> 8, [ord("G"), ord("J")])]
    chosen = [rng.choice(others, 4, replace=False) for _ in range(40)]

    def few(epoch: ObservationEpoch, k: int) -> ObservationEpoch:
        return some_rows(epoch, np.isin(epoch.satellite, chosen[k]) | is_glonass(epoch.satellite))

    assert sum(s.quality == "float" for s in solve(GPS, few)) < 15
    solutions = solve(WITH_GLONASS, few)
    assert {s.quality for s in solutions} == {"float"}
    assert np.median(np.linalg.norm(float_errors_m(solutions), axis=1)) < 1.0


@pytest.mark.parametrize("bias_m", [0.0, 1.0, 2.0])
def test_delays_of_channels_between_receivers_stay_within_the_covariance(bias_m):
    rover_m = files()[3]
    normalised = []
    for seed in range(4):
        delays_m = bias_m * np.random.default_rng(seed).normal(size=(64, 10))

        def delayed(e: ObservationEpoch, _: int, delays_m: np.ndarray = delays_m) -> ObservationEpoch:
            rows = is_glonass(e.satellite)
            return changed(e, "pseudorange_m", delays_m[e.satellite[rows] & 63, (e.signal[rows] >> 8) - 48])

        for s in solve(WITH_GLONASS, delayed):
            error_m = s.approximate_ecef_m + s.estimate.float_dx_m - rover_m
            normalised.append(error_m @ np.linalg.solve(s.estimate.float_covariance_m2, error_m))
            assert s.quality != "fixed" or np.linalg.norm(s.position_ecef_m - rover_m) < 0.03
    # χ² of three degrees of freedom: 95 % are below 7.8.
    assert np.mean(np.array(normalised) < 7.8) > 0.95


def test_a_damaged_code_of_glonass_moves_no_fix():
    rover_m = files()[3]
    for s in solve(WITH_GLONASS, lambda e, k: changed(e, "pseudorange_m", 0.0 if k % 2 else one_wrong(e))):
        assert s.quality == "fixed"
        assert np.linalg.norm(s.position_ecef_m - rover_m) < 0.03


def one_wrong(epoch: ObservationEpoch) -> np.ndarray:
    """150 m of the first satellite of GLONASS."""
    satellites = epoch.satellite[is_glonass(epoch.satellite)]
    return np.where(satellites == satellites[0], 150.0, 0.0)


def store_of_systems(ephemerides, *, shift: int = 0) -> EphemerisStore:
    store = EphemerisStore()
    for e in ephemerides:
        moved = isinstance(e, GlonassEphemeris) and shift
        store.add(replace(e, channel=e.channel - shift) if moved and e.channel - shift >= -7 else e)
    return store


def test_glonass_alone_gives_a_position_and_a_velocity():
    rover, _, ephemerides, rover_m, _ = files()
    store = store_of_systems(ephemerides)
    for epoch in rover:
        point = single_point(of_systems(epoch, "R"), store)
        assert point.status == "ok"
        assert np.linalg.norm(point.position_ecef_m - rover_m) < 25.0
        assert np.isfinite(point.clock_m).tolist() == [False, False, False, True]
        velocity = doppler_velocity(of_systems(epoch, "R"), point)
        assert velocity.status == "ok"
        assert np.abs(velocity.velocity_enu_m_s).max() < 0.08


def test_a_velocity_needs_the_right_frequency_channels():
    rover, _, ephemerides, *_ = files()
    store = store_of_systems(ephemerides, shift=3)
    for epoch in rover[::5]:
        velocity = doppler_velocity(of_systems(epoch, "R"), single_point(of_systems(epoch, "R"), store))
        assert velocity.status != "ok" or np.abs(velocity.velocity_enu_m_s).max() > 0.1


def test_all_systems_and_glonass_are_no_worse_than_without_it():
    rover, _, ephemerides, rover_m, _ = files()
    store = store_of_systems(ephemerides)
    errors_m, speeds_m_s = [], []
    for systems in ("GJEC", "GJECR"):
        points = [single_point(of_systems(epoch, systems), store) for epoch in rover]
        errors_m.append(np.sqrt(np.mean([np.sum((p.position_ecef_m - rover_m) ** 2) for p in points])))
        velocities = [
            doppler_velocity(of_systems(e, systems), p).velocity_enu_m_s
            for e, p in zip(rover, points, strict=True)
        ]
        speeds_m_s.append(np.sqrt(np.mean(np.square(velocities))))
    assert errors_m[1] < 1.25 * errors_m[0]
    assert speeds_m_s[1] < speeds_m_s[0]


@pytest.mark.parametrize("bands", ["", "1", "2", "12"])
def test_a_setting_selects_its_bands(bands):
    options = WITH_GLONASS.model_copy(update={"glonass_bands": bands})
    rows = solve(options)[0].rows
    groups = rows.group[is_glonass(rows.satellite)]
    assert sorted({str(g // 4 % 10) for g in groups.tolist()}) == sorted(bands)


def test_phases_with_a_float_ambiguity_each_would_change_no_position():
    """Least squares of codes and phases, the ambiguities of GLONASS being unknowns, is that of the codes alone."""
    for epoch, s in zip(files()[0][::10], solve(WITH_GLONASS)[::10], strict=True):
        rows = s.rows
        of_glonass = np.flatnonzero(is_glonass(rows.satellite))
        groups = np.unique(rows.group)
        clocks = (rows.group[:, None] == groups).astype(float)
        codes = np.hstack([rows.direction, clocks])
        alone = solved_position(codes, rows.code_m, 1.0 / np.sqrt(rows.code_variance_m2))
        # A clock of the phases of each band would be one more unknown, which the ambiguities contain.
        count = of_glonass.size
        phases = np.hstack([rows.direction[of_glonass], np.zeros((count, groups.size)), np.eye(count)])
        design = np.vstack([np.hstack([codes, np.zeros((codes.shape[0], count))]), phases])
        cycles = epoch.carrier_phase_cycles[rows.rover[of_glonass]]
        values = np.concatenate([rows.code_m, np.nan_to_num(cycles % 1000.0)])
        weights = np.concatenate([1.0 / np.sqrt(rows.code_variance_m2), np.full(count, 250.0)])
        np.testing.assert_allclose(solved_position(design, values, weights), alone, atol=1e-6)


def solved_position(design: np.ndarray, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(design * weights[:, None], values * weights, rcond=None)[0][:3]
