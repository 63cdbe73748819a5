"""UBX streams: positions by epoch, integrity reports, and the values of pyubx2 for recordings."""

from __future__ import annotations

import io
import math
import struct
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ubx.nav_reader import ReceiverBaseline
from camber.formats.ubx.nav_writer import format_high_precision_position, format_position_velocity_time
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.writer import ubx_frame
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.gnss import ReceiverIntegrity
from support.gnss_files import fed_in_pieces, recording
from support.random_observations import SECOND_NS, WEEK_NS
from support.random_solutions import VELOCITIES, qualities_without, solutions

TOW_MS = 345_600_000
START_NS = 2300 * WEEK_NS + TOW_MS * 1_000_000
SOLUTION = ReceiverSolution(
    time_ns=START_NS,
    latitude_rad=0.6,
    longitude_rad=2.4,
    height_m=50.0,
    quality=SolutionQuality.FIX,
    satellites=20,
    covariance_enu_m2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.02),
    age_s=1.5,
    ratio=None,
    velocity_enu_m_s=(1.0, 2.0, 0.5),
)


def at(seconds: float) -> ReceiverSolution:
    return replace(SOLUTION, time_ns=START_NS + round(seconds * SECOND_NS))


def pvt(solution: ReceiverSolution = SOLUTION, **changes: int) -> bytes:
    """NAV-PVT; changes by byte offset: `b20=3`."""
    return changed(format_position_velocity_time(solution, geoid_separation_m=30.0), **changes)


def changed(frame: bytes, **changes: int) -> bytes:
    payload = bytearray(frame[6:-2])
    for place, value in changes.items():
        payload[int(place[1:])] = value
    return ubx_frame(frame[2], frame[3], bytes(payload))


def hp(solution: ReceiverSolution = SOLUTION) -> bytes:
    return format_high_precision_position(solution, geoid_separation_m=30.0)


def eoe(of_week_ms: int = TOW_MS) -> bytes:
    return ubx_frame(0x01, 0x61, struct.pack("<I", of_week_ms))


NED = (4.0, 0.5, -0.25, 9.0, 0.75, 16.0)


def cov(position=NED, velocity=NED, valid=(1, 1), of_week_ms=TOW_MS, version=0) -> bytes:
    return ubx_frame(0x01, 0x36, struct.pack("<IBBB9x12f", of_week_ms, version, *valid, *position, *velocity))


def pl(valid=1, frame=1, levels=(3000, 4000, 7000), coefficient=5, exponent=-3, of_week_ms=TOW_MS) -> bytes:
    head = struct.pack("<BBbBBBBB4xI", 1, coefficient, exponent & -1, valid, frame, 0, 0, 0, of_week_ms)
    return ubx_frame(0x01, 0x62, head + struct.pack("<3I", *levels) + bytes(24))


def relposned(flags: int, version: int = 1, of_week_ms: int = TOW_MS) -> bytes:
    if version == 0:
        body = struct.pack(
            "<BxHI3i3bx3II", 0, 7, of_week_ms, 100, -250, 30, 12, -34, 56, 101, 202, 303, flags
        )
    else:
        body = struct.pack(
            "<BxHI5i4x4b", 1, 7, of_week_ms, 100, -250, 30, 269, 29_180_141, 12, -34, 56, 1
        ) + struct.pack("<5I4xI", 101, 202, 303, 40, 150_000, flags)
    return ubx_frame(0x01, 0x3C, body)


def security(jamming: int, spoofing: int, version: int = 1, *, enabled: int = 1) -> bytes:
    if version == 1:
        payload = bytes([1, 0, 0, 0, jamming << 1 | enabled, 0, 0, 0, spoofing << 1 | enabled, 0, 0, 0])
    else:
        payload = bytes([2, spoofing << 4 | enabled << 3 | jamming << 1 | enabled, 0, 1, 0, 0, 0, 0])
    return ubx_frame(0x27, 0x09, payload)


def front_ends(*states: int) -> bytes:
    blocks = b"".join(bytes([k, state, *bytes(22)]) for k, state in enumerate(states))
    return ubx_frame(0x0A, 0x38, bytes([0, len(states), 0, 0]) + blocks)


