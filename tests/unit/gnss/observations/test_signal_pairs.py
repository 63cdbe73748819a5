"""Which signals of rover and base are differenced."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    SPEED_OF_LIGHT_M_S,
    satellite_number,
    signal_number,
)
from camber.gnss.observations.signal_pairs import (
    GROUPS,
    SYSTEMS,
    WAVELENGTH_M,
    SignalColumns,
    band_of,
    group_of,
    groups_of,
    pair_signals,
    systems_of,
)

ALL = np.ones(GROUPS, np.bool_)


def of(*names: str) -> tuple[np.ndarray, np.ndarray]:
    """`G05:1C` as the numbers of satellite and signal."""
    satellites = np.array([satellite_number(name.split(":")[0]) for name in names], np.int64)
    signals = np.array([signal_number(name.split(":")[1]) for name in names], np.int64)
    return satellites, signals


def columns(*names: str) -> SignalColumns:
    """Columns of an epoch of these signals, with unknown measurements."""
    satellites, signals = of(*names)
    unknown = np.full(len(names), np.nan)
    return SignalColumns(
        0, satellites, signals, *[unknown] * 5, loss_of_lock=np.isinf(unknown), half_cycle=np.isinf(unknown)
    )


def paired(rover: list[str], base: list[str], rover_parts=None, base_parts=None, groups=ALL) -> list[str]:
    """Pairs as `G05:1C-1C`."""
    rover_usable, base_usable = np.full(len(rover), 2), np.full(len(base), 2)
    rover_usable[:] = 2 if rover_parts is None else rover_parts
    base_usable[:] = 2 if base_parts is None else base_parts
    pairs = pair_signals(
        columns(*rover), rover_usable, columns(*base), base_usable=base_usable, groups=groups
    )
    return [f"{rover[i]}-{base[j].split(':')[1]}" for i, j in zip(*pairs[:2], strict=True)]


def group(name: str) -> int:
    (satellite,), (signal,) = of(name)
    return group_of(satellite, signal)


def test_a_group_is_a_carrier_of_systems_with_one_clock():
    assert group("G01:1C") == group("J02:1C")
    assert group("G01:1C") != group("E01:1C")
    assert group("C21:1P") != group("C21:2I")
    assert group("G01:2L") == group("G01:2X") != group("G01:2W")
    carriers_hz = {"G01:2W": 1227.6e6, "C30:2I": 1561.098e6, "E11:7Q": 1207.14e6, "J01:5X": 1176.45e6}
    for name, hz in carriers_hz.items():
        assert WAVELENGTH_M[group(name)] == pytest.approx(SPEED_OF_LIGHT_M_S / hz)


def test_every_band_of_every_system_follows_from_its_group():
    for letter, bands in CARRIER_OF_BAND_HZ.items():
        for band in bands:
            pairs = {group_of(ord(letter) * 256 + 1, ord(band) * 256 + code) for code in range(65, 91)} - {-1}
            for g in pairs:
                assert band_of(g) == int(band)
                assert SYSTEMS[systems_of(np.array([g]))[0]] == ("G" if letter == "J" else letter)


@pytest.mark.parametrize("satellite", [-1, 0, 255, ord("I") * 256 + 1, ord("S") * 256 + 20, 2**40, -(2**40)])
def test_what_is_no_satellite_that_is_used_has_no_group(satellite):
    assert group_of(satellite, signal_number("1C")) == -1


@given(st.integers(-(2**31), 2**31), st.integers(-(2**31), 2**31))
@settings(derandomize=True, max_examples=300)
def test_no_number_is_too_odd_for_a_group(satellite, signal):
    assert -1 <= group_of(satellite, signal) < GROUPS


def test_codes_of_one_signal_are_paired_and_codes_of_two_are_not():
    assert paired(["G01:2L"], ["G01:2X"]) == ["G01:2L-2X"]
    assert paired(["G01:2L"], ["G01:2W"]) == []
    assert paired(["G01:2W"], ["G01:2W"]) == ["G01:2W-2W"]
    assert paired(["G01:1C"], ["G02:1C"]) == []


def test_a_satellite_and_band_is_one_row_with_most_to_offer():
    assert paired(["G01:2W", "G01:2L"], ["G01:2W", "G01:2L"]) == ["G01:2L-2L"]
    assert paired(["G01:2W", "G01:2L"], ["G01:2W", "G01:2L"], base_parts=[2, 1]) == ["G01:2W-2W"]
    assert paired(["G01:2L"], ["G01:2X", "G01:2L"]) == ["G01:2L-2L"]
    assert paired(["G01:2L"], ["G01:2X", "G01:2L"], base_parts=[2, 1]) == ["G01:2L-2X"]
    assert paired(["G01:1C"], ["G01:1C"], rover_parts=[0]) == []
    assert paired(["G01:1C"], ["G01:1C"], base_parts=[0]) == []


def test_a_satellite_that_is_there_twice_counts_once():
    assert paired(["G01:1C"] * 3, ["G01:1C"] * 2) == ["G01:1C-1C"]


def test_groups_that_are_not_chosen_are_left_out():
    only = groups_of({"G": "1", "E": "5"})
    names = ["G01:1C", "G01:2L", "J01:1C", "E01:1C", "E01:5Q", "C30:1P"]
    assert paired(names, names, groups=only) == ["G01:1C-1C", "J01:1C-1C", "E01:5Q-5Q"]


@pytest.mark.parametrize("bands", [{"S": "1"}, {"R": "3"}, {"G": "7"}, {"J": "1"}, {"E": "1x"}])
def test_a_band_that_no_system_has_is_refused(bands):
    with pytest.raises(ValueError, match="expected a system of GECR"):
        groups_of(bands)


@given(st.randoms(use_true_random=False))
@settings(derandomize=True, max_examples=50)
def test_the_order_of_rows_changes_no_pair(random):
    names = ["G01:1C", "G01:2L", "G01:2W", "G02:1C", "E05:1X", "E05:5Q", "C30:2I", "C30:1P", "J02:5X"]
    other = ["G01:1C", "G01:2X", "G02:1C", "G02:1L", "E05:1C", "E05:5I", "C30:2I", "C30:1D", "J02:5Q"]
    expected = sorted(paired(names, other))
    assert sorted(paired(random.sample(names, len(names)), random.sample(other, len(other)))) == expected
