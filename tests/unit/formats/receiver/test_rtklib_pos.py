"""`.pos` files: accepted and refused content, and malformed input that must never raise."""

import itertools
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from camber.formats.errors import FormatError
from camber.formats.line_buffer import MAXIMUM_LINE_BYTES
from camber.formats.receiver.printed_covariance import covariance_from_printed, signed_root
from camber.formats.receiver.rtklib_pos import PosDecoder, format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst, gps_ns_from_week_tow
from camber.schemas.base import LATEST_NS
from support.gnss_files import comparable, read_pos, recording
from support.random_solutions import VELOCITIES, solutions

DATUM = (
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)\n"
)
COLUMNS = (
    "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)"
    "  sdeu(m)  sdun(m) age(s)  ratio\n"
)
VELOCITY_COLUMNS = (
    COLUMNS[:-1]
    + "    vn(m/s)    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu    sdvne    sdveu    sdvun\n"
)
ROW = (
    "2270 194670.000   35.165360868  136.881409540    41.4082   1  16   0.0049   0.0046   0.0102   0.0028"
    "   0.0018  -0.0033   0.03    6.4\n"
)
VELOCITY_ROW = (
    "2023/07/11 06:04:32.000   35.165360854  136.881409534    41.4069   1  19   0.0045   0.0045   0.0097"
    "   0.0027   0.0011  -0.0030   0.03    5.9    0.01946   -0.02313    0.01343   0.09822  0.10783  0.25018"
    "  0.05434  0.05016  0.05029\n"
)
NAMES = COLUMNS[1:].split()


def decode(text: str | bytes) -> list[ReceiverSolution | FormatError]:
    decoder = PosDecoder("rover.pos")
    data = text if isinstance(text, bytes) else text.encode()
    return decoder.feed(data) + decoder.finish()


def solution_of(text: str) -> ReceiverSolution:
    (result,) = decode(text)
    assert isinstance(result, ReceiverSolution), str(result)
    return result


def error_of(text: str) -> str:
    (result,) = decode(text)
    assert isinstance(result, FormatError)
    message = str(result)
    assert "\n" not in message
    return message


def with_value(name: str, value: str) -> str:
    fields = ROW.split()
    fields[NAMES.index(name) + 1] = value
    return DATUM + COLUMNS + " ".join(fields) + "\n"


def test_recorded_row_is_decoded() -> None:
    solution = solution_of(DATUM + COLUMNS + ROW)
    assert solution.time_ns == gps_ns_from_week_tow(2270, 194670 * NS_PER_SECOND)
    assert math.degrees(solution.latitude_rad) == pytest.approx(35.165360868, abs=1e-12)
    assert math.degrees(solution.longitude_rad) == pytest.approx(136.881409540, abs=1e-12)
    assert (solution.height_m, solution.satellites) == (41.4082, 16)
    assert (solution.age_s, solution.ratio) == (0.03, 6.4)
    assert solution.quality is SolutionQuality.FIX
    # (ee, en, eu, nn, nu, uu) of sdn sde sdu and the signed roots sdne sdeu sdun
    assert solution.covariance_enu_m2 == pytest.approx(
        (0.0046**2, 0.0028**2, 0.0018**2, 0.0049**2, -(0.0033**2), 0.0102**2)
    )
    assert solution.velocity_enu_m_s is None
    assert solution.velocity_covariance_enu_m2_s2 is None


def test_velocity_is_reordered_to_east_north_up() -> None:
    solution = solution_of(DATUM + VELOCITY_COLUMNS + VELOCITY_ROW)
    assert solution.time_ns == gps_ns_from_gpst(CalendarTime(2023, 7, 11, 6, 4, 32))
    assert solution.velocity_enu_m_s == (-0.02313, 0.01946, 0.01343)
    assert solution.velocity_covariance_enu_m2_s2 == pytest.approx(
        (0.10783**2, 0.05434**2, 0.05016**2, 0.09822**2, 0.05029**2, 0.25018**2)
    )


def test_utc_is_converted_to_gps_time() -> None:
    text = DATUM + COLUMNS.replace("GPST", "UTC") + ROW.replace("2270 194670.000", "2023/07/11 06:04:12.000")
    assert solution_of(text).time_ns == gps_ns_from_gpst(CalendarTime(2023, 7, 11, 6, 4, 30))


