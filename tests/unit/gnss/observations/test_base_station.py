"""A base whose coordinate is wrong is detected by its single point."""

import functools

import numpy as np
import pytest
from pydantic import TypeAdapter

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.base_offset import offset_over_days
from camber.gnss.observations.base_station import BaseStation, station_name
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.position.single_point import NO_IONOSPHERE
from camber.schemas.base import Name
from support.canyon_statistics import FRAME
from support.engine_drives import base_ecef_m, open_sky_drive, some_rows

EAST, _, UP = FRAME.enu_from_ecef_rotation()


@functools.cache
def drive():
    return open_sky_drive(seed=4, seconds=3)


def coordinate_of(position_m, epoch=None, store=None) -> str:
    base = BaseStation(np.array(position_m))
    base.add(epoch or drive().base[0])
    return base.coordinate(drive().store if store is None else store, NO_IONOSPHERE)


@pytest.mark.parametrize("seed", range(5))
def test_the_true_coordinate_is_plausible_at_any_time_of_day(seed):
    begin_ns = drive().base[0].time_ns + seed * 5 * 3600 * NS_PER_SECOND
    d = open_sky_drive(seed=seed, seconds=1, begin_ns=begin_ns)
    assert coordinate_of(base_ecef_m(), d.base[0], d.store) == "plausible"


@pytest.mark.parametrize(
    "position_m",
    [
        *(base_ecef_m() + m for m in (450.0 * EAST, 50.0 * EAST, -100.0 * UP, 5000.0 * EAST, 1.0e6 * UP)),
        *((0.0, 0.0, 0.0), (np.nan,) * 3, (np.inf, 0.0, 0.0), (1.0, 2.0, 3.0)),
    ],
)
def test_another_coordinate_and_what_is_no_place_on_earth_are_not(position_m):
    assert coordinate_of(position_m) == "implausible"


@pytest.mark.parametrize("offset_m", [0.0, 3.0, 10.0])
def test_what_a_single_point_cannot_decide_is_unknown(offset_m):
    assert coordinate_of(base_ecef_m() + offset_m * UP) == "plausible"


def test_without_ephemerides_or_satellites_it_is_not_known():
    assert coordinate_of(base_ecef_m(), store=EphemerisStore()) == "unknown"
    assert coordinate_of(base_ecef_m(), some_rows(drive().base[0], np.arange(0))) == "unknown"
    assert BaseStation(base_ecef_m()).coordinate(drive().store, NO_IONOSPHERE) == "unknown"


def test_a_coordinate_that_is_put_right_is_looked_at_at_once():
    base = BaseStation(base_ecef_m() + 450.0 * EAST)
    base.add(drive().base[0])
    assert base.coordinate(drive().store, NO_IONOSPHERE) == "implausible"
    assert base.miss_ecef_m == pytest.approx(-450.0 * EAST, abs=30.0)
    assert base.move_to(base_ecef_m())
    assert not base.move_to(base_ecef_m())
    assert base.coordinate(drive().store, NO_IONOSPHERE) == "plausible"


def test_it_is_looked_at_every_ten_seconds_and_with_every_epoch_while_it_is_wrong():
    d = open_sky_drive(seed=4, seconds=25)
    for off_m, expected in ((0.0, [0, 10, 20]), (450.0, list(range(25)))):
        base, checked = BaseStation(base_ecef_m() + off_m * EAST), []
        for second, epoch in enumerate(d.base):
            base.miss_ecef_m = None
            base.add(epoch)
            base.coordinate(d.store, NO_IONOSPHERE)
            if base.miss_ecef_m is not None:
                checked.append(second)
        assert checked == expected


@functools.cache
def minutes():
    return open_sky_drive(seed=4, seconds=130)


def after_minutes(offset_ecef_m) -> BaseStation:
    base = BaseStation(base_ecef_m() + offset_ecef_m)
    for epoch in minutes().base:
        base.add(epoch)
        base.coordinate(minutes().store, NO_IONOSPHERE)
    return base


@pytest.mark.parametrize("east_m", [12.0, -12.0])
def test_a_base_twelve_metres_off_is_named_with_its_vector_after_a_minute(east_m):
    base = BaseStation(base_ecef_m() + east_m * EAST)
    outcomes = []
    for epoch in minutes().base[:70]:
        base.add(epoch)
        outcomes.append(base.coordinate(minutes().store, NO_IONOSPHERE))
    assert set(outcomes[:50]) == {"plausible"}, "one epoch does not show it"
    assert outcomes[-1] == "implausible"
    east, north, up = (-value for value in base.offset.enu_m)
    assert (east, north) == (pytest.approx(east_m, abs=4.0), pytest.approx(0.0, abs=4.0))
    assert base.coordinate_error() == (
        f"{east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up from its single points over minutes"
    )


def test_the_true_coordinate_is_plausible_over_minutes_and_a_changed_one_begins_anew():
    base = after_minutes(np.zeros(3))
    assert base.offset is not None
    assert not base.offset.is_wrong
    base.move_to(base_ecef_m() + 2.0 * EAST)
    assert base.offset is None


def test_offsets_of_earlier_days_count_from_the_first_epoch():
    base = BaseStation(base_ecef_m())
    base.offset_over_days = offset_over_days([((5.0, 0.0, 0.0), (1.0, 1.0, 5.0))] * 20)
    base.add(drive().base[0])
    assert base.coordinate(drive().store, NO_IONOSPHERE) == "implausible"
    assert base.coordinate_error() == (
        "-5.00 m east, +0.00 m north, +0.00 m up from its single points over 20 days"
    )


def test_what_is_no_place_has_no_vector():
    base = BaseStation(np.zeros(3) + np.nan)
    base.add(drive().base[0])
    assert base.coordinate(drive().store, NO_IONOSPHERE) == "implausible"
    assert base.coordinate_error() == "not a position on the earth"


def test_late_epochs_are_not_taken():
    first, second, third = drive().base
    base = BaseStation(base_ecef_m())
    assert [base.add(e) for e in (second, first, third)] == ["next", "late", "next"]
    assert base.epoch is third
    assert base.arcs.size == third.satellite.size


def test_whatever_a_station_calls_itself_becomes_a_name_that_a_message_can_have() -> None:
    longest = np.array([-13_743_895.347, -13_743_895.347, -13_743_895.347])
    for label in ("rtcm-4095", "rinex-名古屋 1, roof*" + 60 * "x"):
        for position in (None, longest, 1e30 * longest):
            name = station_name(label, position)
            assert TypeAdapter(Name).validate_python(name) == name
    full = station_name("rinex-" + 60 * "x", longest)
    assert full.endswith(":".join(3 * ["-13743895.347"]))
