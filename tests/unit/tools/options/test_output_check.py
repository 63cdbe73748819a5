"""No command writes over what a person or another command has made; its own results it replaces."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber import cli
from camber.formats.errors import FormatError
from camber.replay.short_drive import write_short_drive
from camber.tools.options.output_check import check_output_file, check_output_folder
from support.refusals import Refused

FOLDER_COMMANDS = {
    "simulate": ("simulate", "open-sky"),
    "demo": ("demo", "--short"),
    "replay": ("replay", "DRIVE"),
    "localize": ("localize", "DRIVE"),
    "solve": ("gnss", "solve", "DRIVE"),
    "lab": ("lab", "--quick"),
    "common_faults": ("common_faults",),
    "evidence": ("evidence", "--only", "faults"),
    "import": ("import", "DRIVE"),
}
FILE_COMMANDS = {
    "calibrate": ("calibrate", "DRIVE"),
    "picture": ("map", "picture", "MAP"),
    "geojson": ("map", "export", "MAP", "--to", "geojson"),
    "access": ("access", "vehicle", "car-1", "--connect", "tls/cloud:7448"),
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_short_drive(tmp_path_factory.mktemp("short"))


def arguments(command: tuple[str, ...], drive: Path) -> list[str]:
    paths = {"DRIVE": str(drive), "MAP": str(drive.with_name("map"))}
    return [paths.get(argument, argument) for argument in command]


@pytest.mark.parametrize("command", FOLDER_COMMANDS.values(), ids=FOLDER_COMMANDS.keys())
def test_a_folder_with_something_else_is_left_alone(
    command: tuple[str, ...], drive: Path, tmp_path: Path, refused: Refused
) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    line = refused(cli.main, *arguments(command, drive), "--out", tmp_path)
    assert f": {tmp_path}: not empty, expected a new folder" in line
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("precious.txt", "mine")]


@pytest.mark.parametrize("command", FILE_COMMANDS.values(), ids=FILE_COMMANDS.keys())
def test_a_file_of_someone_else_is_left_alone(
    command: tuple[str, ...], drive: Path, tmp_path: Path, refused: Refused
) -> None:
    path = tmp_path / "precious"
    path.write_text("mine")
    line = refused(cli.main, *arguments(command, drive), "--out", path)
    assert f": {path}: exists, expected a new file" in line
    assert path.read_text() == "mine"


def test_the_demo_and_a_replay_can_be_run_again_into_their_folders(drive: Path, tmp_path: Path) -> None:
    for command in (["demo", "--short"], ["replay", str(drive), "--set", "end_s=3"]):
        out = tmp_path / command[0]
        for _ in range(2):
            assert cli.main([*command, "--out", str(out)]) == 0
            assert (out / "summary.json").is_file()


@pytest.mark.parametrize("names", [(), ("results.csv",), ("notes.txt", "results.csv"), ("part-7.json",)])
def test_a_new_folder_an_empty_one_and_that_of_an_earlier_run_are_taken(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    for name in names:
        (tmp_path / name).touch()
    check_output_folder(tmp_path, "results.csv", "part-*.json")
    check_output_folder(tmp_path / "new", "results.csv")


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FormatError, match="a file, expected a folder"):
        check_output_folder(tmp_path / "file")


def test_a_file_that_names_the_command_is_replaced_unless_it_may_have_been_edited(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    check_output_file(path, "camber calibrate")
    path.write_text("# Estimated by camber calibrate\n")
    check_output_file(path, "camber calibrate")
    for made_by in ("camber access", ""):
        with pytest.raises(FormatError, match="exists, expected a new file"):
            check_output_file(path, made_by)
    check_output_file(Path("/dev/null"))