def test_week_and_seconds_under_utc_are_ambiguous_and_refused() -> None:
    assert "header says UTC" in error_of(DATUM + COLUMNS.replace("GPST", "UTC") + ROW)


def test_columns_go_by_name_and_separators_may_be_commas() -> None:
    header = "%  GPST,height(m),longitude(deg),latitude(deg),ns,Q\n"
    solution = solution_of(DATUM + header + "2023/07/11 06:04:32.0,41.5,136.5,35.5,9,2\r\n")
    assert (solution.height_m, solution.quality, solution.satellites) == (41.5, SolutionQuality.FLOAT, 9)
    assert math.degrees(solution.latitude_rad) == pytest.approx(35.5)
    assert (solution.covariance_enu_m2, solution.age_s, solution.ratio) == (None, None, None)


def test_zero_deviations_and_zero_ratio_are_unknown() -> None:
    fields = ROW.split()
    fields[7:13] = ["0.0000"] * 6
    fields[14] = "0.0"
    solution = solution_of(DATUM + COLUMNS + " ".join(fields) + "\n")
    assert solution.covariance_enu_m2 is None
    assert solution.ratio is None
    assert solution.age_s == 0.03


def test_age_of_a_single_solution_is_unknown() -> None:
    fields = ROW.split()
    fields[5], fields[13] = "5", "0.00"
    assert solution_of(DATUM + COLUMNS + " ".join(fields) + "\n").age_s is None
    fields[5] = "1"
    assert solution_of(DATUM + COLUMNS + " ".join(fields) + "\n").age_s == 0.0


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (DATUM.replace("ellipsoidal", "geodetic") + COLUMNS, "orthometric height without a named geoid"),
        (DATUM.replace("WGS84", "Tokyo") + COLUMNS, "datum is 'Tokyo', expected WGS84"),
        ("% (x/y/z-ecef=WGS84,Q=1:fix)\n%  GPST  x-ecef(m) y-ecef(m) z-ecef(m) Q ns\n", "ECEF and baselines"),
        (
            "% (e/n/u-baseline=WGS84,Q=1:fix)\n%  GPST  e-baseline(m) n-baseline(m) u-baseline(m)\n",
            "baselines",
        ),
        (DATUM + COLUMNS.replace("GPST", "JST"), "time system is 'JST', expected GPST or UTC"),
        (DATUM + COLUMNS.replace("(deg)", "(d'\")"), "a column latitude(deg)"),
        (DATUM + COLUMNS.replace("sdne(m)", ""), "a column sdne(m)"),
        (DATUM + COLUMNS.replace("ratio", "Q"), "each name once"),
    ],
)
def test_unreadable_headers_are_refused_once(header: str, expected: str) -> None:
    decoder = PosDecoder("rover.pos")
    results = decoder.feed((header + ROW * 3).encode())
    assert [type(result) for result in results] == [FormatError]
    assert expected in str(results[0])
    assert str(results[0]).startswith("rover.pos:")
    assert decoder.rows_refused == 3


def test_rows_without_a_header_are_refused_once() -> None:
    assert "a header line naming them" in error_of(ROW * 3)
    assert "WGS84/ellipsoidal" in error_of(COLUMNS + ROW * 3)


def test_a_second_header_replaces_the_first() -> None:
    results = decode(
        DATUM.replace("ellipsoidal", "geodetic") + COLUMNS + ROW + DATUM + VELOCITY_COLUMNS + VELOCITY_ROW
    )
    assert [type(result) for result in results] == [FormatError, ReceiverSolution]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("latitude(deg)", "95.0"), ("latitude(deg)", "nan"), ("longitude(deg)", "inf"),
        ("longitude(deg)", "180.1"), ("height(m)", "1_0"), ("height(m)", "1e9"), ("height(m)", "-"),
        ("Q", "0"), ("Q", "8"), ("Q", "1.0"), ("ns", "-1"), ("ns", "1000"), ("sdn(m)", "-0.1"),
        ("sde(m)", "nan"), ("sdeu(m)", "x"), ("age(s)", "nan"), ("ratio", "inf"), ("ratio", "-1"),
    ],
)  # fmt: skip
def test_malformed_value_names_line_field_and_expectation(name: str, value: str) -> None:
    message = error_of(with_value(name, value))
    assert message.startswith("rover.pos:3: ")
    assert name in message
    assert value in message
    assert "expected" in message


