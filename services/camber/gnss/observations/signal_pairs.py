"""Signals of rover and base that are differenced with one another.

A group shares a carrier, a clock and its delays: system (GPS with QZSS, Galileo, BeiDou, GLONASS; Kikuchi (TUMSAT)
forms double differences per system), band, and family of codes. Satellites of GLONASS share a clock, their carriers
differ. The parts of one signal and their sum (`2S` `2L` `2X`) may be differenced; another signal of the same band
(`2W`) has a different delay in each receiver, and receivers of different make disagree about its quarter of a cycle.
"""

from __future__ import annotations

from functools import lru_cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    CHANNEL_STEP_HZ,
    SPEED_OF_LIGHT_M_S,
    Floats,
    Integers,
    ObservationEpoch,
)

Booleans = NDArray[np.bool_]

SYSTEMS = "GECR"
"""Systems with a receiver clock each; QZSS belongs to GPS. A group's number is (10 · index + band) · 4 + family."""
_MOST_FAMILIES = 4  # families of codes that the numbering of groups has room for
MOST_BANDS = 10  # a band is the digit of a signal's code (RINEX 3.04)
_FDMA = SYSTEMS.index("R")
GROUPS = len(SYSTEMS) * MOST_BANDS * _MOST_FAMILIES

_FAMILIES: dict[str, dict[str, tuple[str, ...]]] = {
    "G": {"1": ("C", "SLX", "PWYM"), "2": ("SLX", "PWYM", "C"), "5": ("IQX",)},
    "J": {"1": ("C", "SLX", "EB"), "2": ("SLX",), "5": ("IQX", "DP")},
    "E": {"1": ("ABCXZ",), "5": ("IQX",), "7": ("IQX",), "8": ("IQX",), "6": ("ABCXZ",)},
    "C": {"1": ("DPX", "A"), "2": ("IQX",), "5": ("DPX",), "7": ("IQX", "DPZ"), "8": ("DPX",), "6": ("IQX", "DPZ")},
    "R": {"1": ("C", "P"), "2": ("C", "P")},
}  # fmt: skip
"""Codes by system and band (RINEX 4.01, tables 10 to 16), the family that is tracked best comes first. Of GLONASS those
with frequency channels."""


def _family_table() -> NDArray[np.int8]:
    """Rank of the family by letter, band and code, 0 for the best; −1: not used."""
    table = np.full((128, 10, 128), -1, np.int8)
    for letter, bands in _FAMILIES.items():
        for band, families in bands.items():
            for rank, codes in enumerate(families):
                table[ord(letter), int(band), [ord(code) for code in codes]] = rank
    return table


def _carriers() -> Floats:
    table = np.full((128, MOST_BANDS), np.nan)
    for letter, bands in CARRIER_OF_BAND_HZ.items():
        table[ord(letter), [int(band) for band in bands]] = list(bands.values())
    return table


_FAMILY = _family_table()
CARRIER_HZ = _carriers()
"""By system letter and band (128, 10), of GLONASS' channel 0; NaN for a band that the system has not got."""
CHANNEL_HZ = np.zeros((128, MOST_BANDS))
"""Distance of neighbouring frequency channels by system letter and band (128, 10); 0 but for GLONASS."""
CHANNEL_HZ[ord("R"), [int(band) for band in CHANNEL_STEP_HZ]] = list(CHANNEL_STEP_HZ.values())
SYSTEM_INDEX = np.full(128, -1)
"""Index in `SYSTEMS` by system letter (128,); −1: not used."""
SYSTEM_INDEX[[ord(letter) for letter in "GJECR"]] = [0, 0, 1, 2, 3]
WAVELENGTH_M = np.repeat(SPEED_OF_LIGHT_M_S / CARRIER_HZ[[ord(letter) for letter in SYSTEMS]], _MOST_FAMILIES)
"""Of each group (160,), of GLONASS' channel 0; NaN for a band that the system has not got."""
L1_M = SPEED_OF_LIGHT_M_S / CARRIER_OF_BAND_HZ["G"]["1"]


def systems_of(group: Integers) -> Integers:
    """Index in `SYSTEMS` of each group."""
    return group // (10 * _MOST_FAMILIES)


@compiled
def has_integers(group: int) -> bool:
    """Whether the double-difference ambiguities of a group are integers: its satellites have one carrier."""
    return group // (10 * _MOST_FAMILIES) != _FDMA


