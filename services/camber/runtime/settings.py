"""Settings of a service: command line > environment (`CAMBER_<SERVICE>_…`) > TOML file > default."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from datetime import date
from pathlib import Path
from typing import Any, ClassVar, Literal, NoReturn, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, SecretStr, ValidationError, model_validator
from pydantic_core import ErrorDetails
from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from camber.schemas.base import Name
from camber.schemas.bounded_toml import read_toml

S = TypeVar("S", bound="ServiceSettings")


class ConfigError(ValueError):
    """A setting is unknown, missing, of a wrong kind or out of range; one clear line."""


class ZenohSettings(BaseModel):
    """How this process joins the bus."""

    model_config = ConfigDict(extra="forbid")
    mode: Literal["peer", "client", "router"] = Field("peer", description="role on the bus")
    connect: list[str] = Field(
        ["tcp/127.0.0.1:7447"], description="endpoints to join; tried again for ever when nobody is there"
    )
    listen: list[str] = Field(
        ["tcp/127.0.0.1:0"],
        description="endpoints on which other peers may reach this one; a client listens on none",
    )
    tls_ca: Path | None = Field(
        None, description="certificate of the authority; with the next two: joined over TLS, as in the cloud"
    )
    tls_certificate: Path | None = Field(
        None, description="this process's certificate; its common name is what access rules go by"
    )
    tls_key: Path | None = Field(None, description="the certificate's private key, in a file of its own")
    config_file: Path | None = Field(
        None, description="a Zenoh configuration (json5) to start from, for what has no setting here"
    )
    lease_s: float = Field(
        2.0, ge=0.5, le=60.0, description="after how long a silence others take this process to be gone"
    )

    @property
    def over_tls(self) -> bool:
        """Does this process show a certificate?"""
        return self.tls_certificate is not None

    @model_validator(mode="after")
    def _all_or_nothing_over_tls(self) -> Self:
        files = (self.tls_ca, self.tls_certificate, self.tls_key)
        encrypted = [endpoint.startswith(("tls/", "quic/")) for endpoint in self.connect]
        if any(files):
            if not all(files):
                raise ValueError("tls_ca, tls_certificate, tls_key: expected all three or none")
            if not all(encrypted):
                raise ValueError("connect: with tls_certificate expected only endpoints tls/… or quic/…")
            if self.mode != "client":
                # Peers would meet one another around the router, and so around its access rules.
                raise ValueError(f'mode: with tls_certificate expected "client", got "{self.mode}"')
        elif any(encrypted) and self.config_file is None:
            raise ValueError("connect: an endpoint tls/… or quic/… needs tls_ca, tls_certificate and tls_key")
        return self


class ServiceSettings(BaseSettings):
    """Settings of every service."""

    model_config = SettingsConfigDict(
        extra="forbid", env_nested_delimiter="__", nested_model_default_partial_update=True
    )
    SERVICE: ClassVar[str] = "service"

    vehicle: Name = Field("vehicle", description="name of the vehicle, second part of every key")
    zenoh: ZenohSettings = Field(default_factory=ZenohSettings)
    clock: Literal["system", "replay"] = Field(
        "system",
        description="system: GPS time from this machine's clock; replay: the time of the feeder's ticks",
    )
    period_s: float = Field(
        0.05, gt=0.0, le=10.0, description="longest time between two rounds of the work loop"
    )
    state_dir: Path | None = Field(None, description="where the service keeps what must survive a restart")
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="least level that is logged"
    )
    log_format: Literal["json", "text"] = Field("text", description="one JSON object a line, or for people")
    metrics_port: int | None = Field(
        None,
        ge=0,
        le=65_535,
        description="where metrics are served for Prometheus; 0: any port, unset: nowhere",
    )
    metrics_host: str = Field(
        "127.0.0.1", description="address on which metrics are served; they are not encrypted"
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """The order above; the TOML table comes as init settings, lowest."""
        env = EnvSettingsSource(settings_cls, env_prefix=_environment_prefix(cls))
        return env, init_settings


def load(cls: type[S], argv: list[str], *, prog: str) -> tuple[S, argparse.Namespace]:
    """Read the settings of `cls`, or raise ConfigError. Returns them and the flags `--check`, `--print-config`.

    A class that says `extra="ignore"` reads its part of the settings of a service, and no other class does.
    """
    flags = _Parser(prog=prog, add_help=False, allow_abbrev=False)
    flags.add_argument("--config", type=Path, metavar="FILE", help="TOML file with settings")
    flags.add_argument(
        "--check", action="store_true", help="read the settings, say whether they are right, and end"
    )
    flags.add_argument(
        "--print-config", action="store_true", help="print the settings in force as TOML, and end"
    )
    args, rest = flags.parse_known_args(argv)
    _refuse_secrets_on_the_command_line(cls, rest)
    table = _read_toml(args.config) if args.config else {}
    if cls.model_config["extra"] != "ignore":
        for name in table.keys() - cls.model_fields.keys():
            raise ConfigError(f"{args.config}: {name}: unknown setting")
        _refuse_unknown_environment(cls)
    summary = (cls.__doc__ or "").strip().splitlines()[0]
    parser = _Parser(prog=prog, parents=[flags], description=summary, allow_abbrev=False)
    # A source of its own, so that the order holds: pydantic-settings puts it above environment and file.
    source: Any = CliSettingsSource(
        cls,
        root_parser=parser,
        cli_kebab_case=True,
        cli_implicit_flags=True,
        cli_avoid_json=False,
        cli_prog_name=prog,
    )
    try:
        cli = source(args=rest)
        return cls(_cli_settings_source=cli, **table), args
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = [str(part) for part in first["loc"]]
        if first["type"] == "missing":
            place.pop()  # the table that it is missing in
        source_of = _source_of(cls, place, argv=rest, path=args.config, table=table)
        raise ConfigError(f"{source_of}{_one_line(cls, first)}") from None
    except SettingsError as error:  # a list or a table that cannot be parsed
        raise ConfigError(_not_json(error)) from None


def to_toml(settings: BaseModel) -> str:
    """The settings as TOML, each with its description."""
    lines: list[str] = []
    _emit(settings, "", lines)
    return "\n".join(lines) + "\n"


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the list of all options."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(message)


def _environment_prefix(cls: type[ServiceSettings]) -> str:
    return f"CAMBER_{cls.SERVICE.upper()}_"


def _refuse_unknown_environment(cls: type[ServiceSettings]) -> None:
    """A misspelt variable must not pass in silence; pydantic-settings looks only for those that it knows."""
    prefix = _environment_prefix(cls)
    for variable in sorted(os.environ):
        name = variable.upper().removeprefix(prefix)
        if name != variable.upper() and name.partition("__")[0].lower() not in cls.model_fields:
            raise ConfigError(f"environment: {variable}: unknown setting")


def _is_secret(cls: type[BaseModel], name: str) -> bool:
    info = cls.model_fields.get(name)
    return info is not None and SecretStr in (info.annotation, *get_args(info.annotation))


def _refuse_secrets_on_the_command_line(cls: type[ServiceSettings], argv: list[str]) -> None:
    """The list of processes shows it to everyone on the machine."""
    for argument in argv:
        option = argument.partition("=")[0]
        name = option.lstrip("-").replace("-", "_")
        if option.startswith("-") and _is_secret(cls, name):
            variable = f"{_environment_prefix(cls)}{name.upper()}"
            raise ConfigError(f"{option}: not on the command line, which everyone can see; set {variable}")


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return read_toml(path)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def _source_of(
    cls: type[ServiceSettings], place: list[str], argv: list[str], path: Path | None, table: dict[str, Any]
) -> str:
    """Where what is at a place comes from: command line before environment before file."""
    prefix, n = _environment_prefix(cls).lower(), len(place)
    options = [
        argument[2:].partition("=")[0].replace("-", "_").split(".")
        for argument in argv
        if argument.startswith("--")
    ]
    variables = {
        name: name.lower().removeprefix(prefix).split("__")
        for name in os.environ
        if name.lower().startswith(prefix)
    }
    above = any(len(at) > n and at[:n] == place for at in (*options, *variables.values()))
    if above and isinstance(_value_in(table, place), dict):
        return ""  # a rule of several settings, which come from anywhere
    if any(at == place[: len(at)] for at in options):
        return ""  # the field is called as the option is
    for name, at in sorted(variables.items(), key=lambda item: -len(item[1])):
        if at == place[: len(at)] and _is_set_in(os.environ[name], place[len(at) :]):
            return f"environment: {name}: "
    return f"{path}: " if path is not None and _value_in(table, place) is not None else ""


def _one_line(cls: type[BaseModel], first: ErrorDetails) -> str:
    field = ".".join(str(part) for part in first["loc"])
    if first["type"] == "value_error":  # a rule of ours, which says what it met
        rule = first["msg"].removeprefix("Value error, ")
        return f"{field}: {rule}" if field else rule
    if first["type"] == "extra_forbidden":
        return f"{field}: unknown setting"
    if first["type"] == "missing":
        return f"{field}: missing; this setting has no default"
    got = "" if _is_secret(cls, field) else f" (got {str(first['input'])[:60]!r})"
    return f"{field}: {first['msg']}{got}"


def _not_json(error: SettingsError) -> str:
    text = str(error).splitlines()[0]
    name = re.search(r'field "(\w+)" from source "EnvSettingsSource"', text)
    if name is None:
        return f"command line: {text}"
    return f"environment: {name[1]}: expected JSON for a list or a table: {error.__cause__}"


def _value_in(value: Any, place: list[str]) -> Any:
    """What stands at a place of nested tables, or the list that it is an item of; None: nothing."""
    for part in place:
        if not isinstance(value, dict) or part not in value:
            return value if isinstance(value, list) else None
        value = value[part]
    return value


def _is_set_in(text: str, place: list[str]) -> bool:
    """Does a variable, a table in JSON where the place is inside, have this setting?"""
    try:
        return not place or _value_in(json.loads(text), place) is not None
    except ValueError:
        return True


def _emit(model: BaseModel, prefix: str, lines: list[str]) -> None:
    tables: list[tuple[str, BaseModel]] = []
    for name, info in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            tables.append((name, value))
            continue
        comment = f"  # {' '.join(info.description.split())}" if info.description else ""
        if isinstance(value, SecretStr):
            lines.append(f'# {name} = "****"{comment}')
            continue
        lines.append(f"# {name} ={comment}" if value is None else f"{name} = {_toml(value)}{comment}")
    for name, value in tables:
        lines += ["", f"[{prefix}{name}]"]
        _emit(value, f"{prefix}{name}.", lines)


def _toml(value: Any) -> str:
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, date | float):  # 2023-07-11, 0.05, 1e-09, inf
        return str(value)
    # Strings, integers and booleans read alike in JSON and TOML, but for one character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def load_or_exit(cls: type[S], argv: list[str], *, prog: str) -> S:
    """`load`, with `--check` and `--print-config` carried out; ends the process where the settings say so."""
    try:
        settings, args = load(cls, argv, prog=prog)
    except ConfigError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    if args.print_config:
        print(to_toml(settings), end="")
    if args.check:
        print(f"{prog}: settings are right", file=sys.stderr)
    if args.print_config or args.check:
        raise SystemExit(0)
    return settings