def run(*frames: bytes, near_ns: int | None = None, finish: bool = True):
    decoder = UbxDecoder("port", near_ns)
    results = [result for frame in frames for result in decoder.feed(frame)]
    return results + (decoder.finish() if finish else []), decoder.messages


def only(results, kind):
    decoded = [result for result in results if isinstance(result, kind)]
    assert len(decoded) == 1
    return decoded[0]


# --------------------------------------------------------------------------------------------------------- positions


WRITTEN = solutions(
    quality=qualities_without(SolutionQuality.SBAS, SolutionQuality.PPP),
    satellites=st.integers(0, 60),
    velocity_enu_m_s=VELOCITIES,
)


@given(WRITTEN, st.booleans())
@settings(derandomize=True, max_examples=200, deadline=None)
def test_written_values_are_read_back(solution, precise):
    frames = [pvt(solution), hp(solution)] if precise else [pvt(solution)]
    results, messages = run(*frames)
    decoded = only(results, ReceiverSolution)
    step_rad, step_m = (0.51e-9, 0.51e-4) if precise else (0.51e-7, 0.51e-3)
    # To the nanosecond: iTOW says whole ms, NAV-PVT's fraction of the second the rest.
    assert decoded.time_ns == solution.time_ns
    assert (decoded.quality, decoded.satellites) == (solution.quality, solution.satellites)
    assert abs(decoded.latitude_rad - solution.latitude_rad) <= math.radians(step_rad)
    assert abs(decoded.longitude_rad - solution.longitude_rad) <= math.radians(step_rad)
    assert abs(decoded.height_m - solution.height_m) <= step_m
    assert decoded.velocity_enu_m_s == pytest.approx(solution.velocity_enu_m_s, abs=0.51e-3)
    assert decoded.velocity_covariance_enu_m2_s2 is None
    if solution.covariance_enu_m2 is None:
        assert decoded.covariance_enu_m2 is None
    else:
        ee, _, _, nn, _, uu = solution.covariance_enu_m2
        each, en, eu, again, nu, up = decoded.covariance_enu_m2
        assert (en, eu, nu, each) == (0.0, 0.0, 0.0, again)
        assert math.sqrt(2 * each) == pytest.approx(math.sqrt(ee + nn), abs=step_m)
        assert math.sqrt(up) == pytest.approx(math.sqrt(uu), abs=step_m)
    if solution.age_s is None:
        assert decoded.age_s is None
    else:
        assert decoded.age_s == 120.0 if solution.age_s >= 90.0 else decoded.age_s >= solution.age_s
    assert messages.malformed == 0


def test_epoch_is_returned_with_its_end_or_the_next_epoch():
    assert only(run(pvt(), eoe(), finish=False)[0], ReceiverSolution).time_ns == START_NS
    assert run(pvt(), hp(), cov(), finish=False)[0] == []
    results, messages = run(pvt(), pvt(at(0.1)), finish=False)
    assert only(results, ReceiverSolution).time_ns == START_NS
    # What comes after the end is lost, and counted.
    results, messages = run(pvt(), eoe(), hp(), cov(), eoe(), pvt(at(1.0)), eoe(TOW_MS + 1000), finish=False)
    assert [r.time_ns for r in results if isinstance(r, ReceiverSolution)] == [START_NS, START_NS + SECOND_NS]
    assert messages.late == 2


def test_order_within_an_epoch_does_not_matter():
    expected = run(pvt(), hp(), cov(), pl(), eoe())[0]
    for frames in ((cov(), pl(), hp(), pvt()), (hp(), pvt(), pl(), cov())):
        assert run(*frames, eoe())[0] == expected


def test_an_end_without_an_epoch_yields_no_result():
    results, messages = run(eoe(), eoe(), near_ns=START_NS)
    assert results == []
    assert (messages.without_time, messages.epochs_without_position) == (0, 0)


