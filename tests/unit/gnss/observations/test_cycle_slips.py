"""Where a phase is one unbroken count: each cause of a break breaks what it befalls, and nothing else does."""

from dataclasses import replace

import numpy as np
import pytest

from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    CHANNEL_STEP_HZ,
    SPEED_OF_LIGHT_M_S,
    ObservationEpoch,
    satellite_number,
    signal_number,
)
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.gnss.observations.cycle_slips import REASONS, CycleSlipDetector
from support.engine_drives import some_rows

SIGNALS = [
    *(f"G{n:02d}:{code}" for n in (1, 7, 12, 32) for code in ("1C", "2L", "5Q")),
    *(f"E{n:02d}:{code}" for n in (3, 36) for code in ("1C", "7Q")),
    "J02:1C", "J02:5Q", "C21:2I", "C63:7I", "R01:1C", "R01:2C", "R07:1C",
]  # fmt: skip
NAMES = np.array([satellite_number(s.split(":")[0]) for s in SIGNALS], np.int64)
CODES = np.array([signal_number(s.split(":")[1]) for s in SIGNALS], np.int64)
CHANNELS = {"R01": 6, "R07": -7}
HZ = np.array(
    [
        CARRIER_OF_BAND_HZ[s[0]][s[4]] + CHANNELS.get(s[:3], 0) * CHANNEL_STEP_HZ.get(s[4], 0.0)
        for s in SIGNALS
    ]
)
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / HZ
START_NS = 1_400_000_000 * 10**9


def drive(rate_hz: int, count: int, *, seed: int = 1, noisy: bool = True) -> list[ObservationEpoch]:
    """A moving car: ranges with an acceleration of 3 m/s² and a clock that drifts by 300 m/s."""
    rng = np.random.default_rng(seed)
    _, of = np.unique(NAMES, return_inverse=True)
    speed, phase = rng.uniform(-800, 800, of.max() + 1), rng.uniform(0, 6, of.max() + 1)
    epochs = []
    for k in range(count):
        t = k / rate_hz
        swing = 12.0 * np.sin(0.5 * t + phase)  # m: 3 m/s² at the most
        range_m = (2.2e7 + speed * t + swing + 300.0 * t)[of]
        rate_m_s = (speed + 6.0 * np.cos(0.5 * t + phase) + 300.0)[of]
        noise = (0.003 * rng.normal(size=len(of)), 0.05 * rng.normal(size=len(of))) if noisy else (0.0, 0.0)
        epoch = ObservationEpoch(
            time_ns=START_NS + round(t * 1e9),
            satellite=NAMES,
            signal=CODES,
            pseudorange_m=range_m,
            carrier_phase_cycles=(range_m + noise[0]) / WAVELENGTH_M + 1234,
            doppler_hz=-(rate_m_s + noise[1]) / WAVELENGTH_M,
            cn0_dbhz=np.full(len(of), 45.0),
            lock_time_s=np.full(len(of), 30.0 + t),
            loss_of_lock=np.zeros(len(of), np.bool_),
            half_cycle=np.zeros(len(of), np.bool_),
        )
        epochs.append(epoch)
    return epochs


def slipped(epochs: list[ObservationEpoch], rows, cycles, begin: int = 4) -> list[ObservationEpoch]:
    """More cycles in some rows from an epoch on."""
    after = [changed(e, "carrier_phase_cycles", rows, lambda v: v + cycles) for e in epochs[begin:]]
    return epochs[:begin] + after


def changed(epoch: ObservationEpoch, name: str, rows, change) -> ObservationEpoch:
    column = getattr(epoch, name).copy()
    column[rows] = change(column[rows])
    return replace(epoch, **{name: column})


def broken_in(epochs: list[ObservationEpoch]) -> tuple[list[str], dict[str, int], list[np.ndarray]]:
    """Signals whose arcs were broken after the first epoch, reasons (without new), arcs of each epoch."""
    tracker = CycleSlipDetector()
    arcs = [tracker.update(epoch) for epoch in epochs]
    broken = [SIGNALS[i] for i in range(len(SIGNALS)) if len({a[i] for a in arcs} - {0}) > 1]
    begun = dict(zip(REASONS, tracker.begun.tolist(), strict=True))
    return broken, {r: n for r, n in begun.items() if n and r not in ("new", "continuous")}, arcs


