"""Which ephemeris is in use when, and what is refused."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from camber.formats.observations import CARRIER_OF_BAND_HZ, Ephemeris, satellite_number
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst
from camber.gnss.observations.ephemeris_store import OLDEST_NS, EphemerisStore, group_delays_s
from camber.simulator.satellites.constellation import true_ephemerides

HOUR_NS = 3600 * 10**9
NOON_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 12, 0, 0))
OF_DAY = true_ephemerides(NOON_NS, NOON_NS + HOUR_NS, 11)
INAV, FNAV = {"data_sources": 517.0}, {"data_sources": 258.0}


def one(name: str, toe_ns: int = NOON_NS, **changed: object) -> Ephemeris:
    e = next(e for e in OF_DAY if e.satellite == satellite_number(name))
    moved = replace(e, toe_ns=toe_ns, toc_ns=toe_ns, transmission_ns=toe_ns, iode=toe_ns // 10**9 % 1021)
    return replace(moved, **changed)


def filled(*ephemerides: Ephemeris) -> EphemerisStore:
    store = EphemerisStore()
    for e in ephemerides:
        store.add(e)
    return store


def toe_in_use(store: EphemerisStore, time_ns: int, name: str) -> int | None:
    row = int(store.rows_at(time_ns, np.array([satellite_number(name)]))[0])
    if row < 0:
        return None
    assert int(store.table.satellite[row]) == satellite_number(name)
    return int(store.table.toe_ns[row])


@pytest.mark.parametrize("name", ["G05", "J02", "E11", "C20"])
def test_an_ephemeris_is_in_use_until_its_systems_age_and_not_a_nanosecond_longer(name):
    store, oldest = filled(one(name)), OLDEST_NS[name[0]]
    edges = [NOON_NS + sign * (oldest + more) for sign in (-1, 1) for more in (-1, 0, 1)]
    # Each after each: what was chosen for one time must not outlive it.
    for time_ns in (t for pair in itertools.permutations([NOON_NS, *edges], 2) for t in pair):
        expected = NOON_NS if abs(time_ns - NOON_NS) <= oldest else None
        assert toe_in_use(store, time_ns, name) == expected
    for time_ns in (NOON_NS - oldest - 1, NOON_NS + oldest + 1):
        assert store.missing(time_ns, np.array([satellite_number(name)])) == {name: "too_old"}


def test_the_nearest_toe_is_in_use_forwards_and_backwards():
    toes = [NOON_NS + k * 2 * HOUR_NS for k in range(4)]
    store = filled(*(one("G05", toe) for toe in toes))
    rng = np.random.default_rng(1)
    steps = [*range(-HOUR_NS, 7 * HOUR_NS, HOUR_NS // 7), *rng.integers(-HOUR_NS, 7 * HOUR_NS, 300).tolist()]
    near = [toe + d for toe in toes for d in (HOUR_NS - 2, HOUR_NS - 1, HOUR_NS + 1, HOUR_NS + 2)]
    for time_ns in [*(NOON_NS + s for s in steps), *near, *reversed(near)]:
        expected = min(toes, key=lambda toe: abs(time_ns - toe))
        assert toe_in_use(store, time_ns, "G05") == expected


def test_what_comes_later_is_in_use_at_once():
    store = filled(one("G05"))
    now_ns = NOON_NS + 90 * 60 * 10**9
    assert toe_in_use(store, now_ns, "G05") == NOON_NS
    store.add(one("G05", NOON_NS + 2 * HOUR_NS))
    assert toe_in_use(store, now_ns, "G05") == NOON_NS + 2 * HOUR_NS


def test_an_unhealthy_set_is_not_used_nor_the_older_one_in_its_place():
    late_ns = NOON_NS + 2 * HOUR_NS
    store = filled(one("G05"), one("G05", late_ns, health=1))
    assert store.refused == {"unhealthy": 1}
    assert toe_in_use(store, NOON_NS, "G05") == NOON_NS
    assert toe_in_use(store, late_ns - 10**9, "G05") is None
    assert store.missing(late_ns, np.array([satellite_number("G05")])) == {"G05": "unhealthy"}


def test_health_that_changes_within_one_issue_counts_from_then_on():
    store = filled(one("G05"), one("G05", health=63, transmission_ns=NOON_NS + 10**9))
    assert toe_in_use(store, NOON_NS, "G05") is None
    older = one("G05", transmission_ns=NOON_NS - 10**9)
    assert store.add(older) == "unhealthy", "an older one changes nothing"
    assert store.add(one("G05", transmission_ns=NOON_NS + 2 * 10**9)) is None
    assert toe_in_use(store, NOON_NS, "G05") == NOON_NS


def test_qzss_is_healthy_without_the_signal_that_is_not_used():
    assert filled(one("J02", health=1)).refused == {}
    assert filled(one("J02", health=62)).refused == {"unhealthy": 1}


def test_the_same_once_more_changes_nothing():
    store = filled(one("G05"), one("E11"))
    store.rows_at(NOON_NS, np.array([satellite_number("G05")]))
    table = store.table
    assert store.add(one("G05", transmission_ns=NOON_NS + 10**10)) is None
    store.rows_at(NOON_NS, np.array([satellite_number("G05")]))
    assert store.table is table
    assert len(store) == 2


def test_galileo_has_one_kind_of_message_for_all():
    names = ["E11", "E12", "E19"]
    numbers = np.array([satellite_number(name) for name in names])
    inav = [one(name, other=INAV) for name in names]
    fnav = [one(name, other=FNAV, clock=(1e-4, 0.0, 0.0)) for name in names]
    both = filled(*fnav, *inav)
    assert not np.any(both.table.elements[both.rows_at(NOON_NS, numbers)][:, 18] == 1e-4)
    for more in (filled(*fnav), filled(*fnav, inav[0])):
        assert np.all(more.table.elements[more.rows_at(NOON_NS, numbers)][:, 18] == 1e-4)
    assert filled(inav[0], fnav[1]).missing(NOON_NS, numbers) == {"E12": "none", "E19": "none"}


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"eccentricity": 0.6}, "orbit"),
        ({"eccentricity": -0.01}, "orbit"),
        ({"sqrt_a": 0.0}, "orbit"),
        ({"sqrt_a": 2500.0}, "orbit"),
        ({"mean_anomaly_rad": math.nan}, "not_finite"),
        ({"clock": (math.inf, 0.0, 0.0)}, "not_finite"),
        ({"clock": (0.0, 0.1, 0.0)}, "clock"),
        ({"transmission_ns": NOON_NS + 7 * 24 * HOUR_NS}, "times"),
        ({"toc_ns": NOON_NS + 13 * HOUR_NS}, "times"),
        ({"satellite": satellite_number("R05")}, "system"),
        ({"satellite": satellite_number("G00")}, "system"),
        ({"satellite": -5}, "system"),
        ({"satellite": 10**9}, "system"),
    ],
)
def test_what_cannot_be_meant_is_refused_and_counted(changed, reason):
    store = EphemerisStore()
    assert store.add(replace(one("G05"), **changed)) == reason
    assert store.refused == {reason: 1}
    assert len(store) == 0


def test_a_time_of_transmission_that_is_not_known_is_no_fault():
    assert filled(one("G05", transmission_ns=0)).refused == {}


def test_memory_is_bounded_and_the_newest_stay():
    store = EphemerisStore(most_of_satellite=3)
    for k in range(50):
        store.add(one("G05", NOON_NS + k * 2 * HOUR_NS))
    assert len(store) == 3
    assert toe_in_use(store, NOON_NS + 98 * HOUR_NS, "G05") == NOON_NS + 98 * HOUR_NS
    assert toe_in_use(store, NOON_NS, "G05") is None


def test_numbers_of_no_satellite_have_no_row():
    store = filled(one("G05"))
    strange = np.array([-1, 0, 2**62, -(2**62), satellite_number("G05"), satellite_number("G06")])
    assert (store.rows_at(NOON_NS, strange) >= 0).tolist() == [False, False, False, False, True, False]
    assert store.rows_at(NOON_NS, np.zeros(0, np.int64)).shape == (0,)


def test_group_delays_are_those_of_each_systems_document():
    g = group_delays_s(one("G05", other={"tgd_s": 1e-8}))
    assert g["1"] == 1e-8
    assert g["2"] == pytest.approx(1e-8 * (77 / 60) ** 2)
    c = group_delays_s(one("C20", other={"tgd1_s": 1e-8, "tgd2_s": 3e-9}))
    assert (c["2"], c["7"], c["6"]) == (1e-8, 3e-9, 0.0)
    assert group_delays_s(one("G05", other={})) == {}
    assert group_delays_s(one("E11", other={"bgd_e5a_s": 1e-9})) == {}, "I/NAV's clock is that of E5b"


def test_galileos_delays_leave_the_clock_without_ionosphere_where_it_is():
    carriers = CARRIER_OF_BAND_HZ["E"]
    delays = {"bgd_e5a_s": 3e-9, "bgd_e5b_s": 5e-9}
    for sources, band in ((INAV, "7"), (FNAV, "5")):
        selected = group_delays_s(one("E11", other=delays | sources))
        gamma = (carriers["1"] / carriers[band]) ** 2
        assert (selected[band] - gamma * selected["1"]) / (1.0 - gamma) == pytest.approx(0.0, abs=1e-20)
        for other, name in (("5", "bgd_e5a_s"), ("7", "bgd_e5b_s")):
            bgd = (selected["1"] - selected[other]) / (1.0 - (carriers["1"] / carriers[other]) ** 2)
            assert bgd == pytest.approx(delays[name], rel=1e-9)
