"""Options by which a tool connects to the bus, and the settings made of them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pydantic_settings import SettingsConfigDict

from camber.runtime.settings import ServiceSettings, load_or_exit


class _OfTools(ServiceSettings):
    """The settings common to all services; specific ones are ignored, so that any service's file can be used."""

    SERVICE = "tools"
    model_config = SettingsConfigDict(extra="ignore")


def add_bus_options(parser: argparse._ActionsContainer) -> None:
    """Add `--connect` and `--config`; `--vehicle` is added by tools that have one."""
    parser.add_argument(
        "--connect", action="append", metavar="ENDPOINT", help="router to connect to; repeatable"
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="settings of any service: its vehicle and [zenoh], TLS among it",
    )


def bus_settings(args: argparse.Namespace, *, prog: str, vehicle: str | None) -> ServiceSettings:
    """Return settings from command line, `CAMBER_TOOLS_…`, file and default, in client mode; exit where invalid."""
    argv = ["--zenoh.mode", "client"]
    argv += [] if args.config is None else ["--config", str(args.config)]
    argv += [] if vehicle is None else ["--vehicle", vehicle]
    argv += [] if args.connect is None else ["--zenoh.connect", json.dumps(args.connect)]
    return load_or_exit(_OfTools, argv, prog=prog)
