"""What is remembered of base stations: a coordinate that steps is noticed, a damaged file is refused whole."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.base_coordinate_history import (
    PLACE_M,
    SAME_M,
    BaseMemory,
    memory_as_text,
    memory_from_text,
)
from camber.gnss.observations.base_move_detection import BaseWatch
from camber.gnss.observations.base_offset import BaseOffset
from camber.gnss.observations.base_station import BaseStation
from camber.gnss.observations.receiver_streams import StationPosition
from support.canyon_statistics import FIRST_NS, FRAME
from support.engine_drives import base_ecef_m

EAST, NORTH, UP = FRAME.enu_from_ecef_rotation()
DAY_NS = 86_400 * NS_PER_SECOND
MOUNT, STATION = "caster:2101/ROOF", "rtcm-7"
RIGHT = BaseOffset(enu_m=(0.4, -0.3, 1.0), sigma_m=(1.0, 1.1, 4.9), chi2=0.3)


def memory(days=3, position_m=None, offset=RIGHT):
    of = BaseMemory()
    for day in range(days):
        of.remember(
            MOUNT,
            STATION,
            base_ecef_m() if position_m is None else position_m,
            time_ns=FIRST_NS + day * DAY_NS,
            offset=offset,
        )
    return of


@pytest.mark.parametrize("axis", [EAST, NORTH, UP])
@pytest.mark.parametrize(("step_m", "moved"), [(0.04, False), (0.06, True), (1.7, True), (90.0, True)])
def test_a_coordinate_that_steps_has_moved_and_is_named_with_its_vector(axis, step_m, moved):
    move = memory().compare(MOUNT, STATION, base_ecef_m() + step_m * axis)
    assert (move is not None) is moved
    if move is not None:
        assert np.linalg.norm(move.enu_m) == pytest.approx(step_m)
    text = str(memory().compare(MOUNT, STATION, base_ecef_m() + 1.7 * EAST))
    assert text == "+1.70 m east, +0.00 m north, +0.00 m up from its coordinate on 3 earlier days"


def test_many_small_steps_are_one_large_one():
    of, position_m = memory(1), base_ecef_m()
    moves = []
    for day in range(1, 10):
        position_m = position_m + 0.02 * EAST
        moves.append(of.compare(MOUNT, STATION, position_m))
        if moves[-1] is None:
            of.remember(MOUNT, STATION, position_m, time_ns=FIRST_NS + day * DAY_NS, offset=RIGHT)
    assert [move is not None for move in moves] == [False, False] + 7 * [True]


def test_another_mount_another_station_and_another_place_are_others():
    of = memory()
    assert of.compare("other", STATION, base_ecef_m() + EAST) is None
    assert of.compare(MOUNT, "rtcm-8", base_ecef_m() + EAST) is None
    assert of.compare(MOUNT, STATION, base_ecef_m() + (PLACE_M + 1.0) * EAST) is None


def test_two_places_of_one_number_are_both_remembered():
    of, far_m = memory(), base_ecef_m() + 5000.0 * EAST
    of.remember(MOUNT, STATION, far_m, time_ns=FIRST_NS, offset=RIGHT)
    assert of.compare(MOUNT, STATION, base_ecef_m() + EAST) is not None
    assert of.compare(MOUNT, STATION, far_m + EAST) is not None


def test_days_are_means_of_their_windows_and_offsets_over_days_rest_on_them():
    of = memory(2)
    more = BaseOffset(enu_m=(1.4, -0.3, 1.0), sigma_m=(1.0, 1.1, 4.9), chi2=2.0)
    of.remember(MOUNT, STATION, base_ecef_m(), time_ns=FIRST_NS, offset=more)
    offset = of.offset(MOUNT, STATION, base_ecef_m())
    assert offset.windows == 2
    assert offset.enu_m == pytest.approx((0.5 * (0.9 + 0.4), -0.3, 1.0))
    assert memory(1).offset(MOUNT, STATION, base_ecef_m()) is None
    assert memory().offset(MOUNT, "rtcm-8", base_ecef_m()) is None


def test_no_more_days_and_stations_are_kept_than_fit():
    of = memory(40)
    assert len(of.bases[0].days) == 32
    assert of.bases[0].days[-1].day - of.bases[0].days[0].day == 31
    for number in range(300):
        of.remember(MOUNT, f"s{number}", base_ecef_m(), time_ns=FIRST_NS, offset=RIGHT)
    assert len(of.bases) == 256
    assert memory_from_text(memory_as_text(of.bases)).bases == of.bases


@pytest.mark.parametrize(
    ("station", "time_ns"), [("x" * 65, FIRST_NS), (STATION, -DAY_NS)], ids=["name", "time"]
)
def test_what_no_file_can_have_is_not_remembered(station, time_ns):
    of = BaseMemory()
    of.remember(MOUNT, station, base_ecef_m(), time_ns=time_ns, offset=RIGHT)
    assert (of.bases, of.changed) == ([], False)


# --- files ------------------------------------------------------------------------------------------------------


def test_it_is_the_same_after_a_restart():
    again = memory_from_text(memory_as_text(memory().bases))
    assert (again.bases, again.changed) == (memory().bases, False)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda kept: kept | {"more": 1}, "more"),
        (lambda kept: kept | {"bases": [kept["bases"][0] | {"ecef_m": [1.0, 2.0]}]}, "bases.0.ecef_m"),
        (lambda kept: kept | {"bases": [kept["bases"][0] | {"ecef_m": [1e8, 2.0, 3.0]}]}, "bases.0.ecef_m"),
        (
            lambda kept: kept | {"bases": [kept["bases"][0] | {"ecef_m": [6.4e6, 0.0, 0.0]}]},
            "ecef_m: expected",
        ),
        (lambda kept: kept | {"bases": [kept["bases"][0] | {"days": []}]}, "bases.0.days"),
        (
            lambda kept: kept | {"bases": [kept["bases"][0] | {"days": 2 * kept["bases"][0]["days"]}]},
            "days of",
        ),
    ],
)
def test_a_file_with_any_other_content_is_refused(change, place):
    text = json.dumps(change(json.loads(memory_as_text(memory().bases))))
    with pytest.raises(ValueError, match=place):
        memory_from_text(text)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.integers(0, 10**6), st.integers(0, 255), st.booleans())
def test_a_file_that_is_cut_or_has_a_byte_changed_is_read_whole_or_refused(at, byte, cut):
    data = bytearray(memory_as_text(memory().bases).encode())
    at %= len(data)
    data = data[:at] if cut else data[:at] + bytes([byte]) + data[at + 1 :]
    try:
        of = memory_from_text(data.decode("utf-8", "replace"))
    except ValueError:
        return
    assert memory_from_text(memory_as_text(of.bases)).bases == of.bases


numbers = st.floats(allow_nan=True, allow_infinity=True)


@settings(derandomize=True, deadline=None)
@given(st.tuples(numbers, numbers, numbers), st.tuples(numbers, numbers, numbers), st.text(max_size=80))
def test_no_numbers_whatever_stop_it_and_nothing_unreadable_is_kept(position, enu_m, label):
    of, base = memory(), BaseStation(np.array(position))
    watch = BaseWatch(of, label)
    watch.station_stated(base, StationPosition(position_ecef_m=position, label=label))
    offset = BaseOffset(enu_m=enu_m, sigma_m=(1.0, 1.0, 1.0), chi2=0.0)
    of.remember(label, label, np.array(position), time_ns=FIRST_NS, offset=offset)
    assert memory_from_text(memory_as_text(of.bases)).bases == of.bases


# --- a station against the memory -------------------------------------------------------------------------------


def stated(of, position_m, *, confirmed=(), is_given=False, **changes):
    base = BaseStation(position_m)
    x, y, z = position_m.tolist()
    watch = BaseWatch(of, MOUNT, confirmed)
    watch.station_stated(
        base, StationPosition(position_ecef_m=(x, y, z), label=STATION, **changes), is_given=is_given
    )
    return base, watch


def test_a_station_where_it_was_is_used_with_its_offset_over_days():
    base, _ = stated(memory(), base_ecef_m())
    assert base.move is None
    assert base.offset_over_days.windows == 3
    assert base.name.startswith("rtcm-7@")


def test_a_station_that_moved_is_used_when_its_name_is_confirmed_and_then_is_the_one_remembered():
    moved_m, of = base_ecef_m() + 1.7 * NORTH, memory()
    base, _ = stated(of, moved_m)
    assert base.move.enu_m == pytest.approx((0.0, 1.7, 0.0), abs=1e-3)
    assert of.bases == memory().bases
    again, _ = stated(of, moved_m, confirmed=(base.name,))
    assert (again.move, of.bases, of.changed) == (None, [], True)
    elsewhere, _ = stated(memory(), moved_m + 0.5 * NORTH, confirmed=(base.name,))
    assert elsewhere.move is not None, "another coordinate is not what was confirmed"


def test_a_given_coordinate_is_confirmed_and_a_virtual_station_has_no_memory():
    assert stated(memory(), base_ecef_m() + NORTH, is_given=True)[0].move is None
    virtual, watch = stated(memory(), base_ecef_m() + NORTH, is_virtual=True)
    assert (virtual.move, virtual.offset_over_days) == (None, None)
    virtual.offset = RIGHT
    watch.remember(virtual)
    assert watch.memory.bases == memory().bases


def epoch_at(second):
    return type("Epoch", (), {"time_ns": FIRST_NS + second * NS_PER_SECOND})()


def test_it_is_remembered_every_ten_minutes_while_its_single_points_agree():
    of = BaseMemory()
    base, watch = stated(of, base_ecef_m())
    base.epoch = epoch_at(0)
    watch.remember(base)
    assert of.bases == [], "no minute yet"
    base.offset = RIGHT
    for second in range(0, 1300, 10):
        base.epoch = epoch_at(second)
        watch.remember(base)
    assert of.bases[0].days[0].windows == 3
    base.offset = BaseOffset(enu_m=(12.0, 0.0, 0.0), sigma_m=(1.0, 1.0, 1.0), chi2=144.0)
    base.epoch = epoch_at(5000)
    watch.remember(base)
    assert of.bases[0].days[0].windows == 3


def test_a_station_that_moved_is_not_remembered_and_one_that_changes_within_the_last_digit_is_compared_anew():
    of = memory()
    base, watch = stated(of, base_ecef_m() + NORTH)
    base.offset, base.epoch = RIGHT, epoch_at(0)
    watch.remember(base)
    assert of.bases == memory().bases
    x, y, z = (base_ecef_m() + NORTH).tolist()
    base.move_to(np.array([x + 1e-4, y, z]))
    watch.station_stated(base, StationPosition(position_ecef_m=(x + 1e-4, y, z), label=STATION))
    assert base.move is not None
    assert np.linalg.norm(base.move.enu_m) > SAME_M
