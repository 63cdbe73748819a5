"""MeasEpoch: every value equals that of pysbf2's fields with the reference guide's formulas."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.observations import ObservationEpoch, satellite_name, signal_name
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.sbf.reader import SbfDecoder
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from support.random_observations import random_epoch
from support.sbf_blocks import Tracked, meas_epoch, measurements_block, sbf_frame
from support.sbf_oracle import SIGNALS, observations_of

TIME_NS = 2367 * NS_PER_WEEK + 395_921 * NS_PER_SECOND
ATTRIBUTES = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz", "lock_time_s")
# Rounding of sums of doubles near 1e8 cycles; the resolution is 1e-3.
TOLERANCES = (1e-7, 1e-6, 1e-7, 0.0, 0.0)
UNKNOWN_SIGNALS = (16, 18, 35)


def epochs_of(data: bytes) -> tuple[list[ReceiverEpoch], SbfDecoder]:
    decoder = SbfDecoder("test")
    return [r for r in decoder.feed(data) + decoder.finish() if isinstance(r, ReceiverEpoch)], decoder


def epoch_of(frame: bytes) -> ObservationEpoch:
    (only,), _ = epochs_of(frame)
    return only.epoch


def rows(epoch: ObservationEpoch) -> dict[tuple[str, str], int]:
    names = map(satellite_name, epoch.satellite.tolist())
    keys = list(zip(names, map(signal_name, epoch.signal.tolist()), strict=True))
    assert len(set(keys)) == len(keys)
    return {key: row for row, key in enumerate(keys)}


def assert_equals_pysbf2(epoch: ObservationEpoch, frame: bytes) -> int:
    expected = observations_of(frame)
    row_of = rows(epoch)
    assert row_of.keys() == expected.keys()
    for key, row in row_of.items():
        for name, tolerance in zip(ATTRIBUTES, TOLERANCES, strict=True):
            value, other = float(getattr(epoch, name)[row]), getattr(expected[key], name)
            if other is None or math.isnan(other):
                assert math.isnan(value), (key, name)
            else:
                assert abs(value - other) <= tolerance, (key, name)
        assert epoch.half_cycle[row] == expected[key].half_cycle
    return len(row_of)


@st.composite
def tracked(draw: st.DrawFn, *, first: bool) -> Tracked:
    missing = draw(st.sets(st.integers(0, 4)))
    most_code = 2**36 - 1 if first else 2**18 - 1
    most_doppler = 2**31 - 1 if first else 2**20 - 1
    values = (
        draw(st.integers(1 if first else -most_code, most_code)),
        draw(st.integers(-(2**23) + 1, 2**23 - 1)),
        draw(st.integers(-most_doppler, most_doppler)),
        draw(st.integers(0, 254)),
        draw(st.integers(0, 65534 if first else 254)),
    )
    code, phase, doppler, cn0, lock = (None if k in missing else value for k, value in enumerate(values))
    return Tracked(
        signal=draw(st.sampled_from([*SIGNALS, *UNKNOWN_SIGNALS])),
        code_mm=code,
        phase_mcycles=phase,
        doppler_tmhz=doppler,
        cn0_quarters=cn0,
        lock_s=lock,
        info=draw(st.sampled_from([0, 1, 4, 5])),
        channel=draw(st.integers(-8, 14)),
        antenna=draw(st.sampled_from([0, 0, 0, 1])),
    )


SATELLITES = st.dictionaries(
    st.integers(0, 255),
    st.builds(
        lambda one, more: [one, *more], tracked(first=True), st.lists(tracked(first=False), max_size=4)
    ),
    max_size=20,
)


@given(SATELLITES, st.sampled_from([(0, 0), (4, 0), (0, 4), (8, 8)]))
@settings(derandomize=True, max_examples=200, deadline=None)
def test_values_equal_those_of_pysbf2(satellites: dict[int, list[Tracked]], extra: tuple[int, int]) -> None:
    frame = meas_epoch(TIME_NS, satellites, extra=extra)
    (only,), decoder = epochs_of(frame)
    assert only.epoch.time_ns == TIME_NS
    # pysbf2 knows the sub-blocks' lengths of today only.
    assert_equals_pysbf2(only.epoch, meas_epoch(TIME_NS, satellites))
    messages = decoder.messages
    omitted = messages.other_systems + messages.other_antennas + messages.unknown_signals
    total = sum(map(len, satellites.values()))
    assert only.epoch.satellite.size + omitted + messages.repeated_signals == total
    assert messages.other_antennas == sum(t.antenna == 1 for ts in satellites.values() for t in ts)


def one_signal(signal: int, svid: int, **values: int | None) -> ObservationEpoch:
    only = Tracked(signal=signal, code_mm=22_451_367_994, phase_mcycles=2039, doppler_tmhz=20_771_658)
    return epoch_of(meas_epoch(TIME_NS, {svid: [replace(only, **values)]}))


@pytest.mark.parametrize(
    ("signal", "svid", "name", "code"),
    [
        (0, 17, "G17", "1C"), (2, 17, "G17", "2W"), (3, 32, "G32", "2L"), (4, 1, "G01", "5Q"), (5, 1, "G01", "1L"),
        (6, 181, "J01", "1C"), (7, 187, "J07", "2L"), (26, 181, "J01", "5Q"), (32, 183, "J03", "1L"),
        (17, 71, "E01", "1C"), (19, 106, "E36", "6C"), (20, 71, "E01", "5Q"), (21, 71, "E01", "7Q"),
        (22, 71, "E01", "8Q"), (28, 141, "C01", "2I"), (29, 180, "C40", "7I"), (30, 223, "C41", "6I"),
        (8, 38, "R01", "1C"), (9, 61, "R24", "1P"), (10, 63, "R25", "2P"), (11, 45, "R08", "2C"), (12, 40, "R03", "3Q"),
        (13, 245, "C63", "1P"), (14, 160, "C20", "5P"), (34, 160, "C20", "7D"),
    ],
)  # fmt: skip
def test_numbers_of_satellites_and_signals_are_those_of_the_guide(
    signal: int, svid: int, name: str, code: str
) -> None:
    assert list(rows(one_signal(signal, svid))) == [(name, code)]


def test_e6_is_e6b_where_the_block_says_so() -> None:
    tracked_e6 = Tracked(signal=19, code_mm=25_000_000_000, phase_mcycles=0, doppler_tmhz=0)
    frame = meas_epoch(TIME_NS, {71: [tracked_e6]}, common_flags=0b0100_0000)
    assert list(rows(epoch_of(frame))) == [("E01", "6B")]


def test_cn0_has_an_offset_of_10_dbhz_but_for_gps_p_codes() -> None:
    assert one_signal(0, 5, cn0_quarters=120).cn0_dbhz.tolist() == [40.0]
    assert one_signal(1, 5, cn0_quarters=120).cn0_dbhz.tolist() == [30.0]
    assert one_signal(2, 5, cn0_quarters=120).cn0_dbhz.tolist() == [30.0]


def test_systems_that_are_not_supported_are_counted() -> None:
    sbas, navic = (Tracked(signal=s, code_mm=10**10, phase_mcycles=0, doppler_tmhz=0) for s in (24, 15))
    (only,), decoder = epochs_of(meas_epoch(TIME_NS, {191: [navic, navic], 123: [sbas]}))
    assert only.epoch.satellite.size == 0
    assert decoder.messages.other_systems == 3


def test_observations_round_trip_at_the_resolutions_of_the_block() -> None:
    rng = np.random.default_rng(3)
    carriers = {"G": {"1C": 1575.42e6, "2W": 1227.6e6}, "E": {"1C": 1575.42e6, "7Q": 1207.14e6}}
    compared = 0
    for _ in range(20):
        epoch = random_epoch(rng, TIME_NS, satellites=20, carriers=carriers, missing=0.0, most_range_m=3e7)
        number = 1 + (epoch.satellite & 255) % 32
        epoch = replace(
            epoch,
            satellite=(epoch.satellite & ~255) + number,
            # Signals of one satellite are within 262 m.
            pseudorange_m=2e7 + 1e5 * number + 100.0 * rng.random(number.size),
            carrier_phase_cycles=np.full(number.size, np.nan),
            cn0_dbhz=np.clip(epoch.cn0_dbhz, 10.0, 60.0),
        )
        decoded = epoch_of(measurements_block(epoch))
        row_of = rows(decoded)
        _, first = np.unique((epoch.satellite << 16) + epoch.signal, return_index=True)
        for row in first.tolist():
            k = row_of[satellite_name(int(epoch.satellite[row])), signal_name(int(epoch.signal[row]))]
            for name, resolution in (("pseudorange_m", 1e-3), ("cn0_dbhz", 0.25)):
                assert abs(getattr(decoded, name)[k] - getattr(epoch, name)[row]) <= 0.51 * resolution
            compared += 1
    assert compared > 300


def followed(steps: list[tuple[float, int | None]]) -> list[bool]:
    """Loss of lock of one signal at times [s] with lock times."""
    frames = b"".join(
        meas_epoch(
            TIME_NS + round(at_s * NS_PER_SECOND),
            {5: [Tracked(signal=0, code_mm=10**10, phase_mcycles=0, doppler_tmhz=0, lock_s=lock_s)]},
        )
        for at_s, lock_s in steps
    )
    return [bool(e.epoch.loss_of_lock[0]) for e in epochs_of(frames)[0]]


def test_loss_of_lock_follows_from_the_lock_time() -> None:
    assert followed([(0, 10), (1, 11), (2, 0), (3, 1)]) == [False, False, True, False]
    # A whole second is the resolution, and the greatest value means "at least".
    assert followed([(0, 0), (0.5, 0), (1, 1), (1.5, 1)]) == [False, False, False, False]
    assert followed([(0, 65534), (100_000, 65534)]) == [False, False]
    # Two seconds after the last phase, a lock of less than two seconds is a new one.
    assert followed([(0, 0), (2, 0)]) == [False, True]
    assert followed([(0, None), (1, None)]) == [False, True]


def test_change_of_the_count_of_clock_jumps_is_a_reset() -> None:
    data = b"".join(
        meas_epoch(TIME_NS + k, {}, clock_jumps=jumps) for k, jumps in enumerate((7, 7, 8, 8, 255, 0))
    )
    assert [e.clock_reset for e in epochs_of(data)[0]] == [False, False, True, False, True, True]


@pytest.mark.parametrize("cut", [20, 30, 40, 44])
def test_truncated_block_is_malformed(cut: int) -> None:
    tracked_l1 = Tracked(signal=0, code_mm=10**10, phase_mcycles=0, doppler_tmhz=0)
    whole = meas_epoch(TIME_NS, {5: [tracked_l1, replace(tracked_l1, signal=3, code_mm=0)]})
    frame = sbf_frame(4027, whole[8:cut])
    decoded, decoder = epochs_of(frame)
    assert not decoded
    assert decoder.messages.malformed == 1


def test_blocks_before_the_receiver_knows_the_time_are_counted() -> None:
    decoded, decoder = epochs_of(meas_epoch(None, {}))
    assert not decoded
    assert decoder.messages.without_time == 1
