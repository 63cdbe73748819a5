"""Positions, integrity reports and epochs of SBF, compared with pysbf2 where it reads the same."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.sbf.reader import SbfDecoder
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.schemas.gnss import ReceiverIntegrity
from support.gnss_files import fed_in_pieces
from support.sbf_blocks import (
    END_OF_PVT,
    GAL_AUTH_STATUS,
    NO_FLOAT,
    POS_COV_GEODETIC,
    PVT_GEODETIC,
    VEL_COV_GEODETIC,
    meas_epoch,
    rf_status,
    sbf_block,
    sbf_frame,
    time_stamp,
)
from support.sbf_oracle import parsed

TIME_NS = 2367 * NS_PER_WEEK + 482_847 * NS_PER_SECOND
POSITION = {
    "Mode": 4, "Latitude": 0.931, "Longitude": -0.0392, "Height": 131.2, "Vn": 1.5, "Ve": -2.5, "Vu": 0.25,
    "NrSV": 21, "MeanCorrAge": 278, "HAccuracy": 4, "VAccuracy": 6, "AlertFlag": 1,
}  # fmt: skip
GALILEO_E1, GPS_L1 = 1 << 17, 1 << 0


def pvt(time_ns: int = TIME_NS, **changes: Any) -> bytes:
    return sbf_block(PVT_GEODETIC, time_ns, revision=2, **(POSITION | changes))


def end(time_ns: int = TIME_NS) -> bytes:
    return sbf_block(END_OF_PVT, time_ns)


def decoded(data: bytes) -> tuple[list[Any], SbfDecoder]:
    decoder = SbfDecoder("test")
    return decoder.feed(data) + decoder.finish(), decoder


def solution_of(*frames: bytes) -> ReceiverSolution:
    (only,) = [r for r in decoded(b"".join(frames))[0] if isinstance(r, ReceiverSolution)]
    return only


def integrity_of(*frames: bytes) -> ReceiverIntegrity:
    """The last report."""
    return [r for r in decoded(b"".join(frames))[0] if isinstance(r, ReceiverIntegrity)][-1]


finite = st.floats(-1e3, 1e3, width=32)


@given(
    st.fixed_dictionaries(
        {
            "Latitude": st.floats(-1.57, 1.57), "Longitude": st.floats(-3.14, 3.14), "Height": finite,
            "Vn": finite, "Ve": finite, "Vu": finite, "NrSV": st.integers(0, 254),
            "MeanCorrAge": st.integers(0, 65534), "HAccuracy": st.integers(1, 65534),
            "VAccuracy": st.integers(1, 65534), "Mode": st.sampled_from([1, 2, 4, 5, 6, 10]),
            "AlertFlag": st.integers(0, 255),
        }
    )
)  # fmt: skip
@settings(derandomize=True, max_examples=100, deadline=None)
def test_position_is_that_of_pysbf2(fields: dict[str, Any]) -> None:
    frame = pvt(**fields)
    message, solution = parsed(frame), solution_of(frame, end())
    assert solution.time_ns == TIME_NS
    assert solution.latitude_rad == message.Latitude
    assert solution.longitude_rad == message.Longitude
    assert solution.height_m == message.Height
    assert solution.velocity_enu_m_s == (message.Ve, message.Vn, message.Vu)
    assert solution.satellites == message.NrSV
    assert solution.age_s == pytest.approx(message.MeanCorrAge, abs=1e-9)
    ee, en, eu, nn, nu, uu = solution.covariance_enu_m2 or ()
    assert (en, eu, nu) == (0.0, 0.0, 0.0)
    # Twice the root mean square of the horizontal error, and of the vertical one.
    assert 2.0 * (ee + nn) ** 0.5 == pytest.approx(message.HAccuracy, rel=1e-9)
    assert 2.0 * uu**0.5 == pytest.approx(message.VAccuracy, rel=1e-9)
    raim = {1: "passed", 2: "failed"}.get(message.RAIMIntegrity, "unknown")
    assert integrity_of(frame, end()).raim == raim


@pytest.mark.parametrize(
    ("mode", "quality"),
    [
        (1, "SINGLE"),
        (2, "DGPS"),
        (4, "FIX"),
        (5, "FLOAT"),
        (6, "SBAS"),
        (7, "SINGLE"),
        (8, "SINGLE"),
        (10, "PPP"),
    ],
)
def test_mode_is_the_quality_and_a_moving_base_makes_no_fix(mode: int, quality: str) -> None:
    assert solution_of(pvt(Mode=mode | 0x40), end()).quality is SolutionQuality[quality]


@pytest.mark.parametrize(
    "changes",
    [
        {"Mode": 0}, {"Mode": 3}, {"Mode": 12}, {"Mode": 0x84}, {"Error": 1}, {"Latitude": NO_FLOAT},
        {"Height": NO_FLOAT},
    ],
)  # fmt: skip
def test_epoch_without_a_position_in_three_dimensions_is_counted(changes: dict[str, Any]) -> None:
    results, decoder = decoded(pvt(**changes) + end())
    assert not [r for r in results if isinstance(r, ReceiverSolution)]
    assert decoder.messages.epochs_without_position == 1


def test_values_that_are_not_available_are_none() -> None:
    solution = solution_of(
        pvt(NrSV=255, MeanCorrAge=65535, Vu=NO_FLOAT, HAccuracy=65535),
        sbf_block(POS_COV_GEODETIC, TIME_NS, Mode=0),
    )
    assert (solution.satellites, solution.age_s, solution.velocity_enu_m_s) == (None, None, None)
    assert solution.covariance_enu_m2 is None


def test_position_of_the_first_revision_has_no_accuracy() -> None:
    whole = pvt()
    solution = solution_of(sbf_frame(PVT_GEODETIC, whole[8 : 8 + 77]), end())
    assert solution.covariance_enu_m2 is None
    assert solution.height_m == POSITION["Height"]


def test_position_outside_the_earth_is_malformed() -> None:
    _, decoder = decoded(pvt(Latitude=1.6) + end())
    assert decoder.messages.malformed == 1


COVARIANCE = {
    "latlat": 0.16,
    "lonlon": 0.098,
    "hgthgt": 0.477,
    "latlon": 0.0147,
    "lathgt": 0.0525,
    "lonhgt": -0.0588,
}
VELOCITY = {"VnVn": 0.25, "VeVe": 0.5, "VuVu": 0.75, "VnVe": 0.0625, "VnVu": -0.125, "VeVu": 0.03125}


def test_covariances_are_those_of_pysbf2() -> None:
    position = sbf_block(POS_COV_GEODETIC, TIME_NS, Mode=4, **{f"Cov_{k}": v for k, v in COVARIANCE.items()})
    velocity = sbf_block(VEL_COV_GEODETIC, TIME_NS, Mode=4, **{f"Cov_{k}": v for k, v in VELOCITY.items()})
    solution = solution_of(pvt(), position, velocity, end())
    names = ("lonlon", "latlon", "lonhgt", "latlat", "lathgt", "hgthgt")
    assert solution.covariance_enu_m2 == tuple(getattr(parsed(position), f"Cov_{k}") for k in names)
    names = ("VeVe", "VnVe", "VeVu", "VnVn", "VnVu", "VuVu")
    assert solution.velocity_covariance_enu_m2_s2 == tuple(
        getattr(parsed(velocity), f"Cov_{k}") for k in names
    )


@pytest.mark.parametrize("change", [{"latlat": -0.1}, {"latlon": 0.9}, {"hgthgt": float("nan")}])
def test_impossible_covariance_is_malformed_and_costs_only_itself(change: dict[str, float]) -> None:
    fields = {f"Cov_{k}": v for k, v in (COVARIANCE | change).items()}
    results, decoder = decoded(pvt() + sbf_block(POS_COV_GEODETIC, TIME_NS, Mode=4, **fields) + end())
    assert decoder.messages.malformed == 1
    (solution,) = [r for r in results if isinstance(r, ReceiverSolution)]
    assert solution.covariance_enu_m2 is not None
    assert solution.covariance_enu_m2[0] == pytest.approx(0.5 * 0.02**2)


def test_epoch_ends_with_its_end_or_with_the_next_one() -> None:
    decoder = SbfDecoder("test")
    assert not decoder.feed(pvt())
    first = decoder.feed(end())
    assert [type(r) for r in first] == [ReceiverSolution, ReceiverIntegrity]
    assert not decoder.feed(pvt())  # once more
    assert decoder.messages.late == 1
    assert not decoder.feed(pvt(TIME_NS + NS_PER_SECOND))
    second = decoder.feed(pvt(TIME_NS + 2 * NS_PER_SECOND))
    assert [r.time_ns for r in second] == [TIME_NS + NS_PER_SECOND] * 2
    assert [r.time_ns for r in decoder.finish()] == [TIME_NS + 2 * NS_PER_SECOND] * 2


# ------------------------------------------------------------------------------------------------------- integrity


@pytest.mark.parametrize(
    ("bands", "flags", "jamming", "spoofing"),
    [
        ([], 0, "none", "none"),
        ([(1_575_420_000, 100, 1)], 0, "none", "none"),
        ([(1_575_420_000, 100, 1), (1_227_600_000, 50, 2)], 0, "warning", "none"),
        ([(1_575_420_000, 100, 2), (1_176_450_000, 900, 8 | 1 << 6)], 0, "critical", "none"),
        ([], 0b01, "none", "indicated"),
        ([], 0b10, "none", "affirmed"),
        ([(1_575_420_000, 100, 8)], 0b11, "critical", "affirmed"),
    ],
)
def test_radio_state_is_jamming_and_spoofing(
    bands: list[tuple[int, int, int]], flags: int, jamming: str, spoofing: str
) -> None:
    frame = rf_status(TIME_NS, bands, flags=flags)
    message = parsed(frame)
    assert (message.N, message.Misleading, message.Inauthentic) == (len(bands), flags & 1, flags >> 1)
    assert [getattr(message, f"Mode_{k:02d}") for k in range(1, len(bands) + 1)] == [b[2] & 15 for b in bands]
    report = integrity_of(frame)
    assert (report.time_ns, report.jamming, report.spoofing) == (TIME_NS, jamming, spoofing)


def authentication(status: int, *, galileo: tuple[int, int] = (0, 0), gps: tuple[int, int] = (0, 0)) -> bytes:
    masks = {"GalActiveMask": galileo[0], "GalAuthenticMask": galileo[1]}
    masks |= {"GpsActiveMask": gps[0], "GpsAuthenticMask": gps[1]}
    return sbf_block(GAL_AUTH_STATUS, TIME_NS, OSNMAStatus=status | 100 << 3, **masks)


@pytest.mark.parametrize(
    ("status", "galileo", "gps", "signals", "expected"),
    [
        (0, (0, 0), (0, 0), GALILEO_E1, "unknown"),
        (1, (7, 7), (0, 0), GALILEO_E1, "unknown"),
        (6, (0, 0), (0, 0), GALILEO_E1, "unknown"),
        (6, (7, 7), (0, 0), GALILEO_E1, "yes"),
        (6, (7, 7), (0, 0), GALILEO_E1 | GPS_L1, "unknown"),
        (6, (7, 7), (0, 0), None, "unknown"),
        (6, (7, 3), (0, 0), GALILEO_E1, "no"),
        (6, (1 << 35, 0), (0, 0), GALILEO_E1 | GPS_L1, "no"),
        (6, (7, 7), (1, 0), GALILEO_E1, "no"),
        (6, (0, 0), (1, 1), GALILEO_E1, "unknown"),
    ],
)
def test_fix_is_authenticated_where_all_it_rests_on_is(
    status: int, galileo: tuple[int, int], gps: tuple[int, int], signals: int | None, expected: str
) -> None:
    frame = authentication(status, galileo=galileo, gps=gps)
    message = parsed(frame)
    assert (message.Status, message.GalActiveMask, message.GalAuthenticMask) == (status, *galileo)
    position = b"" if signals is None else pvt(SignalInfo=signals) + end()
    assert integrity_of(position, frame).authenticated == expected


def test_states_within_an_epoch_are_one_report_at_its_end() -> None:
    data = pvt() + rf_status(TIME_NS, flags=1) + authentication(6, galileo=(3, 1)) + end()
    (report,) = [r for r in decoded(data)[0] if isinstance(r, ReceiverIntegrity)]
    assert (report.raim, report.spoofing, report.authenticated) == ("passed", "indicated", "no")


def test_states_are_unknown_after_two_seconds() -> None:
    later = TIME_NS + 3 * NS_PER_SECOND
    assert integrity_of(rf_status(TIME_NS, flags=1), pvt(later), end(later)).spoofing == "unknown"


@pytest.mark.parametrize("body", [b"\x02\x08\x00\x00\x00\x00", b"\x01\x04\x00\x00\x00\x00" + bytes(8)])
def test_truncated_radio_state_is_malformed(body: bytes) -> None:
    results, decoder = decoded(sbf_frame(4092, time_stamp(TIME_NS) + body))
    assert not results
    assert decoder.messages.malformed == 1


# ---------------------------------------------------------------------------------------------------------- stream


def test_other_blocks_and_blocks_without_time_are_counted() -> None:
    _, decoder = decoded(sbf_frame(4014, bytes(40)) + pvt(None) + sbf_frame(4027, b"\x00\x00"))  # type: ignore[arg-type]
    messages = decoder.messages
    assert (messages.not_read, messages.without_time, messages.malformed) == (1, 1, 1)


def test_impossible_time_is_malformed() -> None:
    body = struct.pack("<IH", 604_800_000, 2367)
    _, decoder = decoded(
        sbf_frame(4027, body + bytes(8)) + sbf_frame(4027, struct.pack("<IH", 0, 65000) + bytes(8))
    )
    assert decoder.messages.malformed == 2


@given(st.integers(0, 2**32))
@settings(derandomize=True, max_examples=50, deadline=None)
def test_results_do_not_depend_on_pieces_and_survive_damage(seed: int) -> None:
    rng = random.Random(seed)
    frames = []
    for k in range(4):
        time_ns = TIME_NS + k * NS_PER_SECOND
        frames += [meas_epoch(time_ns, {}), pvt(time_ns), rf_status(time_ns), end(time_ns)]
    data = bytearray(b"".join(frames))
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    whole, decoder = decoded(bytes(data))
    cuts = rng.sample(range(len(data)), 30)
    assert [type(r) for r in fed_in_pieces(SbfDecoder("test"), bytes(data), cuts)] == [type(r) for r in whole]
    # One damaged block costs itself, and the bytes that look like one inside it.
    assert sum(isinstance(r, ReceiverEpoch) for r in whole) >= 3
    assert sum(isinstance(r, ReceiverSolution) for r in whole) >= 3
    assert decoder.failed_checks <= 1