@pytest.mark.parametrize(
    "time",
    [
        "2270 604800.0", "2270 -1", "-1 5", "9999 1", "99999 1", "2023/02/30 00:00:00",
        "1979/01/01 00:00:00", "2100/01/01 00:00:00", "20230711000/01/01 00:00:00", "a b",
    ],
)  # fmt: skip
def test_malformed_time_is_an_error(time: str) -> None:
    assert "rover.pos:3: time" in error_of(DATUM + COLUMNS + ROW.replace("2270 194670.000", time))


@pytest.mark.parametrize("height", ["", "41,4082"])
def test_missing_and_surplus_columns(height: str) -> None:
    actual, _, expected = error_of(DATUM + COLUMNS + ROW.replace("41.4082", height)).partition("expected")
    assert "15 fields" not in actual
    assert "15 fields" in expected


def test_indefinite_covariance_is_refused() -> None:
    assert "positive semidefinite" in error_of(with_value("sdne(m)", "0.0200"))


def test_malformed_line_costs_one_line() -> None:
    results = decode(DATUM + COLUMNS + ROW + ROW.replace("35.16", "95.16") + ROW)
    assert [type(result) for result in results] == [ReceiverSolution, FormatError, ReceiverSolution]


def test_too_long_line_is_dropped_with_bounded_memory() -> None:
    decoder = PosDecoder("rover.pos")
    decoder.feed((DATUM + COLUMNS).encode())
    results = [result for _ in range(100) for result in decoder.feed(b"9" * 1000)]
    assert len(results) == 1
    assert f"at most {MAXIMUM_LINE_BYTES} bytes" in str(results[0])
    assert decoder.feed(b"\n" + ROW.encode())[0] == solution_of(DATUM + COLUMNS + ROW)


def test_last_line_without_newline_is_an_error() -> None:
    assert "a newline at its end" in error_of(DATUM + COLUMNS + ROW[:-1])


# From a hundred printed digits on: rounding leaves a covariance of these correlations (below 0.9) positive definite.
deviations = st.floats(0.01, 50.0)
small_deviations = st.floats(1e-4, 50.0)
factors = st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9)
Three = tuple[float, float, float]


def covariance_from(scale: Three, factor: list[float], share: float = 0.5) -> tuple[float, ...]:
    """Of factors (3, 3), and a share of the unit matrix that keeps the correlations away from one."""
    rows = np.array(factor).reshape(3, 3)
    covariance = np.outer(scale, scale) * (rows @ rows.T + share * np.eye(3))
    return tuple(covariance[np.triu_indices(3)].tolist())


def nearly_singular(scale: Three, factor: list[float], noise: float) -> tuple[float, ...]:
    """The third row is, but for the noise, the difference of the others."""
    third = [a - b + noise * c for a, b, c in zip(factor[:3], factor[3:6], factor[6:], strict=True)]
    return covariance_from(scale, factor[:6] + third, share=0.0)


covariances = st.builds(covariance_from, st.tuples(deviations, deviations, deviations), factors)


@given(
    solutions(
        time_ns=st.integers(0, LATEST_NS),
        satellites=st.integers(1, 60),
        covariance_enu_m2=st.none() | covariances,
        age_s=st.floats(0.01, 60.0),
        ratio=st.none() | st.floats(1.0, 999.0),
        velocity_enu_m_s=VELOCITIES,
        velocity_covariance_enu_m2_s2=st.none() | covariances,
    ),
    st.booleans(),
)
def test_written_solutions_read_back(solution: ReceiverSolution, velocity: bool) -> None:
    text = format_pos_header(velocity=velocity) + format_pos_line(solution, velocity=velocity)
    (again,) = decode(text)
    assert isinstance(again, ReceiverSolution), str(again)
    for name in ("time_ns", "quality", "satellites"):
        assert getattr(again, name) == getattr(solution, name)
    assert again.latitude_rad == pytest.approx(solution.latitude_rad, abs=math.radians(0.51e-9))
    assert again.longitude_rad == pytest.approx(solution.longitude_rad, abs=math.radians(0.51e-9))
    assert again.height_m == pytest.approx(solution.height_m, abs=0.51e-4)
    assert again.age_s == pytest.approx(solution.age_s, abs=0.0051)
    assert (again.ratio is None) == (solution.ratio is None)
    if solution.ratio is not None:
        assert again.ratio == pytest.approx(solution.ratio, abs=0.051)
    assert_close_covariance(again.covariance_enu_m2, solution.covariance_enu_m2, 1e-4)
    if velocity:
        assert again.velocity_enu_m_s == pytest.approx(solution.velocity_enu_m_s, abs=0.51e-5)
        assert_close_covariance(
            again.velocity_covariance_enu_m2_s2, solution.velocity_covariance_enu_m2_s2, 1e-5
        )