@pytest.mark.parametrize("rate_hz", [1, 5, 10])
@pytest.mark.parametrize("seed", range(5))
def test_nothing_breaks_a_car_in_the_open(rate_hz, seed):
    broken, reasons, arcs = broken_in(drive(rate_hz, 12 * rate_hz, seed=seed))
    assert (broken, reasons) == ([], {})
    assert len(set(arcs[0].tolist())) == len(SIGNALS)
    assert arcs[0].min() > 0


@pytest.mark.parametrize("rate_hz", [1, 10])
@pytest.mark.parametrize("row", [0, 4, 13, 17])
@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("loss_of_lock", lambda v: True, "receiver_flag"),
        ("lock_time_s", lambda v: v - 20.0, "lock_time"),
        ("lock_time_s", lambda v: 0.0, "lock_time"),
        ("half_cycle", lambda v: True, "half_cycle"),
    ],
)
def test_what_the_receiver_says_of_one_signal_breaks_that_one(rate_hz, row, name, change, reason):
    epochs = drive(rate_hz, 6)
    epochs[4] = changed(epochs[4], name, [row], change)
    if name == "half_cycle":
        epochs[5] = changed(epochs[5], name, [row], change)
    if name == "lock_time_s":
        epochs[5] = changed(epochs[5], name, [row], lambda v: epochs[4].lock_time_s[row] + 1.0 / rate_hz)
    broken, reasons, _ = broken_in(epochs)
    assert (broken, reasons) == ([SIGNALS[row]], {reason: 1})


def test_a_half_cycle_that_comes_and_goes_breaks_twice():
    epochs = drive(1, 6)
    epochs[3] = changed(epochs[3], "half_cycle", [2], lambda v: True)
    assert broken_in(epochs)[1] == {"half_cycle": 2}


@pytest.mark.parametrize("rate_hz", [1, 10])
@pytest.mark.parametrize("cycles", [1, -1, 3])
def test_an_unflagged_slip_breaks_the_bands_of_its_satellite(rate_hz, cycles):
    """Which band slipped is not known from their difference; where the Doppler knows, only that one breaks."""
    broken, reasons, _ = broken_in(slipped(drive(rate_hz, 8), [4], cycles))
    if rate_hz == 10:
        assert (broken, reasons) == (["G07:2L"], {"doppler": 1})
    else:
        assert set(broken) >= {"G07:2L"}
        assert set(broken) <= {"G07:1C", "G07:2L", "G07:5Q"}
        assert set(reasons) <= {"geometry_free", "doppler"}


def test_a_slip_of_the_same_length_in_all_bands_is_seen_by_the_doppler():
    epochs = slipped(drive(10, 8), [3, 4, 5], 5.0 / WAVELENGTH_M[3:6])
    assert broken_in(epochs)[:2] == (["G07:1C", "G07:2L", "G07:5Q"], {"doppler": 3})


def test_the_order_of_a_satellites_bands_does_not_say_what_breaks():
    epochs = slipped(drive(1, 6), [1], 1.0, begin=3)
    without = [replace(e, doppler_hz=np.full(len(SIGNALS), np.nan)) for e in epochs]
    assert broken_in(without)[0] == ["G01:1C", "G01:2L", "G01:5Q"]
    for order in ([1, 0, 2], [2, 1, 0], [0, 2, 1]):
        rows, tracker = np.array(order + list(range(3, len(SIGNALS)))), CycleSlipDetector()
        arcs = [tracker.update(some_rows(e, rows)) for e in without]
        assert [len({a[i] for a in arcs}) for i in range(4)] == [2, 2, 2, 1]


@pytest.mark.parametrize("rate_hz", [1, 10])
@pytest.mark.parametrize("step_ms", [1.0, -1.0, 0.5, 100.0])
def test_a_step_of_the_receivers_clock_breaks_nothing(rate_hz, step_ms):
    metres = step_ms * 1e-3 * SPEED_OF_LIGHT_M_S
    epochs = slipped(drive(rate_hz, 8), slice(None), metres / WAVELENGTH_M)
    assert broken_in(epochs)[:2] == ([], {})


@pytest.mark.parametrize("rate_hz", [1, 10])
def test_without_doppler_and_lock_times_a_car_in_the_open_is_unbroken_too(rate_hz):
    nothing = np.full(len(SIGNALS), np.nan)
    epochs = [replace(e, doppler_hz=nothing, lock_time_s=nothing) for e in drive(rate_hz, 20)]
    assert broken_in(epochs)[:2] == ([], {})


