"""Options by which a tool connects to the bus, and the settings made of them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from pydantic_settings import SettingsConfigDict

from camber.runtime.settings import ServiceSettings, load_or_exit


class _OfTools(ServiceSettings):
    """The settings common to all services; specific ones are ignored, so that any service's file can be used."""

    SERVICE = "tools"
    model_config = SettingsConfigDict(extra="ignore")


def add_bus_options(parser: argparse._ActionsContainer) -> None:
    """Add `--connect` and `--config`; `--vehicle` is added by tools that have one."""
    add = parser.add_argument
    add("--connect", action="append", metavar="ENDPOINT", help="router to connect to; repeatable")
    text = "settings of any service: its vehicle and [zenoh], TLS among it"
    add("--config", type=Path, metavar="FILE", help=text)


def bus_settings(
    args: argparse.Namespace, *, prog: str, vehicle: str | None, service: str | None = None
) -> ServiceSettings:
    """Return settings from command line, environment, file and default; exit where invalid.

    The environment is `CAMBER_TOOLS_…` in client mode, or that of a `service`, in its mode.
    """
    cls: Any = _OfTools
    argv = ["--zenoh.mode", "client"]
    if service is not None:
        cls = type(
            "_OfService",
            (_OfTools,),
            {"SERVICE": service, "__doc__": _OfTools.__doc__, "__module__": __name__},
        )
        argv = []
    argv += [] if args.config is None else ["--config", str(args.config)]
    argv += [] if vehicle is None else ["--vehicle", vehicle]
    argv += [] if args.connect is None else ["--zenoh.connect", json.dumps(args.connect)]
    settings: ServiceSettings = load_or_exit(cls, argv, prog=prog)
    return settings