def assert_close_covariance(
    again: tuple[float, ...] | None, original: tuple[float, ...] | None, last_digit: float
) -> None:
    assert (again is None) == (original is None)
    if again is None or original is None:
        return
    largest = math.sqrt(max(original))
    for a, b in zip(again, original, strict=True):
        assert a == pytest.approx(b, abs=20.0 * largest * last_digit)  # d(s²) = 2 s ds


@given(
    st.builds(covariance_from, st.tuples(*[small_deviations] * 3), factors)
    | st.builds(
        nearly_singular, st.tuples(*[small_deviations] * 3), factors, st.sampled_from([0.0, 0.001, 0.3])
    )
)
@example((1.5, 1.0, -7.5e-05, 3.5, -0.0002, 1.875e-08))
def test_a_covariance_near_the_last_digit_stays_one_with_the_same_variances(covariance) -> None:
    solution = replace(SOMEWHERE, covariance_enu_m2=covariance)
    (again,) = decode(format_pos_header() + format_pos_line(solution))
    assert isinstance(again, ReceiverSolution), str(again)
    ee, en, eu, nn, nu, uu = again.covariance_enu_m2
    for index, variance in ((0, ee), (3, nn), (5, uu)):
        assert math.sqrt(variance) == pytest.approx(math.sqrt(covariance[index]), abs=1e-4)
    eigenvalues = np.linalg.eigvalsh([[ee, en, eu], [en, nn, nu], [eu, nu, uu]])
    assert eigenvalues.min() >= -1e-12 * eigenvalues.max()


SOMEWHERE = ReceiverSolution(
    time_ns=0, latitude_rad=0.6, longitude_rad=2.3, height_m=41.0, quality=SolutionQuality.FIX
)


def test_unprintable_solution_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        format_pos_line(replace(SOMEWHERE, height_m=math.nan))
    with pytest.raises(ValueError, match="no velocity"):
        format_pos_line(SOMEWHERE, velocity=True)


@pytest.mark.parametrize("ambiguities", [True, False])
def test_columns_are_aligned_with_their_names(ambiguities: bool) -> None:
    line = format_pos_line(SOMEWHERE, ambiguities=ambiguities).decode()
    header = format_pos_header(ambiguities=ambiguities).decode().splitlines()[1]
    assert len(line.rstrip("\n")) == len(header)


def test_without_columns_of_ambiguities_age_and_ratio_are_unknown() -> None:
    text = format_pos_header(ambiguities=False) + format_pos_line(SOMEWHERE, ambiguities=False)
    (again,) = decode(text)
    assert isinstance(again, ReceiverSolution)
    assert (again.age_s, again.ratio, again.quality) == (None, None, SolutionQuality.FIX)


SAMPLE = (
    DATUM + COLUMNS + ROW + ROW.replace("41.4082", "nan") + VELOCITY_COLUMNS + VELOCITY_ROW + ROW
).encode()


@given(st.integers(0, len(SAMPLE) - 1), st.integers(0, 7))
def test_flipped_bit_never_raises_or_gives_nonfinite_numbers(byte: int, bit: int) -> None:
    damaged = bytearray(SAMPLE)
    damaged[byte] ^= 1 << bit
    for result in decode(bytes(damaged)):
        if isinstance(result, ReceiverSolution):
            assert all(map(math.isfinite, (result.latitude_rad, result.longitude_rad, result.height_m)))


