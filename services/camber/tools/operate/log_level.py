"""`camber log-level`: change the log level of a running service for a limited time."""

from __future__ import annotations

import argparse
import re
import sys
import typing
from collections.abc import Sequence

from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient, QueryFailed
from camber.schemas.channels import ROS2, SENSORS, SERVICES
from camber.schemas.health import LogLevel, LogLevelRequest
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS
from camber.tools.options.parsers import add_with_default, tool_parser

_CHOICES = (*SERVICES, SENSORS, ROS2)
_PROG = "camber log_level"
_UNITS_S = {"s": 1.0, "m": 60.0, "h": 3600.0}
_LONGEST_S = 86_400.0  # chosen: a forgotten debug level ends within a day


def main(argv: Sequence[str]) -> int:
    """Set the level of one service, in all its workers; 0 done, 1 no answer, 3 no connection to the bus."""
    parser = tool_parser(_PROG, __doc__)
    add = parser.add_argument
    add("service", choices=_CHOICES, metavar="SERVICE", help=", ".join(_CHOICES))
    add("level", choices=typing.get_args(LogLevel), help="lowest level that is logged")
    add("--for", dest="for_s", type=duration_s, default=600.0, metavar="T", help="90s, 10m, 2h (default 10m)")
    add("--vehicle", metavar="V", help="its name (default vehicle)")
    add_bus_options(parser)
    add_with_default(parser, "--timeout", 3.0, "seconds to wait", type=SECONDS, metavar="S")
    args = parser.parse_args(argv)
    settings = bus_settings(args, prog=_PROG, vehicle=args.vehicle)
    request = LogLevelRequest(time_ns=SystemClock().now_ns(), level=args.level, for_s=args.for_s)
    try:
        with QueryClient(settings, timeout_s=args.timeout) as client:
            replies = client.ask("log_level", request, settings.vehicle, [args.service])[args.service]
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 3
    code = 0
    for reply in replies:
        if isinstance(reply, QueryFailed):
            print(f"{_PROG}: {args.service}: no answer: {reply}", file=sys.stderr)
            code = 1
        else:
            print(f"{reply.service}: {reply.level} for {reply.for_s:g} s, was {reply.before}")
    return code


def duration_s(text: str) -> float:
    """Parse `90s`, `10m` or `2h` into seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
    value = float(match[1]) * _UNITS_S[match[2]] if match else 0.0
    if not 0.0 < value <= _LONGEST_S:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a duration as 90s, 10m or 2h, at most 24h")
    return value
