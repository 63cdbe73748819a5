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
from camber.schemas.health import Health, HealthRequest
from camber.tools.operate.status_view import Answers, ChannelRow, ServiceRow, StatusView, last_issue, view_of
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import SECONDS
from camber.tools.options.parsers import add_with_default, tool_parser

FLEET = "fleet"
_PROG = "camber status"
_NAME: TypeAdapter[str] = TypeAdapter(Name)
_OF_FLEET = tuple(name for name in SERVICES if name not in VEHICLE_SERVICES)
_NO_SERVICES = frozenset({FEEDER, "vehicle", "player"})  # they have a liveliness token but no work loop
_WAITING = ("fixes_waiting", "uploads_not_stored", "uploads_waiting", "queue_waiting")
_UNITS = ((1.0, "ms", 1e-3), (120.0, "s", 1.0), (7200.0, "min", 60.0), (172_800.0, "h", 3600.0))
"""Limit up to which a unit is used, and its size [s]; chosen: at most three digits."""
_MOST_TEXT = 70  # chosen: a row fits a wide terminal
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


def as_text(view: StatusView, now_ns: int) -> str:
    """Return the table of services, the table of channels, and notes."""
    name = "the cloud" if view.vehicle == "fleet" else f"vehicle {view.vehicle}"
    parts = [name, *_services(view.services, now_ns), "", *_channels(view.channels)]
    return "\n".join([*parts, *(["", *view.notes] if view.notes else [])])


def fleet_text(vehicles: dict[str, frozenset[str]]) -> str:
    """Return the vehicles of the fleet that are on the bus."""
    if not vehicles:
        return "no vehicle is on this bus"
    rows = [(name, ", ".join(sorted(services))) for name, services in sorted(vehicles.items())]
    return "\n".join(_table([("vehicle", "services"), *rows]))


def duration(seconds: float) -> str:
    """Return a duration with two digits in a suitable unit."""
    for limit_s, unit, size in _UNITS:
        if seconds < limit_s:
            return f"{seconds / size:.2g} {unit}" if seconds < 10.0 * size else f"{seconds / size:.0f} {unit}"
    return f"{seconds / 86_400.0:.0f} d"


def _services(rows: Sequence[ServiceRow], now_ns: int) -> list[str]:
    head = ("service", "state", "up", "version", "memory", "lag", "waiting", "map", "last issue")
    cells = [("",) * 6 + (row.why,) if row.health is None else _cells(row.health, now_ns) for row in rows]
    return _table([head, *((row.service, row.state, *rest) for row, rest in zip(rows, cells, strict=True))])


def _cells(health: Health, now_ns: int) -> tuple[str, ...]:
    gauges = health.gauges
    memory, lag_s = gauges.get("memory_bytes"), gauges.get("loop_lag_s")
    waiting = sum(use.waiting for use in health.channels) + sum(gauges.get(name, 0.0) for name in _WAITING)
    return (
        duration(health.uptime_s),
        health.version,
        "" if memory is None else f"{memory / 1e6:.0f} MB",
        "" if lag_s is None else duration(lag_s),
        f"{waiting:.0f}",
        health.facts.get("map_release", ""),
        _last_issue(health, now_ns),
    )


def _last_issue(health: Health, now_ns: int) -> str:
    issue = last_issue(health)
    if issue is None:
        return ""
    ago = duration(max(now_ns - (issue.last_time_ns or now_ns), 0) / 1e9)
    text = f"{issue.code} ×{issue.count}, {ago} ago"
    detail = " ".join(issue.text.split())[:_MOST_TEXT]
    return f"{text}: {detail}" if detail else text


def _channels(rows: Sequence[ChannelRow]) -> list[str]:
    table = [("channel", "from", "to", "Hz", "of", "age", "waiting", "refused")]
    for row in rows:
        refused = ", ".join(f"{count} {reason}" for reason, count in sorted(row.refused.items()) if count)
        age = "never" if row.age_s is None else duration(row.age_s)
        table.append(
            (
                row.channel,
                ", ".join(sorted(row.producers)),
                ", ".join(sorted(row.received_s_ago)),
                "" if row.rate_hz is None else f"{row.rate_hz:.1f}",
                "" if row.table_rate_hz is None else f"{row.table_rate_hz:g}",
                f"{age}, late" if row.late else age,
                f"{row.waiting}",
                refused,
            )
        )
    return _table(table)


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


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
    add = parser.add_argument
    many: dict[str, Any] = {"action": "append", "type": _service, "metavar": "S"}
    add("--service", help="only this service; repeatable (default: all of a vehicle)", **many)
    add("--expect", default=[], help="expect this service too, such as sensors; repeatable", **many)
    add_bus_options(parser)
    seconds: dict[str, Any] = {"type": SECONDS, "metavar": "S"}
    add_with_default(parser, "--timeout", 2.0, "seconds to wait", **seconds)
    add_with_default(parser, "--over", 1.0, "seconds over which rates are measured", **seconds)
    add("--watch", nargs="?", const=5.0, help="repeat every S seconds (default 5)", **seconds)
    add("--json", action="store_true", help="one JSON object per query, with all health reports")
    return parser
