"""Settings: command line > environment > TOML > default; what is wrong is one clear line and exit code 2."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import BaseModel, ConfigDict, Field, SecretStr

from camber.gnss.settings import GnssSettings
from camber.runtime.settings import ServiceSettings, ZenohSettings, load_or_exit, to_toml
from camber.schemas.channels import SERVICES

PROG = "camber sample"


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")
    length_m: float = Field(1.0, gt=0.0, description="a length")
    name: str = "inner"


class Sample(ServiceSettings):
    """Settings to try."""

    SERVICE: ClassVar[str] = "sample"
    width_m: float = Field(2.0, gt=0.0, description="a width,\ngiven in two lines")
    enabled: bool = True
    folder: Path | None = None
    inner: Inner = Field(default_factory=Inner)
    start: Inner | None = None


class Locked(ServiceSettings):
    """Settings with a secret."""

    SERVICE: ClassVar[str] = "locked"
    user: str | None = None
    caster_password: SecretStr | None = Field(None, description="a password")


Kind = type[ServiceSettings]


class Process:
    """Reads settings of a file, the environment and arguments as a service does when it starts."""

    def __init__(
        self, folder: Path, environment: pytest.MonkeyPatch, output: pytest.CaptureFixture[str]
    ) -> None:
        self.file = folder / "camber.toml"
        self.environment, self.output = environment, output

    def settings(self, cls: Kind, *argv: str, text: str = "", environ: Mapping[str, str] = {}) -> Any:
        for name, value in environ.items():
            self.environment.setenv(name, value)
        if text:
            self.file.write_text(text, "utf-8")
        return load_or_exit(cls, [*(["--config", str(self.file)] if text else []), *argv], prog=PROG)

    def printed(self, cls: Kind, *argv: str, code: int = 0, **sources: Any) -> tuple[str, str]:
        """What it prints where it ends with this exit code instead."""
        with pytest.raises(SystemExit) as ended:
            self.settings(cls, *argv, **sources)
        assert ended.value.code == code
        return self.output.readouterr()

    def complaint(self, cls: Kind, *argv: str, **sources: Any) -> str:
        """The one line that it says, without its name; the file of settings is called FILE."""
        out, err = self.printed(cls, *argv, code=2, **sources)
        assert out == ""
        (line,) = err.splitlines()
        return line.removeprefix(f"{PROG}: ").replace(str(self.file), "FILE")


@pytest.fixture
def process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Process:
    for name in [name for name in os.environ if name.startswith("CAMBER_")]:
        monkeypatch.delenv(name)
    return Process(tmp_path, monkeypatch, capsys)


FILE, NESTED = "width_m = 3.0", "[inner]\nlength_m = 3.0\nname = 'file'"
WIDTH, LENGTH = {"CAMBER_SAMPLE_WIDTH_M": "4.0"}, {"CAMBER_SAMPLE_INNER__LENGTH_M": "4.0"}


@pytest.mark.parametrize(
    ("text", "environ", "argv", "expected"),
    [
        ("", {}, "", {"width_m": 2.0, "start": None}),
        (FILE, {}, "", {"width_m": 3.0}),
        (FILE, WIDTH, "", {"width_m": 4.0}),
        (FILE, WIDTH, "--width-m 5.0", {"width_m": 5.0}),
        (FILE, WIDTH, "--width-m=5.0", {"width_m": 5.0}),
        (NESTED, {}, "", {"inner": Inner(length_m=3.0, name="file")}),
        (NESTED, LENGTH, "", {"inner": Inner(length_m=4.0, name="file")}),
        (NESTED, LENGTH, "--inner.length-m 5.0", {"inner": Inner(length_m=5.0, name="file")}),
        ("", LENGTH, "--inner.name typed", {"inner": Inner(length_m=4.0, name="typed")}),
        ("[start]\nlength_m = 3.0", {}, "", {"start": Inner(length_m=3.0)}),
        ("", {"CAMBER_SAMPLE_START__NAME": "four"}, "", {"start": Inner(name="four")}),
        ("", {}, "--start.length-m 5", {"start": Inner(length_m=5.0)}),
        ("", {}, "--no-enabled", {"enabled": False}),
        ("", {}, "--enabled", {"enabled": True}),
        # Variables of another service, and those without a service.
        (
            "",
            {"CAMBER_GNSS_WIDTH_M": "4.0", "CAMBER_DATA": "/recordings", "WIDTH_M": "4.0"},
            "",
            {"width_m": 2.0},
        ),
        (
            "vehicle = 'file'\n[zenoh]\nmode = 'client'",
            {"CAMBER_SAMPLE_ZENOH__CONNECT": '["tcp/a:1", "tcp/b:2"]'},
            "--log-level debug",
            {
                "vehicle": "file",
                "log_level": "debug",
                "zenoh": ZenohSettings(mode="client", connect=["tcp/a:1", "tcp/b:2"]),
            },
        ),
    ],
)
def test_every_level_overrules_those_below_it(
    process: Process, text: str, environ: dict[str, str], argv: str, expected: dict[str, Any]
) -> None:
    settings = process.settings(Sample, *argv.split(), text=text, environ=environ)
    assert {name: getattr(settings, name) for name in expected} == expected


@pytest.mark.parametrize(
    ("environ", "text", "argv", "line"),
    [
        ({}, "widht_m = 3.0", [], "FILE: widht_m: unknown setting"),
        ({}, "[inner]\nlenght_m = 3.0", [], "FILE: inner.lenght_m: unknown setting"),
        ({}, "_cli_settings_source = 1", [], "FILE: _cli_settings_source: unknown setting"),
        ({}, "", ["--widht-m", "3"], "unrecognized arguments: --widht-m 3"),
        ({}, "", ["--width", "3"], "unrecognized arguments: --width 3"),  # nor abbreviated
        ({}, "", ["--config"], "argument --config: expected one argument"),
        *(
            ({name: "3.0"}, "", [], f"environment: {name}: {field}unknown setting")
            for name, field in {
                "CAMBER_SAMPLE_WIDHT_M": "",
                "CAMBER_SAMPLE_INER__LENGTH_M": "",
                "CAMBER_SAMPLE_INNER__LENGHT_M": "inner.lenght_m: ",
            }.items()
        ),
        ({}, "", ["--config", "/nowhere/x.toml"], "/nowhere/x.toml: No such file or directory"),
        ({}, "", ["--config", "/"], "/: not a plain file"),
    ],
)
def test_what_is_unknown_is_named_with_its_place(
    process: Process, environ: dict[str, str], text: str, argv: list[str], line: str
) -> None:
    assert process.complaint(Sample, *argv, text=text, environ=environ) == line


@pytest.mark.parametrize(
    ("environ", "text", "argv", "begin", "end"),
    [
        ({}, "width_m = '20 cm'", [], "FILE: width_m: Input should be a valid number", "(got '20 cm')"),
        ({}, "", ["--inner.length-m", "-1"], "inner.length_m: ", ""),
        ({}, FILE, ["--width-m=-1"], "width_m: ", "(got '-1')"),
        ({}, "width_m = ", [], "FILE: not TOML: ", ""),
        # A wrong value of the environment is not laid to a file.
        *(
            ({name: text}, f"{FILE}\n{NESTED}", [], f"environment: {name}: {field}: ", "")
            for name, text, field in (
                ("CAMBER_SAMPLE_WIDTH_M", "wide", "width_m"),
                ("CAMBER_SAMPLE_INNER__LENGTH_M", "long", "inner.length_m"),
                ("camber_sample_inner", '{"length_m": "long"}', "inner.length_m"),
            )
        ),
        *(
            ({name: "[tcp/a:1"}, "", [], "environment: zenoh: expected JSON for a list or a table", "")
            for name in ("CAMBER_SAMPLE_ZENOH", "CAMBER_SAMPLE_ZENOH__CONNECT")
        ),
        # The name of a vehicle is a part of a key.
        *(({}, "", ["--vehicle", name], "vehicle: ", "") for name in ("", "a/b", "*", "a b", "v" * 65)),
        # A rule of several settings is laid to a file only where that has all of them.
        (
            {"CAMBER_SAMPLE_ZENOH__CONNECT": '["tls/a:1"]'},
            '[zenoh]\nmode = "client"',
            [],
            "zenoh: connect: an endpoint tls/",
            "",
        ),
        ({}, '[zenoh]\nconnect = ["tls/a:1"]', [], "FILE: zenoh: connect: an endpoint tls/", ""),
        ({"CAMBER_SAMPLE_ZENOH": '{"lease_s": 3.0}'}, '[zenoh]\nmode = "no"', [], "FILE: zenoh.mode: ", ""),
    ],
)
def test_a_wrong_value_is_named_with_its_place(
    process: Process, environ: dict[str, str], text: str, argv: list[str], begin: str, end: str
) -> None:
    line = process.complaint(Sample, *argv, text=text, environ=environ)
    assert line.startswith(begin)
    assert line.endswith(end)


def test_a_list_on_the_command_line_that_is_not_one_is_named(process: Process) -> None:
    line = process.complaint(Sample, "--zenoh.connect", "[1")
    assert line.startswith("command line: ")
    assert "zenoh.connect" in line


def test_a_file_that_is_no_text_is_named(process: Process) -> None:
    process.file.write_bytes(b"\xff")
    assert process.complaint(Sample, "--config", str(process.file)).startswith("FILE: not TOML")


def test_check_says_that_the_settings_are_right_and_ends(process: Process) -> None:
    assert process.printed(Sample, "--check") == ("", f"{PROG}: settings are right\n")


def test_print_config_gives_toml_that_is_read_as_the_same_settings(process: Process) -> None:
    argv = [
        "--width-m",
        "0.1",
        "--folder",
        "/tmp/ü\x7f😀\"'\\",
        "--inner.name",
        "日本",
        "--start.length-m",
        "1e-9",
    ]
    before = process.settings(Sample, *argv)
    text, _ = process.printed(Sample, *argv, "--print-config")
    assert process.settings(Sample, text=text) == before
    assert "width_m = 0.1  # a width, given in two lines" in text


NEEDED = {"map_server": ["--release", "/map"]}
CLASSES = {name: importlib.import_module(f"camber.{name}.service").SERVICE.SETTINGS for name in SERVICES}


@pytest.mark.parametrize(
    ("cls", "argv"),
    [
        (GnssSettings, ["--nmea-date", "2023-07-11"]),
        (Sample, ["--width-m", "inf"]),
        *((cls, NEEDED.get(service, [])) for service, cls in CLASSES.items()),
    ],
)
def test_settings_survive_being_printed(process: Process, cls: Kind, argv: list[str]) -> None:
    before = process.settings(cls, *argv)
    assert process.settings(cls, text=to_toml(before)) == before


@pytest.mark.parametrize("service", SERVICES)
def test_every_services_setting_is_described_and_its_environment_is_not_shared(service: str) -> None:
    cls = CLASSES[service]
    assert service == cls.SERVICE
    plain = [name for name, info in cls.model_fields.items() if not info.description and name != "zenoh"]
    assert not plain
    others = [f"CAMBER_{other.upper()}_" for other in SERVICES if other != service]
    assert not any(prefix.startswith(f"CAMBER_{service.upper()}_") for prefix in others)


def test_help_lists_every_setting_of_a_service(process: Process) -> None:
    message, _ = process.printed(GnssSettings, "--help")
    for name in GnssSettings.model_fields:
        assert f"--{name.replace('_', '-')}" in message


SECRET = "caster_password = 'geheim'"


def test_a_secret_is_read_from_the_file_and_from_the_environment(process: Process) -> None:
    assert process.settings(Locked).caster_password is None
    read = process.settings(Locked, text=SECRET)
    assert read.caster_password.get_secret_value() == "geheim"
    assert "geheim" not in repr(read)
    read = process.settings(Locked, text=SECRET, environ={"CAMBER_LOCKED_CASTER_PASSWORD": "anders"})
    assert read.caster_password.get_secret_value() == "anders"


def test_a_secret_that_is_set_is_never_printed(process: Process) -> None:
    printed, _ = process.printed(Locked, "--print-config", text=SECRET)
    assert "geheim" not in printed
    assert '# caster_password = "****"  # a password' in printed.splitlines()
    # What was printed is read again: without the secret, not with four stars.
    assert process.settings(Locked, text=printed).caster_password is None


def test_a_secret_that_is_not_set_looks_like_any_other_setting(process: Process) -> None:
    assert "# caster_password =  # a password" in to_toml(process.settings(Locked)).splitlines()


@pytest.mark.parametrize(
    ("cls", "argv", "variable"),
    [
        (Locked, "--caster-password geheim", "CAMBER_LOCKED_CASTER_PASSWORD"),
        (Locked, "--caster-password=geheim", "CAMBER_LOCKED_CASTER_PASSWORD"),
        (Locked, "--caster_password=geheim", "CAMBER_LOCKED_CASTER_PASSWORD"),
        (Locked, "--user driver --caster-password geheim", "CAMBER_LOCKED_CASTER_PASSWORD"),
        (GnssSettings, "--ntrip-password geheim", "CAMBER_GNSS_NTRIP_PASSWORD"),
    ],
)
def test_a_secret_on_the_command_line_is_refused_and_its_variable_named(
    process: Process, cls: Kind, argv: str, variable: str
) -> None:
    message = process.complaint(cls, *argv.split())
    assert message.endswith(f"not on the command line, which everyone can see; set {variable}")
    assert "geheim" not in message


@pytest.mark.parametrize("value", ["1234567", "['geheim', 'geheim']", "{a = 'geheim'}"])
def test_a_secret_of_a_wrong_kind_is_named_and_not_repeated(process: Process, value: str) -> None:
    message = process.complaint(Locked, text=f"caster_password = {value}")
    assert message.startswith("FILE: caster_password: ")
    assert "geheim" not in message
    assert "1234567" not in message


@pytest.mark.parametrize("source", ["ntrip://driver:geheim@host:2101/BASE", "tcp:driver:geheim@host:2101"])
@pytest.mark.parametrize("option", ["--source", "--base-source"])
def test_a_password_in_an_address_is_refused_and_not_repeated(
    process: Process, option: str, source: str
) -> None:
    assert "geheim" not in process.complaint(GnssSettings, option, source)


def test_a_failure_rate_is_one_that_the_table_has(process: Process) -> None:
    assert process.settings(GnssSettings, "--engine.failure-rate", "0.001").engine.failure_rate == 0.001
    message = process.complaint(GnssSettings, "--engine.failure-rate", "0.0001")
    assert message == "engine.failure_rate: 0.0001: expected 0 or from 0.001 to 0.01"


def test_unknown_bands_are_refused(process: Process) -> None:
    assert process.complaint(GnssSettings, "--engine.gps-bands", "19").startswith("engine: ")
