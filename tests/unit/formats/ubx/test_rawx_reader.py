"""RXM-RAWX: encoded and recorded measurements are decoded as by pyubx2; inconsistent messages are refused."""

from __future__ import annotations

import io
import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader

from camber.formats.observations import satellite_name, satellite_number, signal_name, signal_number
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.ubx.rawx_reader import read_raw_measurements
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.signal_ids import GNSS_IDS, SIGNAL_IDS
from camber.formats.ubx.writer import format_raw_measurements, ubx_frame
from support.gnss_files import fed_in_pieces, recording
from support.random_observations import SECOND_NS, WEEK_NS, random_epoch

TIMES = st.integers(1044 * WEEK_NS, 4000 * WEEK_NS)
LETTERS = {0: "G", 2: "E", 3: "C", 5: "J", 6: "R"}
# All that is read under the name it was written by: data and pilot together are read as the pilot.
CARRIERS = {
    system: {name: 1575.42e6 for name in names if not name.endswith("X")}
    for system, names in SIGNAL_IDS.items()
    if system != "R"
}


def read(frame: bytes, *, locks: LossOfLockDetector | None = None, near_ns: int | None = None):
    return read_raw_measurements(frame[6:-2], locks or LossOfLockDetector(), near_ns)


def rawx(rows, *, tow_s=345_600.0, week=2300, status=1, version=1, count=None):
    """Encode rows of (gnss, sv, sig, pseudorange, phase, Doppler, lock ms, C/N0, status)."""
    payload = struct.pack(
        "<dHbBBB2x", tow_s, week, 18, len(rows) if count is None else count, status, version
    )
    for gnss, sv, sig, pseudorange, phase, doppler, lock, cn0, track in rows:
        payload += struct.pack(
            "<ddfBBBBHBBBBBx", pseudorange, phase, doppler, gnss, sv, sig, 0, lock, cn0, 5, 2, 3, track
        )
    return ubx_frame(0x02, 0x15, payload)


def row(gnss=0, sv=5, sig=0, pseudorange=2.1e7, phase=1.1e8, doppler=-900.5, lock=5000, cn0=45, track=7):
    return gnss, sv, sig, pseudorange, phase, doppler, lock, cn0, track


