"""`camber health`: query the health of a running service; for people and for container health checks."""

from __future__ import annotations

import json
from collections.abc import Sequence

from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryFailed, check_router, query_once
from camber.schemas.channels import ROS2, SENSORS, SERVICES
from camber.schemas.health import Health, HealthRequest
from camber.tools.options.bus_options import add_bus_options, bus_settings
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default, tool_parser

ROUTER = "router"
_PROG = "camber health"
_HELP = """\
exit codes: 0 ok, starting or degraded (waiting for inputs, which a restart would not help); 1 failing or no answer;
2 wrong usage.
"""


def main(argv: Sequence[str]) -> int:
    """Query one service and print its health; return the exit code."""
    parser = tool_parser(_PROG, __doc__, _HELP)
    services, add = (*SERVICES, SENSORS, ROS2, ROUTER), parser.add_argument
    add("service", choices=services, metavar="SERVICE", help="name of the service, or router")
    add("--vehicle", metavar="V", help="name of the vehicle")
    add_bus_options(parser)
    seconds = number_from(0.001, 60.0, "s")
    add_with_default(parser, "--timeout", 3.0, "seconds to wait", type=seconds, metavar="S")
    add("--json", action="store_true", help="one JSON object with counters and texts of issues")
    args = parser.parse_args(argv)
    settings = bus_settings(args, prog=_PROG, vehicle=args.vehicle, service=args.service)
    endpoints = settings.zenoh.connect
    try:
        if args.service == ROUTER:
            check_router(settings, timeout_s=args.timeout)
            report = {"service": ROUTER, "status": "ok", "endpoints": endpoints}
            print(json.dumps(report) if args.json else f"{ROUTER}: ok, reached over {', '.join(endpoints)}")
            return 0
        request = HealthRequest(time_ns=SystemClock().now_ns())
        health = query_once(settings, "health", request, service=args.service, timeout_s=args.timeout)
    except (BusError, QueryFailed) as error:
        report = {"service": args.service, "status": "no_answer", "reason": str(error)}
        print(json.dumps(report) if args.json else f"{args.service}: no answer: {error}")
        return 1
    print(health.model_dump_json() if args.json else line(health))
    return exit_code(health)


def exit_code(health: Health) -> int:
    """Return 1 for a failing service; a degraded one waits for its inputs and needs no supervisor."""
    return 1 if health.status == "failing" else 0


def line(health: Health) -> str:
    """Return one line: status, uptime and issues, the most frequent first."""
    issues_by_count = sorted(health.issues, key=lambda issue: (-issue.count, issue.code))
    issues = ", ".join(f"{issue.code} ×{issue.count}" for issue in issues_by_count)
    status = f"{health.service}: {health.status}, version {health.version}, up {health.uptime_s:.0f} s"
    return f"{status}; {issues}" if issues else status
