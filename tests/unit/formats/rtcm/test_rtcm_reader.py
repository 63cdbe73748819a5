"""RTCM decoder: encoded content is decoded, and malformed input is counted and never raises."""

import math
from dataclasses import fields, replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.broadcast.bit_fields import bits_to_bytes, pack_bits
from camber.formats.broadcast.ephemeris_fields import integers_from_ephemeris
from camber.formats.observations import Ephemeris, ObservationEpoch, signal_name
from camber.formats.rtcm.msm_writer import lock_indicator
from camber.formats.rtcm.reader import BaseStationEpoch, RtcmDecoder
from camber.formats.rtcm.writer import (
    format_ephemeris,
    format_observations,
    format_reference_station,
    rtcm_frame,
)
from support.gnss_files import fed_in_pieces
from support.random_observations import (
    COMMON,
    LIGHT_M_S,
    SECOND_NS,
    WEEK_NS,
    random_ephemeris,
    random_epoch,
    random_toe_ns,
)

SEEDS = st.integers(0, 2**32)
NOW_NS = 2300 * WEEK_NS + 100_000 * SECOND_NS


def read_all(data: bytes, near_ns: int):
    decoder = RtcmDecoder(near_ns)
    return fed_in_pieces(decoder, data), decoder


def counters(decoder):
    names = [name for name in vars(decoder) if not name.startswith("_")]
    return {name: getattr(decoder, name) for name in (*names, "bytes_skipped", "failed_checks")}


def by_signal(epoch: ObservationEpoch):
    columns = [f.name for f in fields(epoch) if f.name not in ("time_ns", "satellite", "signal")]
    return {
        (int(epoch.satellite[k]), int(epoch.signal[k])): [getattr(epoch, name)[k] for name in columns]
        for k in range(epoch.satellite.size)
    }


@given(
    SEEDS,
    st.integers(-3 * 86_400, 3 * 86_400),
    st.sampled_from([0, 1, 13_999, 14_000, 604_799_999, 86_399_999]),
    st.sampled_from([12, 30, 63]),
    st.sampled_from([0.0, 0.15, 0.6, 1.0]),
)
@settings(derandomize=True, max_examples=100, deadline=None)
def test_decoded_observations_are_within_the_resolution(seed, away_s, of_week_ms, satellites, missing):
    time_ns = 2300 * WEEK_NS + of_week_ms * 1_000_000
    epoch = random_epoch(np.random.default_rng(seed), time_ns, satellites=satellites, missing=missing)
    data = b"".join(format_observations(epoch, station_id=77))
    results, decoder = read_all(data, time_ns + away_s * SECOND_NS)
    assert not any(counters(decoder).values())
    if not epoch.satellite.size:
        assert results == []
        return
    (decoded,) = results
    assert isinstance(decoded, BaseStationEpoch)
    assert (decoded.station_id, decoded.complete, decoded.epoch.time_ns) == (77, True, time_ns)
    theirs, ours = by_signal(epoch), by_signal(decoded.epoch)
    assert ours.keys() == theirs.keys()
    for (satellite, signal), (code, phase, doppler, cn0, lock_s, _, half) in theirs.items():
        carrier = COMMON[chr(satellite >> 8)][signal_name(signal)]
        per_ms = LIGHT_M_S * 1e-3
        row = ours[satellite, signal]
        per_m = carrier / LIGHT_M_S
        steps = (per_ms * 2.0**-29, per_ms * 2.0**-31 * per_m, 1e-4 * per_m, 2.0**-4)
        for got, given_, step in zip(row, (code, phase, doppler, cn0), steps, strict=False):
            assert math.isnan(got) == math.isnan(given_)
            assert math.isnan(got) or abs(got - given_) <= 0.5 * step + 1e-6
        lock_s = 0.0 if math.isnan(lock_s) else lock_s
        assert row[4] <= lock_s + 1e-8
        assert lock_indicator(np.array([row[4]])) == lock_indicator(np.array([lock_s]))
        assert row[5:] == [False, half]


NAMES = st.sampled_from(["G01", "G63", "J01", "J10", "E01", "E50", "C01", "C30", "C63"])


@given(SEEDS, NAMES, st.integers(1400, 3900), st.integers(-60, 60))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_decoded_ephemerides_have_the_encoded_integers(seed, name, week, hours):
    rng = np.random.default_rng(seed)
    toe_ns = random_toe_ns(rng, name, week)
    ephemeris = random_ephemeris(rng, name, toe_ns)
    near_ns = toe_ns + hours * 3600 * SECOND_NS
    results, decoder = read_all(b"".join(format_ephemeris(ephemeris)), near_ns)
    assert not any(counters(decoder).values())
    sent = integers_from_ephemeris(ephemeris)
    for decoded in results:
        assert isinstance(decoded, Ephemeris)
        times_ns = (decoded.toe_ns, decoded.toc_ns, decoded.transmission_ns)
        assert times_ns == (toe_ns, ephemeris.toc_ns, near_ns)
        assert decoded.satellite == ephemeris.satellite
        if name[0] != "E":
            assert integers_from_ephemeris(decoded) == sent
    if name[0] == "E":
        fnav, inav = results
        assert (fnav.other["data_sources"], inav.other["data_sources"]) == (258.0, 517.0)
        absent = {"e5a_health": 0, "e5a_invalid": 0}
        assert integers_from_ephemeris(inav) | absent == sent | absent
        assert "bgd_e5b_s" not in fnav.other
        assert fnav.health == ephemeris.health & 0b111000


