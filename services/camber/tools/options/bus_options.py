"""How a tool joins the bus: options that all such tools have, and settings made of them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pydantic_settings import SettingsConfigDict

from camber.runtime.settings import ServiceSettings, load_or_exit


class _OfTools(ServiceSettings):
    """The settings that all services have; a service's own are skipped, so that any service's file will do."""

    SERVICE = "tools"
    model_config = SettingsConfigDict(extra="ignore")


def add_bus_options(parser: argparse._ActionsContainer) -> None:
    """`--connect`, `--config`; `--vehicle` is added where a tool has one."""
    parser.add_argument(
        "--connect", action="append", metavar="ENDPOINT", help="router to go through; repeatable"
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="settings of any service: its vehicle and [zenoh], TLS among it",
    )


def bus_settings(args: argparse.Namespace, *, prog: str, vehicle: str | None) -> ServiceSettings:
    """Command line > `CAMBER_TOOLS_…` > file > default; as a client. Ends the process where they are wrong."""
    argv = ["--zenoh.mode", "client"]
    argv += [] if args.config is None else ["--config", str(args.config)]
    argv += [] if vehicle is None else ["--vehicle", vehicle]
    argv += [] if args.connect is None else ["--zenoh.connect", json.dumps(args.connect)]
    return load_or_exit(_OfTools, argv, prog=prog)
