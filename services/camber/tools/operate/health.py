"""`camber health`: query the health of a running service; for people and for container health checks."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from pydantic_settings import SettingsConfigDict

from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryFailed, check_router, query_once
from camber.runtime.settings import ServiceSettings, load_or_exit
from camber.schemas.channels import SENSORS, SERVICES
from camber.schemas.health import Health, HealthRequest
from camber.tools.options.number_options import number_from

ROUTER = "router"
_PROG = "camber health"
_HELP = """\
exit codes: 0 ok, starting or degraded (waiting for inputs, which a restart would not help); 1 failing or no answer;
2 wrong usage.
"""


def main(argv: Sequence[str]) -> int:
    """Query one service and print its health; return the exit code."""
    args = _parser().parse_args(argv)
    settings = _settings_of(args.service, args.config, args.vehicle, args.connect)
    try:
        if args.service == ROUTER:
            check_router(settings, timeout_s=args.timeout)
            print(_router_text(settings, as_json=args.json))
            return 0
        request = HealthRequest(time_ns=SystemClock().now_ns())
        health = query_once(settings, "health", request, service=args.service, timeout_s=args.timeout)
    except (BusError, QueryFailed) as error:
        text = f"{args.service}: no answer: {error}"
        silence = {"service": args.service, "status": "no_answer", "reason": str(error)}
        print(json.dumps(silence) if args.json else text)
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


def _router_text(settings: ServiceSettings, *, as_json: bool) -> str:
    if as_json:
        return json.dumps({"service": ROUTER, "status": "ok", "endpoints": settings.zenoh.connect})
    return f"{ROUTER}: ok, reached over {', '.join(settings.zenoh.connect)}"


class _Anywhere(ServiceSettings):
    """The settings common to all services; specific ones are ignored, so that no service is imported."""

    model_config = SettingsConfigDict(extra="ignore")


def _settings_of(
    service: str, config: Path | None, vehicle: str | None, connect: list[str] | None
) -> ServiceSettings:
    """Return vehicle and endpoints as given, else from environment, file and default as the service reads them."""
    cls = type("_Settings", (_Anywhere,), {"SERVICE": service, "__doc__": __doc__, "__module__": __name__})
    argv = [] if config is None else ["--config", str(config)]
    argv += [] if vehicle is None else ["--vehicle", vehicle]
    argv += [] if connect is None else ["--zenoh.connect", json.dumps(connect)]
    return load_or_exit(cls, argv, prog=_PROG)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=_PROG, description=__doc__, epilog=_HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "service",
        choices=(*SERVICES, SENSORS, ROUTER),
        metavar="SERVICE",
        help="name of the service, or router",
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the service's own settings: vehicle and endpoints"
    )
    parser.add_argument("--vehicle", metavar="V", help="name of the vehicle")
    parser.add_argument(
        "--connect", action="append", metavar="ENDPOINT", help="router to connect to; repeatable"
    )
    parser.add_argument(
        "--timeout",
        type=number_from(0.001, 60.0, "s"),
        default=3.0,
        metavar="S",
        help="seconds to wait (default 3)",
    )
    parser.add_argument(
        "--json", action="store_true", help="one JSON object with counters and texts of issues"
    )
    return parser


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
