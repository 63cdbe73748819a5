"""Where each satellite of an epoch is in the sky, and why it is not in the position."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from camber.formats.observations import ObservationEpoch, satellite_name
from camber.geodesy.ellipsoid import geodetic_from_ecef_scalar
from camber.geodesy.local_frame import LocalFrame
from camber.gnss.observations.differenced_observations import Masks
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Solution
from camber.gnss.position.satellite_use import SatelliteColumns, satellite_columns
from camber.schemas.gnss import SATELLITE_USES
from support.engine_drives import Drive, engine_of, open_sky_drive, some_rows

MASKS = EngineSettings().masks()


@functools.cache
def drive() -> Drive:
    return open_sky_drive(seed=1, seconds=2)


def solved_first(
    rover: Callable[[ObservationEpoch], ObservationEpoch] = lambda epoch: epoch,
    base: Callable[[ObservationEpoch], ObservationEpoch | None] = lambda epoch: epoch,
    settings: EngineSettings | None = None,
) -> tuple[ObservationEpoch, Solution]:
    engine = engine_of(drive(), settings)
    epoch, of_base = rover(drive().rover[0]), base(drive().base[0])
    if of_base is not None:
        engine.add_base(of_base)
    return epoch, engine.solve(epoch)


def columns_of(epoch: ObservationEpoch, solution: Solution, masks: Masks = MASKS) -> SatelliteColumns:
    columns = satellite_columns(epoch, solution, masks)
    assert columns is not None
    return columns


def use_of(columns: SatelliteColumns) -> dict[str, str]:
    names = map(satellite_name, columns.satellite.tolist())
    return dict(zip(names, (SATELLITE_USES[use] for use in columns.use.tolist()), strict=True))


def one_used() -> int:
    """A satellite that is used where nothing is changed."""
    epoch, solution = solved_first()
    columns = columns_of(epoch, solution)
    return int(columns.satellite[columns.use == SATELLITE_USES.index("used")][0])


def test_directions_are_those_from_the_antenna() -> None:
    epoch, solution = solved_first()
    columns = columns_of(epoch, solution)
    assert solution.single is not None
    latitude, longitude, height_m = geodetic_from_ecef_scalar(*drive().true_ecef_m[0].tolist())
    frame = LocalFrame(latitude, longitude, height_m)
    for k, satellite_m in enumerate(solution.single.states.position_m):
        expected = np.array(frame.enu_from_geodetic(*geodetic_from_ecef_scalar(*satellite_m.tolist())))
        azimuth, elevation = columns.azimuth_rad[k], columns.elevation_rad[k]
        level = np.cos(elevation)
        direction = (level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation))
        # Until the signal arrives the earth turns by 6 µrad, and the satellite seems to move by 0.02 mrad.
        assert direction == pytest.approx(expected / np.linalg.norm(expected), abs=3e-5)


def test_c_n0_is_that_of_the_strongest_signal() -> None:
    epoch, solution = solved_first()
    columns = columns_of(epoch, solution)
    for satellite, cn0_dbhz in zip(columns.satellite, columns.cn0_dbhz, strict=True):
        assert cn0_dbhz == np.nanmax(epoch.cn0_dbhz[epoch.satellite == satellite])


def test_a_satellite_without_ephemeris_is_named_so_and_has_no_direction() -> None:
    satellite = one_used()
    engine = engine_of(
        replace(drive(), ephemerides=[e for e in drive().ephemerides if e.satellite != satellite])
    )
    epoch = drive().rover[0]
    columns = columns_of(epoch, engine.solve(epoch))
    assert use_of(columns)[satellite_name(satellite)] == "no_ephemeris"
    assert np.isnan(columns.elevation_rad[columns.satellite == satellite]).all()


@pytest.mark.parametrize(
    ("column", "value", "use"),
    [("pseudorange_m", np.nan, "no_pseudorange"), ("cn0_dbhz", 20.0, "below_cn0_mask")],
)
def test_what_its_signals_lack_is_named(column: str, value: float, use: str) -> None:
    satellite = one_used()

    def changed(epoch: ObservationEpoch) -> ObservationEpoch:
        values = np.where(epoch.satellite == satellite, value, getattr(epoch, column))
        return replace(epoch, **{column: values})

    uses = use_of(columns_of(*solved_first(changed)))
    assert uses.pop(satellite_name(satellite)) == use
    assert "used" in uses.values()


def test_a_satellite_that_the_base_does_not_see_is_not_differenced() -> None:
    satellite = one_used()
    uses = use_of(
        columns_of(*solved_first(base=lambda epoch: some_rows(epoch, epoch.satellite != satellite)))
    )
    assert uses[satellite_name(satellite)] == "not_differenced"


def test_below_the_elevation_mask_are_those_that_are_lower() -> None:
    settings = EngineSettings(lowest_elevation_deg=40.0)
    columns = columns_of(*solved_first(settings=settings), masks=settings.masks())
    below = columns.use == SATELLITE_USES.index("below_elevation_mask")
    assert below.tolist() == (columns.elevation_rad < np.radians(40.0)).tolist()
    assert 0 < below.sum() < below.size


def test_without_a_base_the_use_is_that_of_the_single_point() -> None:
    epoch, solution = solved_first(base=lambda _: None)
    assert solution.single is not None
    used = columns_of(epoch, solution).use == SATELLITE_USES.index("used")
    assert used.tolist() == solution.single.used.tolist()
    assert used.any()


def test_with_too_few_satellites_there_is_no_position_to_be_in() -> None:
    epoch, solution = solved_first(
        lambda epoch: some_rows(epoch, np.isin(epoch.satellite, epoch.satellite[:2]))
    )
    assert set(use_of(columns_of(epoch, solution)).values()) <= {"no_position", "below_elevation_mask"}


@pytest.mark.parametrize(
    ("quality", "code_used", "has_integer", "use"),
    [
        ("fixed", True, True, "used"),
        ("fixed", False, True, "used"),
        ("fixed", True, False, "integers_unresolved"),
        ("fixed", False, False, "outlier"),
        ("float", True, False, "used"),
        ("float", False, False, "outlier"),
    ],
)
def test_codes_and_integers_decide_of_differenced_satellites(
    quality: str, code_used: bool, has_integer: bool, use: str
) -> None:
    epoch, solution = solved_first()
    estimate, rows = solution.estimate, solution.rows
    assert estimate is not None
    assert rows is not None
    satellite = one_used()
    of_it = rows.satellite == satellite
    changed = estimate._replace(
        code_used=np.where(of_it, code_used, True),
        integer=np.where(of_it, 3.0 if has_integer else np.nan, 1.0),
    )
    uses = use_of(columns_of(epoch, replace(solution, quality=quality, estimate=changed)))
    assert uses[satellite_name(satellite)] == use


def test_an_epoch_that_came_too_late_has_no_satellites() -> None:
    late = Solution(time_ns=0, quality="none", reason="out_of_order")
    assert satellite_columns(drive().rover[0], late, MASKS) is None
