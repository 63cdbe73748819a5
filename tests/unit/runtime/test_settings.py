"""Settings: command line > environment > TOML > default; what is wrong is one clear line and exit code 2."""

from __future__ import annotations

import importlib
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import BaseModel, ConfigDict, Field, SecretStr

from camber.gnss.settings import GnssSettings
from camber.runtime.settings import ServiceSettings, ZenohSettings, load, load_or_exit, to_toml
from camber.schemas.channels import SERVICES


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


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("CAMBER_")]:
        monkeypatch.delenv(name)


def toml(folder: Path, text: str) -> list[str]:
    path = folder / "camber.toml"
    path.write_text(text, "utf-8")
    return ["--config", str(path)]


def read(cls: type[ServiceSettings], argv: list[str]) -> Any:
    return load(cls, argv, prog="camber sample")[0]


def complaint(cls: type[ServiceSettings], argv: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a process would say, without its name."""
    with pytest.raises(SystemExit) as ended:
        load_or_exit(cls, argv, prog="camber sample")
    assert ended.value.code == 2
    message = capsys.readouterr()
    assert message.out == ""
    (line,) = message.err.splitlines()
    return line.removeprefix("camber sample: ")


Sources = Callable[[dict[str, str], str, list[str]], str]


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sources:
    """The complaint about an environment, the text of a file, called FILE, and arguments."""

    def result(environment: dict[str, str], text: str, argv: list[str]) -> str:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        file = toml(tmp_path, text) if text else []
        return complaint(Sample, [*file, *argv], capsys).replace(str(tmp_path / "camber.toml"), "FILE")

    return result


def test_every_level_overrules_those_below_it_for_a_plain_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read(Sample, []).width_m == 2.0
    argv = toml(tmp_path, "width_m = 3.0")
    assert read(Sample, argv).width_m == 3.0
    monkeypatch.setenv("CAMBER_SAMPLE_WIDTH_M", "4.0")
    assert read(Sample, argv).width_m == 4.0
    assert read(Sample, [*argv, "--width-m", "5.0"]).width_m == 5.0
    assert read(Sample, ["--width-m=5.0", *argv]).width_m == 5.0


def test_every_level_overrules_those_below_it_for_a_nested_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    argv = toml(tmp_path, "[inner]\nlength_m = 3.0\nname = 'file'")
    assert read(Sample, argv).inner == Inner(length_m=3.0, name="file")
    monkeypatch.setenv("CAMBER_SAMPLE_INNER__LENGTH_M", "4.0")
    assert read(Sample, argv).inner == Inner(length_m=4.0, name="file")
    assert read(Sample, [*argv, "--inner.length-m", "5.0"]).inner == Inner(length_m=5.0, name="file")
    assert read(Sample, ["--inner.name", "typed"]).inner == Inner(length_m=4.0, name="typed")


def test_the_levels_meet_in_one_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    argv = toml(tmp_path, "vehicle = 'file'\n[zenoh]\nmode = 'client'")
    monkeypatch.setenv("CAMBER_SAMPLE_ZENOH__CONNECT", '["tcp/a:1", "tcp/b:2"]')
    settings = read(Sample, [*argv, "--log-level", "debug"])
    assert (settings.vehicle, settings.log_level) == ("file", "debug")
    assert settings.zenoh == ZenohSettings(mode="client", connect=["tcp/a:1", "tcp/b:2"])


def test_a_table_that_is_optional_can_be_given_at_every_level(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read(Sample, []).start is None
    assert read(Sample, toml(tmp_path, "[start]\nlength_m = 3.0")).start == Inner(length_m=3.0)
    assert read(Sample, ["--start.length-m", "5"]).start == Inner(length_m=5.0)
    monkeypatch.setenv("CAMBER_SAMPLE_START__NAME", "four")
    assert read(Sample, []).start == Inner(name="four")


def test_a_switch_has_a_yes_and_a_no() -> None:
    assert read(Sample, ["--no-enabled"]).enabled is False
    assert read(Sample, ["--enabled"]).enabled is True


def test_the_environment_of_another_service_is_nobodys_business(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMBER_GNSS_WIDTH_M", "4.0")
    monkeypatch.setenv("CAMBER_DATA", "/recordings")
    monkeypatch.setenv("WIDTH_M", "4.0")
    assert read(Sample, []).width_m == 2.0


@pytest.mark.parametrize(
    ("environment", "text", "argv", "line"),
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
    ],
)
def test_what_is_unknown_is_named_with_its_place(
    sources: Sources, environment: dict[str, str], text: str, argv: list[str], line: str
) -> None:
    assert sources(environment, text, argv) == line


@pytest.mark.parametrize(
    ("environment", "text", "argv", "begin", "end"),
    [
        ({}, "width_m = '20 cm'", [], "FILE: width_m: Input should be a valid number", "(got '20 cm')"),
        ({}, "", ["--inner.length-m", "-1"], "inner.length_m: ", ""),
        ({}, "width_m = 3.0", ["--width-m=-1"], "width_m: ", "(got '-1')"),
        # A wrong value of the environment is not laid to a file.
        *(
            (
                {name: text},
                "width_m = 3.0\n[inner]\nlength_m = 3.0",
                [],
                f"environment: {name}: {field}: ",
                "",
            )
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
    ],
)
def test_a_wrong_value_is_named_with_its_place(
    sources: Sources, environment: dict[str, str], text: str, argv: list[str], begin: str, end: str
) -> None:
    line = sources(environment, text, argv)
    assert line.startswith(begin)
    assert line.endswith(end)


def test_a_list_on_the_command_line_that_is_not_one_is_named(sources: Sources) -> None:
    line = sources({}, "", ["--zenoh.connect", "[1"])
    assert line.startswith("command line: ")
    assert "zenoh.connect" in line


@pytest.mark.parametrize(
    ("content", "expected"), [(b"width_m = ", "not TOML"), (b"\xff", "not TOML"), (None, "No such file")]
)
def test_a_file_that_cannot_be_read_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, expected: str
) -> None:
    path = tmp_path / "camber.toml"
    if content is not None:
        path.write_bytes(content)
    message = complaint(Sample, ["--config", str(path)], capsys)
    assert message.startswith(f"{path}: ")
    assert expected in message


def test_a_folder_is_no_file_of_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert complaint(Sample, ["--config", str(tmp_path)], capsys) == f"{tmp_path}: Is a directory"


def test_check_says_that_the_settings_are_right_and_ends(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        load_or_exit(Sample, ["--check"], prog="camber sample")
    assert ended.value.code == 0
    assert capsys.readouterr() == ("", "camber sample: settings are right\n")


def test_without_check_the_settings_are_returned() -> None:
    assert load_or_exit(Sample, ["--width-m", "3"], prog="camber sample").width_m == 3.0


def test_print_config_gives_toml_that_is_read_as_the_same_settings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    before = read(Sample, argv)
    with pytest.raises(SystemExit) as ended:
        load_or_exit(Sample, [*argv, "--print-config"], prog="camber sample")
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert read(Sample, toml(tmp_path, text)) == before
    assert "width_m = 0.1  # a width, given in two lines" in text


def test_a_date_and_an_infinity_survive_being_printed(tmp_path: Path) -> None:
    gnss = read(GnssSettings, ["--nmea-date", "2023-07-11"])
    assert read(GnssSettings, toml(tmp_path, to_toml(gnss))) == gnss
    wide = read(Sample, ["--width-m", "inf"])
    assert read(Sample, toml(tmp_path, to_toml(wide))) == wide


NEEDED = {"map_server": ["--release", "/map"]}


@pytest.mark.parametrize("service", SERVICES)
def test_every_services_settings_survive_being_printed(service: str, tmp_path: Path) -> None:
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    before = read(cls, NEEDED.get(service, []))
    text = to_toml(before)
    tomllib.loads(text)
    assert read(cls, toml(tmp_path, text)) == before


@pytest.mark.parametrize("service", SERVICES)
def test_every_services_setting_is_described_and_its_environment_is_not_shared(service: str) -> None:
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    assert service == cls.SERVICE
    plain = [name for name, info in cls.model_fields.items() if not info.description and name != "zenoh"]
    assert not plain
    others = [f"CAMBER_{other.upper()}_" for other in SERVICES if other != service]
    assert not any(prefix.startswith(f"CAMBER_{service.upper()}_") for prefix in others)


def test_help_lists_every_setting_of_a_service(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        load_or_exit(GnssSettings, ["--help"], prog="camber gnss")
    assert ended.value.code == 0
    message = capsys.readouterr().out
    for name in GnssSettings.model_fields:
        assert f"--{name.replace('_', '-')}" in message


class Locked(ServiceSettings):
    """Settings with a secret."""

    SERVICE: ClassVar[str] = "locked"
    user: str | None = None
    caster_password: SecretStr | None = Field(None, description="a password")


def test_a_secret_is_read_from_the_file_and_from_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read(Locked, []).caster_password is None
    argv = toml(tmp_path, "caster_password = 'geheim'")
    assert read(Locked, argv).caster_password.get_secret_value() == "geheim"
    monkeypatch.setenv("CAMBER_LOCKED_CASTER_PASSWORD", "anders")
    assert read(Locked, argv).caster_password.get_secret_value() == "anders"


def test_a_secret_that_is_set_is_never_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = toml(tmp_path, "caster_password = 'geheim'")
    with pytest.raises(SystemExit) as ended:
        load_or_exit(Locked, [*argv, "--print-config"], prog="camber locked")
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert "geheim" not in printed
    assert '# caster_password = "****"  # a password' in printed.splitlines()
    # What was printed is read again: without the secret, not with four stars.
    assert read(Locked, toml(tmp_path, printed)).caster_password is None
    assert "geheim" not in repr(read(Locked, toml(tmp_path, "caster_password = 'geheim'")))


def test_a_secret_that_is_not_set_looks_like_any_other_setting() -> None:
    assert "# caster_password =  # a password" in to_toml(read(Locked, [])).splitlines()


@pytest.mark.parametrize(
    "argv",
    [
        ["--caster-password", "geheim"],
        ["--caster-password=geheim"],
        ["--caster_password=geheim"],
        ["--user", "driver", "--caster-password", "geheim"],
    ],
)
def test_a_secret_on_the_command_line_is_refused_and_its_variable_named(
    argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    message = complaint(Locked, argv, capsys)
    assert message.endswith(
        "not on the command line, which everyone can see; set CAMBER_LOCKED_CASTER_PASSWORD"
    )
    assert "geheim" not in message


@pytest.mark.parametrize("value", ["1234567", "['geheim', 'geheim']", "{a = 'geheim'}"])
def test_a_secret_of_a_wrong_kind_is_named_and_not_repeated(
    value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = toml(tmp_path, f"caster_password = {value}")
    message = complaint(Locked, argv, capsys)
    assert message.startswith(f"{argv[1]}: caster_password: ")
    assert "geheim" not in message
    assert "1234567" not in message


def test_the_casters_password_of_gnss_is_a_secret(capsys: pytest.CaptureFixture[str]) -> None:
    message = complaint(GnssSettings, ["--ntrip-password", "geheim"], capsys)
    assert "CAMBER_GNSS_NTRIP_PASSWORD" in message


@pytest.mark.parametrize("source", ["ntrip://driver:geheim@host:2101/BASE", "tcp:driver:geheim@host:2101"])
def test_a_password_in_an_address_is_refused_and_not_repeated(
    source: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--source", "--base-source"):
        assert "geheim" not in complaint(GnssSettings, [option, source], capsys)


def test_a_failure_rate_is_one_that_the_table_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert read(GnssSettings, ["--engine.failure-rate", "0.001"]).engine.failure_rate == 0.001
    message = complaint(GnssSettings, ["--engine.failure-rate", "0.0001"], capsys)
    assert message == "engine.failure_rate: 0.0001: expected 0 or from 0.001 to 0.01"


def test_unknown_bands_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert complaint(GnssSettings, ["--engine.gps-bands", "19"], capsys).startswith("engine: ")


def test_a_rule_of_several_settings_is_not_laid_to_a_file_that_has_not_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = toml(tmp_path, '[zenoh]\nmode = "client"')
    monkeypatch.setenv("CAMBER_SAMPLE_ZENOH__CONNECT", '["tls/a:1"]')
    assert complaint(Sample, argv, capsys).startswith("zenoh: connect: an endpoint tls/")
    monkeypatch.delenv("CAMBER_SAMPLE_ZENOH__CONNECT")
    argv = toml(tmp_path, '[zenoh]\nconnect = ["tls/a:1"]')
    assert complaint(Sample, argv, capsys).startswith(f"{argv[1]}: zenoh: connect: an endpoint tls/")
    monkeypatch.setenv("CAMBER_SAMPLE_ZENOH", '{"lease_s": 3.0}')
    argv = toml(tmp_path, '[zenoh]\nmode = "no"')
    assert complaint(Sample, argv, capsys).startswith(f"{argv[1]}: zenoh.mode: ")