def test_a_gap_breaks_what_it_befalls_and_a_missed_epoch_does_not():
    epochs = drive(1, 10)
    for k in range(3, 6):
        epochs[k] = changed(epochs[k], "carrier_phase_cycles", [2], lambda v: np.nan)
    epochs[7] = changed(epochs[7], "carrier_phase_cycles", [9], lambda v: np.nan)
    broken, reasons, arcs = broken_in(epochs)
    assert (broken, reasons) == (["G01:5Q"], {"gap": 1})
    assert (arcs[4][2], arcs[7][9]) == (0, 0)


def test_a_time_that_does_not_go_on_breaks_everything():
    epochs = drive(1, 4)
    assert broken_in([*epochs, epochs[2]])[1] == {"gap": len(SIGNALS)}


def test_another_code_of_the_band_is_another_signal():
    epochs = drive(1, 4)
    for k in (2, 3):
        epochs[k] = changed(epochs[k], "signal", [1], lambda v: signal_number("2W"))
    tracker = CycleSlipDetector()
    arcs = [tracker.update(e) for e in epochs]
    assert arcs[1][1] != arcs[2][1] == arcs[3][1]
    assert all((arcs[0][i] == arcs[3][i]) == (i != 1) for i in range(len(SIGNALS)))


@pytest.mark.parametrize("rate_hz", [1, 10])
def test_lock_times_in_classes_break_nothing_while_they_grow(rate_hz):
    """MSM4 has the class only (DF402): 0, 32, 64, … ms, of half the true time at worst."""
    epochs = drive(rate_hz, 60, noisy=False)
    classes_s = np.array([0.0, *(0.032 * 2.0**n for n in range(15))])
    for first_s in (0.003, 0.04, 0.25, 0.7):
        reported = []
        for k, e in enumerate(epochs):
            lock_s = classes_s[classes_s <= first_s + k / rate_hz][-1]
            reported.append(replace(e, lock_time_s=np.full(len(SIGNALS), lock_s)))
        assert broken_in(reported)[:2] == ([], {})


def test_a_lock_begun_since_the_last_epoch_is_a_break_though_it_is_no_shorter_than_before():
    """A signal lost and found between each two epochs, one second apart, says 0.3 s each time."""
    epochs = [replace(e, lock_time_s=np.full(len(SIGNALS), 0.3)) for e in drive(1, 3)]
    assert broken_in(epochs)[1] == {"lock_time": 2 * len(SIGNALS)}
    locks, keys, here = LossOfLockDetector(), np.arange(len(SIGNALS)), np.ones(len(SIGNALS), np.bool_)
    for k, e in enumerate(epochs):  # the readers say the same
        lock_s = {"min_lock_s": e.lock_time_s, "max_lock_s": e.lock_time_s + 1e-3}
        assert locks.detect(e.time_ns, keys, has_phase=here, **lock_s).all() == (k > 0)


def test_numbers_of_arcs_are_never_used_twice():
    epochs = drive(1, 12)
    seen: set[int] = set()
    tracker = CycleSlipDetector()
    previous = np.zeros(len(SIGNALS), np.int64)
    rng = np.random.default_rng(3)
    for epoch in epochs:
        flagged = rng.random(len(SIGNALS)) < 0.3
        arcs = tracker.update(replace(epoch, loss_of_lock=flagged))
        fresh = arcs[arcs != previous]
        assert not seen & set(fresh.tolist())
        assert len(set(fresh.tolist())) == fresh.size
        seen |= set(fresh.tolist())
        previous = arcs


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, 1e300])
@pytest.mark.parametrize("name", ["carrier_phase_cycles", "doppler_hz", "lock_time_s"])
def test_no_value_is_too_odd(name, value):
    epochs = drive(1, 4)
    epochs[2] = changed(epochs[2], name, slice(None), lambda v: value)
    _, reasons, arcs = broken_in(epochs)
    assert set(reasons) <= set(REASONS)
    if name == "carrier_phase_cycles" and not np.isfinite(value):
        assert not arcs[2].any()
        np.testing.assert_array_equal(arcs[3], arcs[1])


def test_satellites_that_are_none_have_no_arc():
    epochs = drive(1, 2)
    odd = [0, -1, ord("R") * 256 + 1, ord("G") * 256 + 200]
    epochs = [changed(e, "satellite", [0, 1, 2, 3], lambda v: np.array(odd)) for e in epochs]
    assert not broken_in(epochs)[2][1][:4].any()