@pytest.mark.parametrize(
    ("fix_type", "flags", "quality"),
    [
        (3, 0b0000_0001, SolutionQuality.SINGLE),
        (3, 0b0000_0011, SolutionQuality.DGPS),
        (3, 0b0100_0011, SolutionQuality.FLOAT),
        (3, 0b1000_0011, SolutionQuality.FIX),
        (4, 0b1000_0011, SolutionQuality.FIX),
        (1, 0b0000_0001, SolutionQuality.DEAD_RECKONING),
        (1, 0b1000_0011, SolutionQuality.DEAD_RECKONING),
        (3, 0b1000_0010, None),  # not within the receiver's limits
        (2, 0b0000_0001, None),  # a height that was assumed
        (0, 0b0000_0001, None),
        (5, 0b0000_0001, None),
        (6, 0b0000_0001, None),
    ],
)
def test_quality_follows_fix_type_and_flags(fix_type, flags, quality):
    results, messages = run(pvt(b20=fix_type, b21=flags))
    decoded = [result.quality for result in results if isinstance(result, ReceiverSolution)]
    assert decoded == ([] if quality is None else [quality])
    assert messages.epochs_without_position == (quality is None)


def test_invalid_position_is_not_returned():
    assert run(pvt(b78=1))[1].epochs_without_position == 1
    results, _ = run(pvt(), changed(hp(at(0.0)), b3=1))
    # Not the precise one: latitude to 1e-7 degrees.
    assert math.degrees(only(results, ReceiverSolution).latitude_rad) * 1e7 == pytest.approx(
        round(math.degrees(0.6) * 1e7), abs=1e-4
    )


def test_high_precision_position_without_pvt_is_not_returned():
    results, messages = run(hp(), near_ns=START_NS)
    assert results == []
    assert messages.epochs_without_position == 1


def test_covariance_is_rotated_from_north_east_down():
    decoded = only(run(pvt(), cov())[0], ReceiverSolution)
    enu = (9.0, 0.5, -0.75, 4.0, 0.25, 16.0)
    assert decoded.covariance_enu_m2 == enu
    assert decoded.velocity_covariance_enu_m2_s2 == enu
    decoded = only(run(pvt(), cov(valid=(0, 1)))[0], ReceiverSolution)
    assert decoded.covariance_enu_m2 == pytest.approx((0.01, 0.0, 0.0, 0.01, 0.0, 0.02), rel=1e-2)
    assert decoded.velocity_covariance_enu_m2_s2 == enu


