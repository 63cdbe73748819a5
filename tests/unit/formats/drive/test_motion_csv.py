from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.formats.drive.motion_csv import read_samples, write_samples
from camber.formats.errors import FormatError
from camber.schemas.motion import Imu, Motion, Suspension
from support.messages import messages

PLAIN = "time_ns,wheel_speed_m_s,yaw_rate_rad_s,steering_angle_rad"
T = 1_400_000_000_000_000_000
INERTIAL = (
    "time_ns,angular_rate_x_rad_s,angular_rate_y_rad_s,angular_rate_z_rad_s,"
    "specific_force_x_m_s2,specific_force_y_m_s2,specific_force_z_m_s2"
)
TILTED = PLAIN + ",pitch_rad,roll_rad"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "motion.csv"
    path.write_text(text, "ascii")
    return path


def test_a_file_without_attitude_still_reads(tmp_path: Path) -> None:
    samples = read_samples(written(tmp_path, f"{PLAIN}\n{T},1.5,,-0.01\n"), Motion)
    assert samples == [Motion(time_ns=T, wheel_speed_m_s=1.5, steering_angle_rad=-0.01)]


def test_attitude_may_follow_and_an_empty_field_is_not_known(tmp_path: Path) -> None:
    samples = read_samples(written(tmp_path, f"{TILTED}\n{T},1.5,,,0.02,\n{T + 1},,,,,-0.03\n"), Motion)
    assert samples == [
        Motion(time_ns=T, wheel_speed_m_s=1.5, pitch_rad=0.02),
        Motion(time_ns=T + 1, roll_rad=-0.03),
    ]


@pytest.mark.parametrize(
    "header",
    [
        PLAIN + ",pitch_rad",
        PLAIN + ",roll_rad,pitch_rad",
        PLAIN + ",pitch_deg,roll_deg",
        TILTED + ",yaw_rad",
        "time_ns,wheel_speed_m_s,yaw_rate_rad_s,pitch_rad,roll_rad",
    ],
)
def test_other_columns_are_refused_with_the_expected_ones(tmp_path: Path, header: str) -> None:
    with pytest.raises(FormatError) as error:
        read_samples(written(tmp_path, f"{header}\n"), Motion)
    assert f"expected {PLAIN}, or that and pitch_rad,roll_rad" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_bad_angle_is_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="roll_rad") as error:
        read_samples(written(tmp_path, f"{TILTED}\n{T},,,,0.1,0.1\n{T + 1},,,,0.1,99\n"), Motion)
    assert error.value.line_number == 3
    with pytest.raises(FormatError, match="6 fields, as the header names"):
        read_samples(written(tmp_path, f"{TILTED}\n{T},,,,0.1\n"), Motion)


def test_suspension_has_no_further_columns(tmp_path: Path) -> None:
    path = tmp_path / "suspension.csv"
    path.write_text("time_ns,stroke_height_m,stroke_sigma_m,pitch_rad,roll_rad\n", "ascii")
    with pytest.raises(FormatError, match="header"):
        read_samples(path, Suspension)


def test_written_values_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    plain = [Motion(time_ns=T + 1, wheel_speed_m_s=2.0), Motion(time_ns=T + 2)]
    tilted = [
        *plain,
        Motion(time_ns=T + 3, pitch_rad=0.0),
        Motion(time_ns=T + 4, roll_rad=-0.25, pitch_rad=0.125),
    ]
    for samples, header in ((plain, PLAIN), (tilted, TILTED), ([], PLAIN)):
        write_samples(path, Motion, iter(samples))
        assert path.read_text("ascii").splitlines()[0] == header
        assert read_samples(path, Motion) == samples


def test_inertial_samples_are_a_column_for_each_axis(tmp_path: Path) -> None:
    path = written(
        tmp_path, f"{INERTIAL},temperature_c\n{T},0.01,-0.02,0.03,0.4,-0.5,9.8,31.5\n{T + 1},0,0,0,0,0,9.8,\n"
    )
    assert read_samples(path, Imu) == [
        Imu(
            time_ns=T,
            angular_rate_rad_s=(0.01, -0.02, 0.03),
            specific_force_m_s2=(0.4, -0.5, 9.8),
            temperature_c=31.5,
        ),
        Imu(time_ns=T + 1, angular_rate_rad_s=(0.0, 0.0, 0.0), specific_force_m_s2=(0.0, 0.0, 9.8)),
    ]


@given(st.lists(messages(Imu), max_size=5))
def test_written_inertial_samples_are_read_back_to_the_last_digit(
    tmp_path_factory: pytest.TempPathFactory, samples: list[Imu]
) -> None:
    path = tmp_path_factory.mktemp("imu") / "imu.csv"
    write_samples(path, Imu, samples)
    again = read_samples(path, Imu)
    assert [one.time_ns for one in again] == [one.time_ns for one in samples]
    for one, other in zip(again, samples, strict=True):
        assert one.angular_rate_rad_s == pytest.approx(other.angular_rate_rad_s, abs=1e-9)
        assert one.specific_force_m_s2 == pytest.approx(other.specific_force_m_s2, abs=1e-9)
        assert one.temperature_c == pytest.approx(other.temperature_c, abs=1e-9)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("0,0,0,0,0", "columns is '6 fields', expected 7 fields, as the header names"),
        ("0,0,,0,0,9.8", "angular_rate_z_rad_s is '', expected a number"),
        ("0,fast,0,0,0,9.8", "angular_rate_y_rad_s is 'fast', expected a number"),
        ("0,0,36,0,0,9.8", "angular_rate_z_rad_s is '36', expected Input should be less than or equal to 35"),
        ("0,0,0,0,nan,9.8", "specific_force_y_m_s2 is 'nan', expected Input should be a finite number"),
        ("0,0,0,-401,0,9.8", "specific_force_x_m_s2 is '-401', expected"),
    ],
)
def test_a_bad_inertial_sample_is_one_line_with_its_axis(tmp_path: Path, row: str, expected: str) -> None:
    with pytest.raises(FormatError) as error:
        read_samples(written(tmp_path, f"{INERTIAL}\n{T},0,0,0,0,0,9.8\n{T},{row}\n"), Imu)
    assert str(error.value).startswith(f"motion.csv:3: {expected}")
