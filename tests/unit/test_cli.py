"""`camber`: one command that knows every service and every tool."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from camber import cli
from camber.formats.serial_ports import describe_ports
from camber.schemas import channels


def test_help_names_every_service_and_every_tool(capsys: pytest.CaptureFixture[str]) -> None:
    for argv in ([], ["--help"], ["-h"], ["help"]):
        assert cli.main(argv) == 0
        said = capsys.readouterr().out
        for name in (*cli.SERVICES, *cli.TOOLS):
            assert f"\n  {name} " in said


def test_every_service_of_the_table_is_a_command() -> None:
    assert set(cli.SERVICES) == {*channels.SERVICES, channels.SENSORS}


@pytest.mark.parametrize("name", sorted(cli.SERVICES))
def test_every_service_command_runs_the_service_of_that_name(name: str) -> None:
    service = importlib.import_module(f"camber.{name}.service").SERVICE
    assert name == service.NAME
    assert name == service.SETTINGS.SERVICE


@pytest.mark.parametrize("name", sorted(cli.TOOLS))
def test_every_tool_command_has_its_own_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main([name, "--help"])
    assert ended.value.code == 0
    assert f"usage: camber {name}" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["gnss", "antenna-height", "antenna_height"])
def test_a_service_is_started_with_the_rest_of_the_line(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main([name, "--vehicle", "shuttle-7", "--print-config"])
    assert ended.value.code == 0
    assert 'vehicle = "shuttle-7"' in capsys.readouterr().out


@pytest.mark.parametrize("name", ["gns", "../gnss", "", "runtime", "--config"])
def test_an_unknown_name_is_one_line_and_exit_code_2(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([name]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"camber: {name!r} is neither a service nor a tool; `camber --help` lists them\n"


def test_a_process_ends_with_the_exit_code() -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "camber.cli", "gnss", "--source", "nowhere"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("camber gnss: source: 'nowhere': expected ")
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize("name", sorted(cli.SERVICES))
def test_every_service_can_be_started_as_a_module(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", f"camber.{name}", "--nothing"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (2, f"camber {name}: unrecognized arguments: --nothing\n")


@pytest.mark.parametrize("module", ["camber.cli", "camber.gnss"])
def test_serial_ports_are_listed_whether_there_are_any_or_none(module: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", module, *(["gnss"] if module == "camber.cli" else []), "--list-ports"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout == f"{describe_ports()}\n"


@pytest.mark.parametrize(
    ("package", "name", "whence"),
    [
        ("numba", "gnss", "camber[engine]"),
        ("cryptography", "doctor", "all of Camber, and not with the image of a single service"),
    ],
)
def test_a_package_that_is_missing_is_named_with_what_brings_it(package: str, name: str, whence: str) -> None:
    run = f"from camber.cli import main; raise SystemExit(main(['{name}']))"
    without = f"import sys; sys.modules['{package}'] = None; {run}"
    ended = subprocess.run(
        [sys.executable, "-c", without],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == f"camber {name}: {package} is not installed; it comes with {whence}\n"
