"""`camber`: one command that knows every service and every tool."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import subprocess
import sys

import pytest

from camber import cli
from camber.schemas import channels
from camber.transport.serial_ports import describe_ports


def test_help_names_every_service_and_every_tool(capsys: pytest.CaptureFixture[str]) -> None:
    for argv in ([], ["--help"], ["-h"], ["help"]):
        assert cli.main(argv) == 0
        printed = capsys.readouterr().out
        for name in (*cli.SERVICES, *cli.TOOLS):
            assert f"\n  {name} " in printed


def test_every_service_of_the_table_is_a_command() -> None:
    assert set(cli.SERVICES) == {*channels.SERVICES, channels.SENSORS, channels.ROS2}


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
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"camber: no command {name!r}; ")
    assert captured.err.endswith("`camber --help` lists them\n")
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["replya"], "replay"),
        (["log-levle"], "log_level"),
        (["map", "biuld"], "build"),
        (["map", "build", "lanelet"], "lanelet2"),
    ],
)
def test_a_mistyped_name_gets_the_nearest_one_suggested(
    given: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(given) == 2
    assert f"did you mean {meant!r}?" in capsys.readouterr().err


def test_version_is_that_of_the_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"camber {importlib.metadata.version('camber')}\n"


def completions(line: str) -> list[str]:
    """What the shell is offered at the end of a line: argcomplete writes it to the file descriptor 8."""
    reading, writing = os.pipe()
    script = f"import os; os.dup2({writing}, 8); from camber.cli import main; main()"
    variables = {
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
    }
    subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | variables,
        pass_fds=[writing],
        stderr=subprocess.DEVNULL,
        timeout=60,
        check=False,
    )
    os.close(writing)
    with os.fdopen(reading) as offered:
        return offered.read().split()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("camber repl", ["replay"]),
        ("camber replay --sp", ["--speed"]),
        ("camber map build lane", ["lanelet2"]),
        ("camber antenna_height --fixed", ["--fixed-height-m", "--fixed-sigma-m"]),
    ],
)
def test_the_shell_completes_commands_and_their_options(line: str, offered: list[str]) -> None:
    assert completions(line) == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_script_is_of_the_shell_asked_for(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["--completion", shell]) == 0
    assert "camber" in capsys.readouterr().out


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
    ("package", "name", "source"),
    [
        ("numba", "gnss", "camber[engine]"),
        ("rosbags", "import", "camber[ros]"),
        ("xxhash", "ros2", "camber[ros]"),
        ("cryptography", "doctor", "a full installation of Camber, not with a single service's image"),
    ],
)
def test_a_package_that_is_missing_is_named_with_what_brings_it(package: str, name: str, source: str) -> None:
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
    assert ended.stderr == f"camber {name}: {package} is not installed; it comes with {source}\n"


def run_into(stdout: int, code: str, unbuffered: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )


TOOL = "from camber import cli\ncli._dispatch = lambda args: {}\nraise SystemExit(cli.main(['health']))"


@pytest.mark.parametrize("unbuffered", ["", "1"], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize(
    "code",
    [
        "from camber import cli; raise SystemExit(cli.main(['--help']))",
        "from camber import cli; raise SystemExit(cli.main(['health', '--help']))",
        TOOL.format("print('gnss: ok') or 0"),
        TOOL.format("print('gnss: ok', flush=True) or 0"),
    ],
    ids=["its help", "a tool's help", "at the end", "at once"],
)
def test_a_closed_output_ends_a_command_without_a_message(code: str, unbuffered: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        ended = run_into(writing, code, unbuffered)
    finally:
        os.close(writing)
    assert ended.stderr == ""
    # argparse itself passes over an output that takes nothing.
    assert ended.returncode == (0 if unbuffered and "'health', '--help'" in code else 141)


def test_a_pipe_that_is_not_its_output_is_no_reader() -> None:
    ended = run_into(subprocess.DEVNULL, TOOL.format("(_ for _ in ()).throw(BrokenPipeError('of another'))"))
    assert ended.returncode == 1
    assert ended.stderr.endswith("BrokenPipeError: of another\n")


def test_an_interrupted_tool_says_so() -> None:
    ended = run_into(subprocess.DEVNULL, TOOL.format("(_ for _ in ()).throw(KeyboardInterrupt())"))
    assert (ended.returncode, ended.stderr) == (130, "camber health: interrupted\n")


def test_without_any_output_it_does_its_work() -> None:
    code = "import sys; sys.stdout = None\n" + TOOL.format("print('gnss: ok') or 0")
    assert run_into(subprocess.DEVNULL, code).returncode == 0
