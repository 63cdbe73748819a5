"""`camber status`: who is alive on the bus, what goes over each channel, what waits, and what was met last.

Every service is asked itself, and its work loop answers: one that is frozen, or that nobody can reach, is *not
answering*, whatever it may have declared.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence

from pydantic import TypeAdapter, ValidationError

from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.schemas.base import Name
from camber.schemas.channels import FEEDER, SERVICES, VEHICLE_SERVICES
from camber.schemas.health import HealthRequest
from camber.tools.operate.status_table import as_text, fleet_text
from camber.tools.operate.status_view import Answers, View, view_of
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS

FLEET = "fleet"
_PROG = "camber status"
_NAME: TypeAdapter[str] = TypeAdapter(Name)
_OF_FLEET = tuple(name for name in SERVICES if name not in VEHICLE_SERVICES)
_NO_SERVICES = frozenset(
    {FEEDER, "vehicle", "player"}
)  # they declare themselves, and have no work loop to ask
_HELP = """\
exit codes: 0 all services are well; 4 all answer, and one waits for its inputs (degraded), is deaf to one that others
hear, or is starting; 1 one is failing or not answering; 2 wrong usage; 3 the bus cannot be joined. With --watch that of
the last look.
"""


def main(argv: Sequence[str]) -> int:
    """Look once, or again and again; returns the exit code."""
    args = _parser().parse_args(argv)
    settings = bus_settings(args, prog=_PROG, vehicle=FLEET if args.fleet else args.vehicle)
    code = 0
    try:
        with QueryClient(settings, timeout_s=args.timeout) as asker:
            while True:
                code = _look(asker, settings.vehicle, args)
                if args.watch is None:
                    return code
                time.sleep(max(args.watch - args.over, 0.0))
    except BusError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        return code


def _look(asker: QueryClient, vehicle: str, args: argparse.Namespace) -> int:
    everyone = asker.alive("*") if args.fleet else asker.alive(vehicle)
    alive = everyone.get(vehicle, frozenset())
    view = look(asker, vehicle, args.service, alive, args.over, args.expect)
    vehicles = {name: services for name, services in everyone.items() if name != FLEET}
    if args.json:
        found = view.as_json()
        if args.fleet:
            found["vehicles"] = {name: sorted(services) for name, services in sorted(vehicles.items())}
        print(json.dumps(found), flush=True)
    else:
        if args.watch is not None and sys.stdout.isatty():
            print("\x1b[2J\x1b[H", end="")
        text = as_text(view, SystemClock().now_ns())
        print(f"{text}\n\n{fleet_text(vehicles)}" if args.fleet else text, flush=True)
    return view.exit_code


def look(
    asker: QueryClient,
    vehicle: str,
    wanted: Sequence[str] | None,
    alive: frozenset[str],
    over_s: float,
    more: Sequence[str] = (),
) -> View:
    """Ask all services twice, `over_s` apart: from what they counted meanwhile come the rates."""
    expected = dict.fromkeys((*(wanted or (_OF_FLEET if vehicle == FLEET else VEHICLE_SERVICES)), *more))
    others = () if wanted else tuple(sorted(alive - set(expected) - _NO_SERVICES))
    services = (*expected, *others)
    before = _ask(asker, vehicle, services)
    time.sleep(over_s)
    return view_of(vehicle, _ask(asker, vehicle, services), before, alive)


def _ask(asker: QueryClient, vehicle: str, services: Sequence[str]) -> Answers:
    return asker.ask("health", HealthRequest(time_ns=SystemClock().now_ns()), vehicle, services)


def _service(text: str) -> str:
    try:
        return _NAME.validate_python(text)
    except ValidationError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected the name of a service") from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=_PROG, description=__doc__, epilog=_HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--vehicle", metavar="V", help="name of the vehicle (default: that of --config)")
    which.add_argument(
        "--fleet", action="store_true", help="the services of the cloud, and the vehicles there"
    )
    parser.add_argument(
        "--service",
        action="append",
        type=_service,
        metavar="S",
        help="only this one; repeatable (default: all that there should be)",
    )
    parser.add_argument(
        "--expect",
        action="append",
        type=_service,
        default=[],
        metavar="S",
        help="this one should be there too, as sensors in some vehicles; repeatable",
    )
    add_bus_options(parser)
    parser.add_argument(
        "--timeout", type=SECONDS, default=2.0, metavar="S", help="seconds to wait (default 2)"
    )
    parser.add_argument(
        "--over", type=SECONDS, default=1.0, metavar="S", help="for rates: seconds (default 1)"
    )
    parser.add_argument(
        "--watch",
        nargs="?",
        type=SECONDS,
        const=5.0,
        metavar="S",
        help="again every so many seconds (default 5)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a look, with all that was said")
    return parser


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
