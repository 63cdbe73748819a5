from __future__ import annotations

from pathlib import Path

import pytest

from camber.formats.drive.motion_csv import read_samples, write_samples
from camber.formats.errors import FormatError
from camber.schemas.motion import Motion, Suspension

PLAIN = "time_ns,wheel_speed_m_s,yaw_rate_rad_s,steering_angle_rad"
T = 1_400_000_000_000_000_000
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
