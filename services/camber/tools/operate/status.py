"""`camber status`: services on the bus, rates and ages of channels, queues, and the last issue of each service.

Each service's work loop answers the query: a service that is frozen or unreachable is *not answering*, even if its
liveliness token is present.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from typing import Any

from pydantic import TypeAdapter, ValidationError

from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.schemas.base import Name
from camber.schemas.channels import FEEDER, SERVICES, VEHICLE_SERVICES
from camber.schemas.health import HealthRequest
from camber.tools.operate.status_table import as_text, fleet_text
from camber.tools.operate.status_view import Answers, StatusView, view_of
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS
from camber.tools.options.parsers import add_with_default, tool_parser

FLEET = "fleet"
_PROG = "camber status"
_NAME: TypeAdapter[str] = TypeAdapter(Name)
_OF_FLEET = tuple(name for name in SERVICES if name not in VEHICLE_SERVICES)
_NO_SERVICES = frozenset({FEEDER, "vehicle", "player"})  # they have a liveliness token but no work loop
_HELP = """\
exit codes: 0 all services are ok; 4 all answer, but one is starting, degraded (waits for inputs) or receives nothing on
a channel that others receive; 1 one is failing or not answering; 2 wrong usage; 3 no connection to the bus. With
--watch, the code of the last query.
"""


def main(argv: Sequence[str]) -> int:
    """Query once or repeatedly; return the exit code."""
    args = _parser().parse_args(argv)
    settings = bus_settings(args, prog=_PROG, vehicle=FLEET if args.fleet else args.vehicle)
    code = 0
    try:
        with QueryClient(settings, timeout_s=args.timeout) as client:
            while True:
                code = _query_and_print(client, settings.vehicle, args)
                if args.watch is None:
                    return code
                time.sleep(max(args.watch - args.over, 0.0))
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        return code


def _query_and_print(client: QueryClient, vehicle: str, args: argparse.Namespace) -> int:
    everyone = client.alive("*") if args.fleet else client.alive(vehicle)
    alive = everyone.get(vehicle, frozenset())
    view = query_view(client, vehicle, alive=alive, over_s=args.over, only=args.service, expected=args.expect)
    vehicles = {name: services for name, services in everyone.items() if name != FLEET}
    if args.json:
        content = view.as_json()
        if args.fleet:
            content["vehicles"] = {name: sorted(services) for name, services in sorted(vehicles.items())}
        print(json.dumps(content), flush=True)
        return view.exit_code
    if args.watch is not None and sys.stdout.isatty():
        print("\x1b[2J\x1b[H", end="")
    text = as_text(view, SystemClock().now_ns())
    print(f"{text}\n\n{fleet_text(vehicles)}" if args.fleet else text, flush=True)
    return view.exit_code


def query_view(
    client: QueryClient,
    vehicle: str,
    *,
    alive: frozenset[str],
    over_s: float,
    only: Sequence[str] | None = None,
    expected: Sequence[str] = (),
) -> StatusView:
    """Query all services twice, `over_s` apart; the rates come from the difference of their counters."""
    usual = only or (_OF_FLEET if vehicle == FLEET else VEHICLE_SERVICES)
    listed = dict.fromkeys((*usual, *expected))
    others = () if only else sorted(alive - set(listed) - _NO_SERVICES)
    services = (*listed, *others)
    before = _ask(client, vehicle, services)
    time.sleep(over_s)
    return view_of(vehicle, _ask(client, vehicle, services), before, alive)


def _ask(client: QueryClient, vehicle: str, services: Sequence[str]) -> Answers:
    return client.ask("health", HealthRequest(time_ns=SystemClock().now_ns()), vehicle, services)


def _service(text: str) -> str:
    try:
        return _NAME.validate_python(text)
    except ValidationError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected the name of a service") from None


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__, _HELP)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--vehicle", metavar="V", help="name of the vehicle (default: that of --config)")
    which.add_argument("--fleet", action="store_true", help="services of the cloud, and the vehicles there")
    for name, default, text in (
        ("--service", None, "only this service; repeatable (default: all of a vehicle)"),
        ("--expect", [], "expect this service too, such as sensors; repeatable"),
    ):
        parser.add_argument(name, action="append", type=_service, default=default, metavar="S", help=text)
    add_bus_options(parser)
    seconds: dict[str, Any] = {"type": SECONDS, "metavar": "S"}
    add_with_default(parser, "--timeout", 2.0, "seconds to wait", **seconds)
    add_with_default(parser, "--over", 1.0, "seconds over which rates are measured", **seconds)
    parser.add_argument("--watch", nargs="?", const=5.0, help="repeat every S seconds (default 5)", **seconds)
    parser.add_argument(
        "--json", action="store_true", help="one JSON object per query, with all health reports"
    )
    return parser