def test_truncated_messages_are_counted():
    station = format_reference_station((-3.8e6, 3.5e6, 3.6e6), station_id=5)
    ephemerides = format_ephemeris(random_ephemeris(np.random.default_rng(1), "E12", 2300 * WEEK_NS))
    for frame in (station, *ephemerides):
        _, decoder = read_all(rtcm_frame(frame[3:-4]), NOW_NS)
        assert (decoder.malformed, decoder.bytes_skipped) == (1, 0)


def test_epoch_is_returned_with_its_last_message_or_the_next_epoch():
    rng = np.random.default_rng(1)
    one = random_epoch(rng, NOW_NS, satellites=10, missing=0.0)
    frames = format_observations(one, station_id=1)
    assert len(frames) > 2
    decoder = RtcmDecoder(NOW_NS)
    assert [len(decoder.feed(frame)) for frame in frames] == [0] * (len(frames) - 1) + [1]
    # The last one lost: given, as not complete, when the next epoch begins.
    decoder = RtcmDecoder(NOW_NS)
    for frame in frames[:-1]:
        assert decoder.feed(frame) == []
    later = format_observations(random_epoch(rng, NOW_NS + SECOND_NS, satellites=10), station_id=1)
    (first, *_) = decoder.feed(later[0])
    assert not first.complete
    assert first.epoch.time_ns == NOW_NS
    assert decoder.incomplete == 1
    # The last message of the epoch is of a system that is not read.
    decoder = RtcmDecoder(NOW_NS)
    for frame in format_observations(one, station_id=1, more_follow=True):
        assert decoder.feed(frame) == []
    sbas = rtcm_frame(bits_to_bytes(*pack_bits([(1107, 12), (1, 12), (0, 30), (0, 1), (0, 18 + 64 + 32)])))
    (given_,) = decoder.feed(sbas)
    assert given_.complete
    assert decoder.not_read == 1


def test_lock_shorter_than_the_time_since_the_last_epoch_is_a_loss():
    decoder = RtcmDecoder(NOW_NS)
    rng = np.random.default_rng(2)
    base = random_epoch(rng, NOW_NS, satellites=6, missing=0.0)
    n = base.satellite.size
    for k, lock_s, lost in (
        (0, 5.0, False),
        (1, 6.0, False),
        (2, 0.1, True),
        (3, 1.1, False),
        (10, 3.0, True),
    ):
        epoch = replace(base, time_ns=NOW_NS + k * SECOND_NS, lock_time_s=np.full(n, lock_s))
        (decoded,) = decoder.feed(b"".join(format_observations(epoch, station_id=1)))
        assert decoded.epoch.loss_of_lock.tolist() == [lost] * n


def test_times_follow_the_stream_over_weeks():
    decoder = RtcmDecoder(NOW_NS)
    for k in range(12):
        time_ns = NOW_NS + k * 3 * 86_400 * SECOND_NS
        epoch = random_epoch(np.random.default_rng(k), time_ns, satellites=5, missing=0.0)
        for decoded in decoder.feed(b"".join(format_observations(epoch, station_id=1))):
            assert decoded.epoch.time_ns == time_ns


def test_endless_epochs_are_returned_in_parts():
    epoch = random_epoch(np.random.default_rng(4), NOW_NS, satellites=4, missing=0.0)
    frame = format_observations(epoch, station_id=1, more_follow=True)[0]
    decoder = RtcmDecoder(NOW_NS)
    results = decoder.feed(frame * 100)
    assert [result.complete for result in results] == [False] * 3
    assert decoder.incomplete == 3


def test_number_of_stations_is_bounded():
    epoch = random_epoch(np.random.default_rng(5), NOW_NS, satellites=4, missing=0.0)
    decoder, begun = RtcmDecoder(NOW_NS), 0
    for station in range(100):
        results = decoder.feed(format_observations(epoch, station_id=station, more_follow=True)[0])
        begun += 1 - len(results)
        # The one that began first is given when there is no more room.
        assert [result.station_id for result in results] == ([station - 16] if station >= 16 else [])
    assert begun == 16
    assert len(decoder.finish()) == 16
    assert decoder.stations == 16