@pytest.mark.parametrize(
    "values",
    [
        (1.0, 2.0, 0.0, 1.0, 0.0, 1.0),
        (-1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
        (math.nan, 0.0, 0.0, 1.0, 0.0, 1.0),
        (1.0, 0.0, 0.0, 1.0, 0.0, math.inf),
    ],
)
def test_invalid_covariance_is_refused(values):
    results, messages = run(pvt(), cov(position=values))
    assert only(results, ReceiverSolution).covariance_enu_m2[2:3] == (0.0,)
    assert messages.malformed == 1


def test_zero_covariance_is_unknown():
    results, messages = run(changed(pvt(), **{f"b{k}": 0 for k in range(40, 48)}), cov(position=(0.0,) * 6))
    assert only(results, ReceiverSolution).covariance_enu_m2 is None
    assert messages.malformed == 0


# -------------------------------------------------------------------------------------------------------------- time


def test_week_follows_the_date_or_the_known_time():
    assert only(run(pvt())[0], ReceiverSolution).time_ns == START_NS
    dateless = pvt(b11=0)
    results, messages = run(dateless)
    assert [r for r in results if isinstance(r, ReceiverSolution)] == []
    assert messages.without_time == 1
    for days in (-3, 0, 3):
        near_ns = START_NS + days * 86_400 * SECOND_NS
        assert only(run(dateless, near_ns=near_ns)[0], ReceiverSolution).time_ns == START_NS
    # The epoch before settles it, also over the end of a week.
    last = replace(SOLUTION, time_ns=2301 * WEEK_NS - SECOND_NS)
    first = changed(pvt(replace(SOLUTION, time_ns=2301 * WEEK_NS)), b11=0)
    decoded = [r.time_ns for r in run(pvt(last), first)[0] if isinstance(r, ReceiverSolution)]
    assert decoded == [2301 * WEEK_NS - SECOND_NS, 2301 * WEEK_NS]


def test_rolled_over_date_is_resolved_by_the_known_time():
    early = replace(SOLUTION, time_ns=START_NS - 1024 * WEEK_NS)
    assert only(run(pvt(early), near_ns=START_NS)[0], ReceiverSolution).time_ns == START_NS


def test_wrong_time_does_not_last():
    lies = [START_NS + week * WEEK_NS - k * SECOND_NS for k, week in enumerate((500, 1000, 1023, 1400), 1)]
    for near_ns in (None, START_NS):
        results, _ = run(*(pvt(replace(SOLUTION, time_ns=lie)) for lie in lies), pvt(), near_ns=near_ns)
        assert [r.time_ns for r in results if isinstance(r, ReceiverSolution)][-1] == START_NS
        empty = [ubx_frame(0x02, 0x15, raw_header(time_ns)) for time_ns in (*lies, START_NS)]
        results, _ = run(*empty, near_ns=near_ns)
        assert results[-1].epoch.time_ns == START_NS


def raw_header(time_ns: int) -> bytes:
    return struct.pack("<dHbBBB2x", time_ns % WEEK_NS / 1e9, time_ns // WEEK_NS, 18, 0, 1, 1)


def test_leap_seconds_are_handled_in_the_date_only():
    for utc in (CalendarTime(2016, 12, 31, 23, 59, 60), CalendarTime(2017, 1, 1, 0, 0, 0)):
        time_ns = gps_ns_from_utc(utc)
        assert only(run(pvt(replace(SOLUTION, time_ns=time_ns)))[0], ReceiverSolution).time_ns == time_ns
    # A receiver that does not know of the last ones yet: its second is wrong, its time of week is not.
    assert only(run(pvt(b10=30))[0], ReceiverSolution).time_ns == START_NS


def test_times_of_receivers_without_a_fix_are_refused():
    assert run(pvt(replace(SOLUTION, time_ns=EARLIEST_NS - WEEK_NS)))[1].malformed == 1
    assert run(pvt(replace(SOLUTION, time_ns=LATEST_NS + WEEK_NS)))[1].malformed == 1
    assert run(pvt(b6=13))[1].malformed == 1
    assert run(cov(of_week_ms=604_800_000), near_ns=START_NS)[1].malformed == 1


# ---------------------------------------------------------------------------------------------------------- baseline


@pytest.mark.parametrize("version", [0, 1])
def test_baseline_is_in_metres_east_north_up(version):
    flags = 0b1_0011_0111 if version else 0b1_0111
    decoded = only(run(pvt(), relposned(flags, version), eoe())[0], ReceiverBaseline)
    assert decoded.time_ns == START_NS
    assert decoded.baseline_enu_m == (-2.5034, 1.0012, -0.3056)
    assert decoded.sigma_enu_m == (0.0202, 0.0101, 0.0303)
    assert decoded.quality is SolutionQuality.FIX
    assert (decoded.station_id, decoded.moving_base) == (7, bool(version))
    if version:
        assert decoded.heading_rad == math.radians(291.80141)
        assert decoded.heading_sigma_rad == math.radians(1.5)
    else:
        assert (decoded.heading_rad, decoded.heading_sigma_rad) == (None, None)


def test_invalid_baseline_is_not_returned():
    for flags in (0b1_0000, 0b1_0001, 0b1_0100):
        assert run(relposned(flags), near_ns=START_NS)[0] == []
    decoded = only(run(relposned(0b10_0000_1101), near_ns=START_NS)[0], ReceiverBaseline)
    assert (decoded.baseline_enu_m, decoded.sigma_enu_m) == (None, None)
    assert decoded.quality is SolutionQuality.FLOAT


# --------------------------------------------------------------------------------------------------------- integrity


def last_report(*frames: bytes) -> ReceiverIntegrity:
    results, messages = run(*frames, near_ns=START_NS)
    assert messages.malformed == 0
    return [result for result in results if isinstance(result, ReceiverIntegrity)][-1]


def test_protection_levels_are_reported_with_their_risk():
    decoded = last_report(pvt(), pl(), eoe())
    assert decoded.horizontal_protection_level_m == 5.0
    assert decoded.vertical_protection_level_m == 7.0
    assert decoded.integrity_risk == pytest.approx(5e-5)
    assert decoded.fix_within_masks == "yes"
    assert last_report(pl(frame=3), eoe()).horizontal_protection_level_m == 4.0
    for invalid in (pl(valid=0), pl(frame=0), pl(frame=4)):
        decoded = last_report(pl(), eoe(), invalid_at(invalid, TOW_MS + 1000), eoe(TOW_MS + 1000))
        assert decoded.time_ns == START_NS + SECOND_NS
        assert decoded.horizontal_protection_level_m is decoded.vertical_protection_level_m is None
        assert decoded.integrity_risk is None


def invalid_at(frame: bytes, of_week_ms: int) -> bytes:
    return changed(frame, **{f"b{12 + k}": of_week_ms >> 8 * k & 255 for k in range(4)})


@pytest.mark.parametrize("version", [1, 2])
def test_jamming_and_spoofing_states_are_reported(version):
    for number, jamming in enumerate(("unknown", "none", "warning", "critical")):
        for other, spoofing in enumerate(("unknown", "none", "indicated", "affirmed", "unknown")):
            decoded = last_report(security(number, other, version))
            assert (decoded.jamming, decoded.spoofing) == (jamming, spoofing)
            decoded = last_report(security(number, other, version, enabled=0))
            assert (decoded.jamming, decoded.spoofing) == ("unknown", "unknown")


@pytest.mark.parametrize(
    ("states", "jamming"),
    [
        ((1, 1), "none"), ((1, 0), "unknown"), ((0, 2), "warning"), ((1, 3), "critical"),
        ((0, 0), "unknown"), ((), "unknown"),
    ],
)  # fmt: skip
def test_worst_front_end_counts_and_an_unknown_one_excludes_none(states, jamming):
    assert last_report(front_ends(*states)).jamming == jamming


def test_worse_of_two_jamming_reports_counts():
    assert last_report(security(1, 1), front_ends(3, 1)).jamming == "critical"
    assert last_report(front_ends(0, 0), security(1, 1)).jamming == "none"


def test_reports_are_valid_for_two_seconds():
    def jamming(seconds: float) -> str:
        return last_report(
            pvt(), security(2, 1), eoe(), pvt(at(seconds)), eoe(TOW_MS + round(seconds * 1e3))
        ).jamming

    assert [jamming(1.0), jamming(2.0), jamming(2.1)] == ["warning", "warning", "unknown"]


def test_one_report_per_epoch():
    results, _ = run(pvt(), pl(), security(1, 1), front_ends(1), eoe())
    decoded = only(results, ReceiverIntegrity)
    assert (decoded.time_ns, decoded.jamming, decoded.vertical_protection_level_m) == (START_NS, "none", 7.0)


def test_masks_and_authentication_are_reported():
    assert last_report(pvt(b21=0)).fix_within_masks == "no"
    assert last_report(pvt()).authenticated == "unknown"
    assert last_report(pvt(b79=1 << 6)).authenticated == "yes"


# ---------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    "frame",
    [
        *(
            ubx_frame(0x01, kind, bytes(size))
            for kind in (0x07, 0x14, 0x36, 0x3C, 0x62)
            for size in (0, 3, 30)
        ),
        *(ubx_frame(0x27, 0x09, bytes([version, *bytes(20)])) for version in (0, 3)),
        *(ubx_frame(0x27, 0x09, bytes([version])) for version in (1, 2)),
        *(ubx_frame(0x0A, 0x38, payload) for payload in (b"", bytes([0, 2, 0, 0]), bytes([1, 0, 0, 0]))),
        *(ubx_frame(0x02, 0x13, payload) for payload in (b"", bytes(7), bytes(9))),
        cov(version=1),
    ],
)
def test_messages_of_wrong_length_or_version_are_counted(frame):
    results, messages = run(frame, near_ns=START_NS)
    assert results == []
    assert messages.malformed == 1


def test_impossible_position_is_refused():
    beyond = format_position_velocity_time(SOLUTION, geoid_separation_m=0.0)
    for place, value in ((28, 910_000_000), (24, 1_810_000_000), (32, 200_000_000), (32, -30_000_000)):
        bits_to_bytes = value.to_bytes(4, "little", signed=True)
        frame = changed(beyond, **{f"b{place + k}": byte for k, byte in enumerate(bits_to_bytes)})
        results, messages = run(frame, near_ns=START_NS)
        assert [r for r in results if isinstance(r, ReceiverSolution)] == []
        assert messages.malformed == 1


# ------------------------------------------------------------------------------------------------------- recordings


RECORDINGS = (
    *("ubx-pygpsdata-NAV.log", "ubx-pygpsdata-NAV-ZED-X20P.log", "ubx-pygpsdata-MIXED.log"),
    *("ubx-pygpsdata-BADCK2.log", "rtcm-pygpsdata-RTCM3.log"),
)


@pytest.mark.parametrize("name", RECORDINGS)
def test_recorded_positions_equal_those_of_pyubx2(name):
    data = recording(f"receiver-logs/{name}").read_bytes()
    decoder = UbxDecoder(name, None)
    results = fed_in_pieces(decoder, data, range(333, len(data), 333))
    solutions = [result for result in results if isinstance(result, ReceiverSolution)]
    reported: dict[int, dict[str, object]] = {}
    for _, message in UBXReader(io.BytesIO(data), protfilter=2, quitonerror=0):
        if message is not None and message.identity in ("NAV-PVT", "NAV-HPPOSLLH", "NAV-COV", "NAV-PL"):
            of_week_ms = int.from_bytes(
                message.payload[12:16]
                if message.identity == "NAV-PL"
                else message.payload[4 if message.identity == "NAV-HPPOSLLH" else 0 :][:4],
                "little",
            )
            reported.setdefault(of_week_ms, {})[message.identity] = message
    reported = {key: messages for key, messages in reported.items() if "NAV-PVT" in messages}
    good = [messages for messages in reported.values() if messages["NAV-PVT"].fixType == 3]
    assert len(solutions) == len(good)
    assert decoder.messages.epochs_without_position == len(reported) - len(good)
    qualities = {(0, 0): SolutionQuality.SINGLE, (0, 1): SolutionQuality.DGPS, (2, 1): SolutionQuality.FIX}
    for decoded, messages in zip(solutions, good, strict=True):
        position = messages["NAV-PVT"]
        time = CalendarTime(
            *(position.year, position.month, position.day, position.hour, position.min, position.second)
        )
        assert decoded.time_ns == gps_ns_from_utc(time) + position.nano
        assert decoded.quality == qualities[position.carrSoln, position.diffSoln]
        assert decoded.satellites == position.numSV
        assert decoded.velocity_enu_m_s == (position.velE / 1e3, position.velN / 1e3, -position.velD / 1e3)
        place = messages.get("NAV-HPPOSLLH", position)
        assert decoded.latitude_rad == math.radians(place.lat)
        assert decoded.longitude_rad == math.radians(place.lon)
        assert decoded.height_m == place.height / 1e3
        if "NAV-COV" in messages:
            cov = messages["NAV-COV"]
            covariances = decoded.covariance_enu_m2, decoded.velocity_covariance_enu_m2_s2
            for what, covariance in zip(("pos", "vel"), covariances, strict=True):
                ee, ne, ed, nn, nd, dd = (
                    getattr(cov, f"{what}Cov{k}") for k in ("EE", "NE", "ED", "NN", "ND", "DD")
                )
                assert covariance == (ee, ne, -ed, nn, -nd, dd)
            # What is taken where there is no such message: hAcc is the root of the sum, vAcc that of the third.
            assert math.sqrt(cov.posCovEE + cov.posCovNN) == pytest.approx(position.hAcc / 1e3, abs=0.51e-3)
            assert math.sqrt(cov.posCovDD) == pytest.approx(position.vAcc / 1e3, abs=0.51e-3)
        else:
            each = 0.5 * (place.hAcc / 1e3) * (place.hAcc / 1e3)
            expected = (each, 0.0, 0.0, each, 0.0, (place.vAcc / 1e3) * (place.vAcc / 1e3))
            assert decoded.covariance_enu_m2 == pytest.approx(expected, rel=1e-15)
    statements = [result for result in results if isinstance(result, ReceiverIntegrity)]
    # The one receiver with NAV-PL says that its levels are not valid.
    assert all(gbs_report.horizontal_protection_level_m is None for gbs_report in statements)
    assert [s.fix_within_masks for s in statements] == [
        "yes" if messages["NAV-PVT"].gnssFixOk else "no" for messages in reported.values()
    ]
    assert not [result for result in results if isinstance(result, ReceiverBaseline)]
    assert decoder.messages.malformed == 0