@given(st.integers(0, 2**32), TIMES, st.sampled_from([0.0, 0.15, 0.6, 1.0]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_written_values_are_read_back(seed, time_ns, missing):
    rng = np.random.default_rng(seed)
    sent = random_epoch(rng, time_ns, carriers=CARRIERS, missing=missing, satellites=6)
    sent = replace(sent, pseudorange_m=sent.pseudorange_m * float(rng.choice([1.0, -1.0, 1e-6])))
    frame = format_raw_measurements(sent)
    decoded, left_out = read(frame)
    assert_equal_to_pyubx2(frame, decoded)
    assert not any(row["freqId"] or row["subHalfCyc"] for row in measurements(frame)[0])
    epoch = decoded.epoch
    assert (left_out.other_systems, left_out.unknown_signals, left_out.repeated) == (0, 0, 0)
    assert not decoded.clock_reset
    assert read(rawx([row()], status=3))[0].clock_reset
    assert epoch.time_ns == time_ns
    np.testing.assert_array_equal(epoch.satellite, sent.satellite)
    np.testing.assert_array_equal(epoch.signal, sent.signal)
    np.testing.assert_array_equal(epoch.pseudorange_m, sent.pseudorange_m)
    # Half a cycle of geostationary satellites, taken off and added again.
    np.testing.assert_allclose(epoch.carrier_phase_cycles, sent.carrier_phase_cycles, rtol=1e-15)
    np.testing.assert_array_equal(epoch.doppler_hz, sent.doppler_hz.astype(np.float32))
    cn0 = np.rint(sent.cn0_dbhz)
    np.testing.assert_array_equal(epoch.cn0_dbhz, np.where(cn0 == 0.0, np.nan, cn0))
    lock_s = np.nan_to_num(sent.lock_time_s)
    assert (np.abs(epoch.lock_time_s - np.minimum(lock_s, 64.5)) < 1.001e-3).all()
    has_phase = ~np.isnan(sent.carrier_phase_cycles)
    np.testing.assert_array_equal(epoch.half_cycle, sent.half_cycle & has_phase)
    assert not epoch.loss_of_lock.any()


def test_every_signal_id_is_decoded_to_its_signal():
    for system, names in SIGNAL_IDS.items():
        for name, signal_id in names.items():
            decoded, _ = read(rawx([row(GNSS_IDS[system], 7, signal_id)]))
            read_name = signal_name(int(decoded.epoch.signal[0]))
            assert read_name == name or name.endswith("X"), (system, name)
            assert SIGNAL_IDS[system][read_name] == signal_id
            assert satellite_name(int(decoded.epoch.satellite[0])) == f"{system}07"


def test_d2_ids_are_decoded_to_the_same_signals():
    for d1, d2 in ((0, 1), (2, 3), (4, 10)):
        names = [
            signal_name(int(read(rawx([row(3, 3, signal_id)]))[0].epoch.signal[0])) for signal_id in (d1, d2)
        ]
        assert names[0] == names[1]


def test_half_a_cycle_is_added_to_geostationary_phases():
    for number, half in ((1, 0.5), (5, 0.5), (6, 0.0), (58, 0.0), (59, 0.5), (63, 0.5)):
        epoch = read(rawx([row(3, number, 0, phase=1000.25)]))[0].epoch
        assert epoch.carrier_phase_cycles.tolist() == [1000.25 + half]


def test_version_0_has_one_signal_per_system():
    decoded, _ = read(rawx([row(0, 5, 200), row(3, 6, 77), row(2, 7, 9)], version=0))
    assert [signal_name(number) for number in decoded.epoch.signal.tolist()] == ["1C", "2I", "1C"]


def test_omitted_measurements_are_counted():
    rows = [
        *(row(1, 130), row(7, 4), row(200, 1)),  # SBAS, NavIC, nobody
        *(
            row(0, 3, 1),
            row(0, 0),
            row(5, 11),
            row(0, 255),
            row(6, 255),
        ),  # no such signal, no such satellites
        *(row(0, 9, 0, 2.0e7), row(0, 9, 0, 2.5e7)),  # twice
    ]
    decoded, left_out = read(rawx(rows))
    assert (left_out.other_systems, left_out.unknown_signals, left_out.repeated) == (3, 5, 1)
    assert decoded.epoch.satellite.tolist() == [satellite_number("G09")]
    assert decoded.epoch.pseudorange_m.tolist() == [2.0e7]


@pytest.mark.parametrize(
    ("track", "pseudorange", "phase", "half"),
    [
        (0b0000, False, False, False), (0b0001, True, False, False), (0b0011, True, True, True),
        (0b0111, True, True, False), (0b1111, True, True, False), (0b0110, False, True, False),
        (0b0101, True, False, False),
    ],
)  # fmt: skip
def test_tracking_status_determines_valid_values(track, pseudorange, phase, half):
    epoch = read(rawx([row(track=track)]))[0].epoch
    assert math.isnan(epoch.pseudorange_m[0]) != pseudorange
    assert math.isnan(epoch.carrier_phase_cycles[0]) != phase
    assert bool(epoch.half_cycle[0]) == half


def test_nonfinite_values_are_nan():
    for bad in (math.nan, math.inf, -math.inf):
        epoch = read(rawx([row(pseudorange=bad, phase=bad, doppler=bad)]))[0].epoch
        assert np.isnan([epoch.pseudorange_m[0], epoch.carrier_phase_cycles[0], epoch.doppler_hz[0]]).all()


def lost(*epochs) -> list[bool]:
    """Whether the phase of each (s of week, lock ms, tracking status) has lost lock."""
    locks, decoded = LossOfLockDetector(), []
    for tow_s, lock, track in epochs:
        epoch = read(rawx([row(lock=lock, track=track)], tow_s=tow_s), locks=locks)[0].epoch
        decoded.append(bool(epoch.loss_of_lock[0]))
    return decoded


def test_loss_of_lock_follows_the_lock_time_and_the_half_cycle():
    assert lost((0, 500, 7), (1, 1500, 7), (2, 300, 7), (3, 1300, 7)) == [False, False, True, False]
    assert lost((0, 500, 7), (1, 1500, 15), (2, 2500, 15)) == [False, True, False]
    # The phase was away, and its lock began anew meanwhile.
    assert lost((0, 5000, 7), (1, 0, 1), (2, 700, 3)) == [False, False, True]
    # A lock time that does not grow any more says nothing of times before it.
    assert lost((0, 64500, 7), (60, 64500, 7), (200, 64500, 7)) == [False, False, True]


def test_week_roll_over_is_resolved_by_the_known_time():
    sent = rawx([row()], week=2300 - 1024)
    assert read(sent)[0].epoch.time_ns // WEEK_NS == 1276
    assert read(sent, near_ns=2290 * WEEK_NS)[0].epoch.time_ns == 2300 * WEEK_NS + 345_600 * SECOND_NS
    assert read(sent, near_ns=2310 * WEEK_NS)[0].epoch.time_ns // WEEK_NS == 2300


def test_times_are_rounded_to_ns():
    for of_week_ns in (0, 1, 604_799_999_999_999, 123_456_789_012_345, 99_999_999_999_999):
        epoch = read(rawx([row()], tow_s=of_week_ns / 1e9))[0].epoch
        assert epoch.time_ns == 2300 * WEEK_NS + of_week_ns


@pytest.mark.parametrize(
    "frame",
    [
        rawx([row()], count=2), rawx([row()], count=0), rawx([row()], version=2),
        rawx([row()], tow_s=604_800.0), rawx([row()], tow_s=-0.001), rawx([row()], tow_s=math.nan),
        rawx([row()], tow_s=math.inf), rawx([row()], week=0), rawx([row()], week=65535),
        ubx_frame(0x02, 0x15, b""), ubx_frame(0x02, 0x15, bytes(15)),
    ],
)  # fmt: skip
def test_inconsistent_messages_are_counted_and_never_raise(frame):
    decoder = UbxDecoder("port")
    assert decoder.feed(frame + frame) == []
    assert decoder.messages.malformed == 2


def test_epoch_without_measurements_is_returned():
    decoded, _ = read(rawx([]))
    assert decoded.epoch.satellite.shape == decoded.epoch.loss_of_lock.shape == (0,)


# ------------------------------------------------------------------------------------------------------- recordings


FIELDS = (
    *("prMes", "cpMes", "doMes", "gnssId", "svId", "sigId", "freqId", "locktime", "cno"),
    *("prValid", "cpValid", "halfCyc", "subHalfCyc"),
)


def measurements(frame: bytes):
    """The rows of supported systems by pyubx2, and how many others there are."""
    message = UBXReader.parse(frame)
    rows = [
        {name: getattr(message, f"{name}_{k:02d}") for name in FIELDS} for k in range(1, message.numMeas + 1)
    ]
    supported = [row for row in rows if row["gnssId"] in LETTERS]
    return supported, len(rows) - len(supported)


def assert_equal_to_pyubx2(frame: bytes, result: ReceiverEpoch) -> None:
    message, epoch = UBXReader.parse(frame), result.epoch
    assert epoch.time_ns == message.week * WEEK_NS + round(message.rcvTow * 1e9)
    assert result.clock_reset == message.clkReset
    rows, _ = measurements(frame)
    assert len(rows) == epoch.satellite.size
    for place, row in enumerate(rows):
        letter, number = LETTERS[row["gnssId"]], row["svId"]
        assert satellite_name(int(epoch.satellite[place])) == f"{letter}{number:02d}"
        half = 0.5 if letter == "C" and (number <= 5 or number >= 59) else 0.0
        pseudorange_m, phase = epoch.pseudorange_m[place], epoch.carrier_phase_cycles[place]
        assert pseudorange_m == row["prMes"] if row["prValid"] else math.isnan(pseudorange_m)
        assert phase == row["cpMes"] + half if row["cpValid"] else math.isnan(phase)
        assert np.nan_to_num(epoch.doppler_hz[place]) == row["doMes"]
        assert np.nan_to_num(epoch.cn0_dbhz[place]) == row["cno"]
        assert epoch.lock_time_s[place] == row["locktime"] / 1000
        assert epoch.half_cycle[place] == (row["cpValid"] and not row["halfCyc"])


def test_recorded_measurements_equal_those_of_pyubx2():
    data = recording("receiver-logs/ubx-pygpsdata-RXMRAWX.log").read_bytes()
    decoder = UbxDecoder("port")
    epochs = fed_in_pieces(decoder, data, range(777, len(data), 777))
    frames = [frame for frame, _ in UBXReader(io.BytesIO(data))]
    assert len(frames) == 14
    for result, frame in zip(epochs, frames, strict=True):
        assert_equal_to_pyubx2(frame, result)
    assert np.unique(np.diff([result.epoch.time_ns for result in epochs])).tolist() == [SECOND_NS]
    # Nothing breaks in these seconds, as the phases themselves show; the half cycle of one is resolved.
    lost = [satellite_name(n) for r in epochs for n in r.epoch.satellite[r.epoch.loss_of_lock].tolist()]
    assert lost == ["R19"]
    rows, others = zip(*map(measurements, frames), strict=True)
    assert decoder.messages.other_systems == sum(others) == 0
    assert sum(row["subHalfCyc"] for of_frame in rows for row in of_frame) > 50
    assert decoder.bytes_skipped == decoder.messages.unknown_signals == 0


def test_l2c_ids_of_gps_and_qzss_differ():
    # Two that are easily mixed up: L2 CL and CM have other numbers at QZSS than at GPS.
    assert (SIGNAL_IDS["G"]["2L"], SIGNAL_IDS["J"]["2L"]) == (3, 5)
    assert read(rawx([row(5, 2, 4)]))[0].epoch.signal[0] == signal_number("2S")