@compiled
def band_of(group: int) -> int:
    """RINEX digit of a group's band."""
    return group // _MOST_FAMILIES % 10


def groups_of(bands: dict[str, str]) -> Booleans:
    """Groups in use (160,), from bands by system letter such as {"G": "125"}; ValueError for unknown ones."""
    used = np.zeros((len(SYSTEMS), MOST_BANDS, _MOST_FAMILIES), np.bool_)
    for letter, digits in bands.items():
        for band in digits:
            if letter not in SYSTEMS or band not in _FAMILIES[letter]:
                raise ValueError(f"{letter}{band}: expected a system of {SYSTEMS} and one of its bands")
            used[SYSTEMS.index(letter), int(band)] = True
    return used.ravel()


@compiled
def group_of(satellite: int, signal: int) -> int:
    """Group of a signal (numbers of `camber.formats.observations`); −1 where it is not used."""
    letter, band, code = satellite >> 8, (signal >> 8) - 48, signal & 127
    if letter < 0 or letter > 127 or band < 0 or band > 9 or SYSTEM_INDEX[letter] < 0:
        return -1
    family = _FAMILY[letter, band, code]
    if family < 0:
        return -1
    return int((10 * SYSTEM_INDEX[letter] + band) * _MOST_FAMILIES + family)


class SignalColumns(NamedTuple):
    """An `ObservationEpoch` for the compiled code."""

    time_ns: int
    satellite: Integers
    signal: Integers
    pseudorange_m: Floats
    carrier_phase_cycles: Floats
    doppler_hz: Floats
    cn0_dbhz: Floats
    lock_time_s: Floats
    loss_of_lock: Booleans
    half_cycle: Booleans


_COLUMNS = attrgetter(*SignalColumns._fields)


@lru_cache(maxsize=8)
def columns_of(epoch: ObservationEpoch) -> SignalColumns:
    """Columns of an epoch for the compiled code; each step of the engine asks for those of rover and base."""
    return SignalColumns._make(_COLUMNS(epoch))


class SignalPairs(NamedTuple):
    """Rows of rover and base that are differenced, their group (k,), and the index (k,) of their satellite, or −1."""

    rover: Integers
    base: Integers
    group: Integers
    place: Integers


@compiled
def pair_signals(
    rover: SignalColumns, rover_usable: Integers, base: SignalColumns, base_usable: Integers, groups: Booleans
) -> SignalPairs:
    """Pairs of rows to be differenced, one for each satellite and band; `place` is −1 throughout.

    `usable` (n,) is 2 where a row has code and phase, 1 where it has the code only, 0 where it has neither. Of several
    codes the most usable at both receivers is taken, then the better family, then the same code on both sides.
    A satellite that occurs twice counts once, by its first row.
    """
    count = rover.satellite.size
    rover_row, base_row = np.empty(count, np.int64), np.empty(count, np.int64)
    pair_group, score = np.empty(count, np.int64), np.empty(count, np.int64)
    base_group = np.empty(base.satellite.size, np.int64)
    for j in range(base.satellite.size):
        base_group[j] = group_of(base.satellite[j], base.signal[j])
    pairs = 0
    for i in range(count):
        if rover_usable[i] == 0:
            continue
        group = group_of(rover.satellite[i], rover.signal[i])
        if group < 0 or not groups[group]:
            continue
        family = group % _MOST_FAMILIES
        best_row, best_score = -1, -1
        for j in range(base.satellite.size):
            if base.satellite[j] != rover.satellite[i] or base_usable[j] == 0 or base_group[j] != group:
                continue
            same = 1 if base.signal[j] == rover.signal[i] else 0
            offer = 100 * min(rover_usable[i], base_usable[j]) + 10 * (5 - family) + same
            if offer > best_score:
                best_row, best_score = j, offer
        if best_row < 0:
            continue
        place = pairs
        for k in range(pairs):
            same_band = pair_group[k] // _MOST_FAMILIES == group // _MOST_FAMILIES
            if same_band and rover.satellite[rover_row[k]] == rover.satellite[i]:
                place = k
                break
        if place < pairs and best_score <= score[place]:
            continue
        rover_row[place], base_row[place] = i, best_row
        pair_group[place], score[place] = group, best_score
        if place == pairs:
            pairs += 1
    return SignalPairs(
        rover_row[:pairs].copy(),
        base_row[:pairs].copy(),
        pair_group[:pairs].copy(),
        np.full(pairs, -1, np.int64),
    )
