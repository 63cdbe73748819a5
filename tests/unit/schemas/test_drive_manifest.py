"""The drive manifest says in one line what is wrong with it, and refuses errors that flatter."""

import math
from pathlib import Path

import pytest

from camber.schemas.drive import LEAST_ERRORS, DriveManifest, ManifestError, load_manifest

TEXT = """
name = "try"

[receiver]
format = "pos"
file = "rover.pos"

[truth]
format = "camber"
file = "${CAMBER_DATA}/truth.csv"

[antenna_height]
height_m = 1.8
sigma_m = 0.02

[surrogates]
inputs = ["wheel_speed", "yaw_rate", "links", "road_surfaces"]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rover.pos").write_text("%\n")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "truth.csv").write_text("\n")
    return tmp_path


def load(
    folder: Path, text: str = TEXT, overrides: list[str] | dict[str, object] | None = None
) -> DriveManifest:
    path = folder / "drive.toml"
    path.write_text(text)
    return load_manifest(path, overrides or [], environ={"CAMBER_DATA": str(folder / "data")})


def refusal(folder: Path, text: str = TEXT, overrides: list[str] | None = None) -> str:
    with pytest.raises(ManifestError) as caught:
        load(folder, text, overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_paths_are_relative_to_the_manifest_absolute_or_begin_with_the_folder_of_recordings(
    folder: Path,
) -> None:
    manifest = load(folder)
    assert manifest.receiver.file == folder / "rover.pos"
    assert manifest.truth.file == folder / "data" / "truth.csv"
    elsewhere = folder / "data" / "rover.pos"
    elsewhere.write_text("%\n")
    assert load(folder, overrides=[f"receiver.file={elsewhere}"]).receiver.file == elsewhere
    assert "there is no such file" in refusal(folder, overrides=[f"receiver.file={elsewhere}x"])


def test_defaults_are_the_least_errors_allowed_or_larger(folder: Path) -> None:
    errors = load(folder).surrogates
    assert errors.smaller_errors == ()
    assert errors.map_sigma_m == 0.05
    assert errors.yaw_rate_bias_sigma_rad_s == math.radians(0.02)
    assert load(folder).alert_limit_m == 1.5


@pytest.mark.parametrize("name", sorted(LEAST_ERRORS))
def test_smaller_errors_are_refused_unless_they_are_allowed_and_then_shown(folder: Path, name: str) -> None:
    value = 0.9 * LEAST_ERRORS[name]
    message = refusal(folder, overrides=[f"surrogates.{name}={value}"])
    assert f"surrogates.{name}" in message
    assert "expected at least" in message
    allowed = load(folder, overrides=["surrogates.allow_smaller_errors=true", f"surrogates.{name}={value}"])
    assert allowed.summary()["smaller_errors"] == [name]
    assert any(name in note for note in allowed.surrogate_notes())


def test_overrides_are_toml_or_text_or_values(folder: Path) -> None:
    overrides = ["surrogates.map_sigma_m=0.10", "surrogates.seed=7", "name=another"]
    manifest = load(folder, overrides=overrides)
    assert (manifest.surrogates.map_sigma_m, manifest.surrogates.seed, manifest.name) == (0.10, 7, "another")
    assert manifest.summary()["overrides"] == ["surrogates.map_sigma_m=0.1", *overrides[1:]]
    assert load(folder, overrides={"surrogates.map_sigma_m": 0.2}).surrogates.map_sigma_m == 0.2


def test_an_override_cannot_bring_other_keys_along(folder: Path) -> None:
    assert "name" in refusal(folder, overrides=["name='x'\nvehicle='y'"])


def test_summary_names_what_was_made_and_not_measured(folder: Path) -> None:
    manifest = load(folder)
    summary = manifest.summary()
    assert summary["surrogates"] == ["wheel_speed", "yaw_rate", "links", "road_surfaces"]
    assert summary["surrogate_errors"]["map_long_m"] == 100.0
    assert str(folder) not in str(summary)
    assert [note.split(":")[0] for note in manifest.surrogate_notes()] == summary["surrogates"]


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["surrogates.map_sigma_cm=5"], "surrogates.map_sigma_cm is not known; did you mean map_sigma_m?"),
        (["surrogates.map_sigma_m=5 cm"], "surrogates.map_sigma_m is '5 cm': should be a valid number"),
        (["surrogates.map_sigma_m=true"], "surrogates.map_sigma_m is 'True'"),
        (["surrogates.map_sigma_m=nan"], "surrogates.map_sigma_m is 'nan'"),
        (["surrogates.seed=1.5"], "surrogates.seed is '1.5'"),
        (["surrogates.inputs=['odometer']"], "surrogates.inputs.0 is 'odometer'"),
        (["surrogates.yaw_rate_noise_rad_s=5.7"], "less than or equal to 3.14"),
        (["receiver.file=other.pos"], "receiver.file is 'other.pos': there is no such file"),
        (["receiver.file=$HOME/rover.pos"], "expected a path without $, or ${CAMBER_DATA}"),
        (["receiver.format=ubx"], "receiver.format is 'ubx': should be 'pos' or 'nmea'"),
        (["antenna_height.way=stroke"], "without suspension_to_antenna_m"),
        (["antenna_height.way=ranging"], "expected lever_arms.antenna with its z_m"),
        (["antenna_height.way=automatic", "lever_arms.antenna.x_m=1.0"], "lever_arms.antenna with its z_m"),
        (
            ["antenna_height.way=ranging", "lever_arms.antenna.z_m=1.6", "ranging.file=rover.pos"],
            "expected a table ranging or a table sweeps, each with its lever arm and z_m",
        ),
        (
            [
                "antenna_height.way=scan_matching",
                "lever_arms={antenna={z_m=1.6}, ranging={z_m=0.9}}",
                "ranging.file=rover.pos",
            ],
            "expected a table sweeps, each with its lever arm and z_m",
        ),
        (["motion.file=rover.pos"], "expected no wheel_speed, yaw_rate, steering in surrogates.inputs"),
        (["map.release=data"], "expected no links, road_surfaces in surrogates.inputs"),
        (["start_s=5", "end_s=4"], "end_s is not after start_s"),
        (["lever_arms.antenna.x=1"], "lever_arms.antenna.x is not known"),
        (["imu.file=rover.pos"], "imu.class is missing, expected noise class: phone, mems or tactical"),
        (
            ["imu.file=rover.pos", "imu.class=gyro"],
            "imu.class is 'gyro': should be 'phone', 'mems' or 'tactical' (noise class",
        ),
        (["imu.file=rover.pos", "imu.imu_class=mems"], "imu.class is missing"),
        (["imu={file='rover.pos', class='mems', pitch_deg=91.0}"], "imu.pitch_deg is '91.0'"),
        (
            ["imu={file='rover.pos', class='mems', x=1.0}"],
            "imu.x is not known; expected one of x_m, y_m, z_m, class, roll_deg, pitch_deg, yaw_deg, file",
        ),
        (["name.first=1"], "name is no table"),
        (["surrogates.seed"], "expected field=value"),
        (["surrogates.seed=-1"], "drive.toml: --set surrogates.seed is"),
    ],
)
def test_a_fault_is_one_line_with_the_field_and_what_was_expected(
    folder: Path, overrides: list[str], expected: str
) -> None:
    assert expected in refusal(folder, overrides=overrides)


FAULTS = {
    "surrogates.antenna_height_m is missing": (
        "[antenna_height]\nheight_m = 1.8\nsigma_m = 0.02",
        "[lever_arms.lidar]",
    ),
    "surrogates.inputs is not empty, expected a table truth": ('[truth]\nformat = "camber"', "[motion]"),
    "antenna_height.sigma_m is '-1.0'": ("sigma_m = 0.02", "sigma_m = -1.0"),
}


@pytest.mark.parametrize("expected", FAULTS)
def test_a_fault_of_the_file_is_one_line_that_begins_with_its_name(folder: Path, expected: str) -> None:
    assert refusal(folder, TEXT.replace(*FAULTS[expected])).startswith(f"{folder / 'drive.toml'}: {expected}")


@pytest.mark.parametrize(
    ("method", "sensor", "arm"),
    [
        ("ranging", "ranging.file=rover.pos", "ranging"),
        ("ranging", "sweeps.folder=data", "lidar"),
        ("scan_matching", "sweeps.folder=data", "lidar"),
        ("automatic", "ranging.file=rover.pos", "ranging"),
        ("automatic", "sweeps.folder=data", "lidar"),
    ],
)
def test_a_height_method_is_accepted_with_its_sensor_and_lever_arms(
    folder: Path, method: str, sensor: str, arm: str
) -> None:
    places = f"lever_arms={{antenna={{z_m=1.6}}, {arm}={{x_m=1.0, z_m=0.9}}}}"
    manifest = load(folder, overrides=[f"antenna_height.way={method}", sensor, places])
    assert manifest.antenna_height.way == method
    assert set(manifest.lever_arms.with_given_height) == {"antenna", arm}


def test_a_receiver_and_raw_observations_may_be_there_both(folder: Path) -> None:
    raw = '\n[observations]\nrover_obs = "rover.pos"\nbase_obs = "rover.pos"\nephemerides = ["rover.pos"]\n'
    both = load(folder, TEXT + raw)
    assert both.receiver is not None
    assert both.observations is not None


@pytest.mark.parametrize(
    "table",
    [
        '[motion]\nfile = "rover.pos"',
        '[imu]\nfile = "rover.pos"\nclass = "phone"',
        '[sweeps]\nfolder = "data"',
    ],
)
def test_a_drive_needs_no_receiver_and_no_antenna_height(folder: Path, table: str) -> None:
    manifest = load(folder, f'name = "try"\n{table}\n')
    assert (manifest.receiver, manifest.observations, manifest.antenna_height) == (None, None, None)
    # There is nothing that the engine could solve.
    assert manifest.judged_positions == "receiver"


def test_a_drive_without_any_input_is_refused(folder: Path) -> None:
    expected = "receiver: expected one of the tables receiver, observations, motion"
    assert expected in refusal(folder, 'name = "try"\n[map]\nrelease = "data"\n')


def test_an_unset_folder_of_recordings_is_named(folder: Path) -> None:
    load(folder)
    with pytest.raises(ManifestError, match=r"truth\.file .*CAMBER_DATA is not set"):
        load_manifest(folder / "drive.toml", environ={})


@pytest.mark.parametrize("text", ["name = ", b"name = '\xff'", None])
def test_what_is_no_manifest_is_one_line_too(tmp_path: Path, text: str | bytes | None) -> None:
    path = tmp_path / "drive.toml"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ManifestError, match=r"drive\.toml: .+") as caught:
        load_manifest(path)
    assert "\n" not in str(caught.value)