@given(st.integers(0, len(SAMPLE)))
def test_truncation_gives_a_prefix_and_at_most_one_error_more(length: int) -> None:
    whole, part = comparable(decode(SAMPLE)), comparable(decode(SAMPLE[:length]))
    complete = [result for result in part if "newline at its end" not in str(result)]
    assert complete == whole[: len(complete)]
    assert len(part) - len(complete) <= 1


@pytest.fixture
def nagoya() -> Path:
    return recording("nagoya-2023-07-11")


@pytest.mark.parametrize(
    ("name", "qualities"),
    [
        ("rover_rtk.pos", {SolutionQuality.FIX: 1799, SolutionQuality.FLOAT: 3596}),
        ("rover_1Hz_rtk.pos", {SolutionQuality.FIX: 142, SolutionQuality.FLOAT: 389}),
        ("rover_1Hz_spp.pos", {SolutionQuality.SINGLE: 550}),
    ],
)
def test_recordings_are_decoded_without_error(
    nagoya: Path, name: str, qualities: dict[SolutionQuality, int]
) -> None:
    results = list(read_pos(nagoya / name))
    solutions = [result for result in results if isinstance(result, ReceiverSolution)]
    assert len(solutions) == len(results)
    assert Counter(solution.quality for solution in solutions) == qualities
    assert all(a.time_ns < b.time_ns for a, b in itertools.pairwise(solutions))
    assert all(solution.covariance_enu_m2 is not None for solution in solutions)


def test_week_and_date_times_of_recordings_agree(nagoya: Path) -> None:
    # one file writes weeks, the other dates: the fixes of the same times must be the same places, also in motion
    weeks, dates = (
        {s.time_ns: s for s in read_pos(nagoya / name) if isinstance(s, ReceiverSolution) and s.quality == 1}
        for name in ("rover_rtk.pos", "rover_1Hz_rtk.pos")
    )
    common = sorted(weeks.keys() & dates.keys())
    places = [[(of[t].latitude_rad, of[t].longitude_rad) for t in common] for of in (weeks, dates)]
    assert len(common) > 50
    assert np.quantile(6.4e6 * np.hypot(*np.subtract(*places).T), 0.9) < 0.05


def test_rewritten_recording_is_the_same(nagoya: Path) -> None:
    original = [s for s in read_pos(nagoya / "rover_rtk.pos") if isinstance(s, ReceiverSolution)]
    again = decode(format_pos_header() + b"".join(format_pos_line(solution) for solution in original))
    for a, b in zip(again, original, strict=True):
        # Covariances are printed as rounded roots.
        assert replace(a, covariance_enu_m2=None) == replace(b, covariance_enu_m2=None)


ROUNDING_M = 0.5e-4


def test_signed_roots() -> None:
    covariance = covariance_from_printed((2.0, 3.0, 4.0), (1.0, -2.0, 0.5), ROUNDING_M)
    assert covariance == (4.0, 1.0, -4.0, 9.0, 0.25, 16.0)
    assert (signed_root(4.0), signed_root(-4.0), signed_root(0.0)) == (2.0, -2.0, 0.0)


def test_all_zero_deviations_are_unknown() -> None:
    assert covariance_from_printed((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ROUNDING_M) is None


def test_single_zero_deviation_is_replaced_by_the_rounding() -> None:
    covariance = covariance_from_printed((0.0, 0.01, 0.01), (0.0, 0.0, 0.0), ROUNDING_M)
    assert covariance is not None
    assert covariance[0] == pytest.approx(ROUNDING_M**2)


@pytest.mark.parametrize(
    ("deviations", "roots"),
    [
        ((1.0, -1.0, 1.0), (0.0, 0.0, 0.0)),
        ((float("nan"), 1.0, 1.0), (0.0, 0.0, 0.0)),
        ((1.0, 1.0, 1.0), (1.1, 0.0, 0.0)),
        ((1.0, 1.0, 1.0), (0.9, 0.9, -0.9)),
        ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)),
        ((0.0, 1.0, 1.0), (0.1, 0.0, 0.0)),
    ],
)
def test_impossible_covariance_is_refused(
    deviations: tuple[float, float, float], roots: tuple[float, float, float]
) -> None:
    with pytest.raises(ValueError, match=r"deviations|semidefinite"):
        covariance_from_printed(deviations, roots, ROUNDING_M)
