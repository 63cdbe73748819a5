"""`camber`: one command, a subcommand per service and per tool."""

from __future__ import annotations

import importlib
import os
import select
import signal
import sys

SERVICES = {
    "gnss": "receivers and their files → tentative positions",
    "map_server": "map release → road elevation, links, tiles",
    "localizer": "motion, sweeps, map, confirmed positions → approximate pose with the road under it",
    "antenna_height": "fixed value, suspension, ranging, scan matches → height of the antenna above the road",
    "integrity": "everything above → verdict, position with its bounds, uploads",
    "map_update": "uploads of a fleet → stored, each once",
    "sensors": "a LiDAR's packets and a CAN bus, live or recorded → sweeps and motion",
}
TOOLS = {
    "router": ("camber.runtime.router", "a Zenoh router in Python"),
    "replay": ("camber.replay.command", "run a recorded drive through all processes"),
    "simulate": ("camber.tools.simulate", "make a drive or a fleet from a scenario, with truth"),
    "localize": ("camber.tools.localize.command", "a drive through the localizer alone, with plots"),
    "calibrate": (
        "camber.tools.calibrate.command",
        "lever arm, antenna height, base offset from a recorded drive",
    ),
    "demo": ("camber.tools.demo", "simulate two minutes through a city and replay them"),
    "feed": ("camber.tools.record.feed", "a recorded drive, live, to services that are running"),
    "lab": (
        "camber.validation.lab.command",
        "the judge against millions of simulated wrong fixes and faults",
    ),
    "evaluate": ("camber.validation.evaluate", "summary and report anew from a replay's folder"),
    "evidence": (
        "camber.validation.evidence.command",
        "recorded and simulated drives, and the page of what came of them",
    ),
    "map": ("camber.tools.maps.command", "releases of the map: build, inspect, compare, give away"),
    "certs": (
        "camber.tools.security.certs",
        "certificates: an authority, one for each vehicle, who and until when",
    ),
    "access": ("camber.tools.security.access", "who may say what: configurations of routers, checked"),
    "upload": (
        "camber.tools.operate.upload",
        "observations of road heights in a file → the fleet's store, acknowledged",
    ),
    "uploads": ("camber.tools.operate.uploads", "what the fleet's store holds, as CSV"),
    "health": ("camber.tools.operate.health", "ask a running service how it is"),
    "doctor": (
        "camber.tools.operate.doctor",
        "is this deployment fit to drive: settings, clock, disk, map, receiver",
    ),
    "record": ("camber.tools.record.record", "what is on a vehicle's bus into MCAP files"),
    "play": ("camber.tools.record.play", "a recording back onto a bus"),
    "log_level": ("camber.tools.operate.log_level", "a running service logs more for a while"),
    "status": (
        "camber.tools.operate.status",
        "who is alive on the bus, rates, ages, queues, versions, last errors",
    ),
}
GNSS_TOOLS = {
    "inspect": ("camber.tools.gnss.inspect", "what a recording of satellite navigation holds"),
    "solve": ("camber.tools.gnss.solve", "positions from a recording's raw observations, and a plot"),
}

EXTRA_OF = {
    "asyncpg": "fleet",
    "hatanaka": "engine",
    "laspy": "map",
    "nanoarrow": "map",
    "nats": "fleet",
    "numba": "engine",
    "open3d": "map",
    "pyproj": "map",
    "rasterio": "map",
    "small_gicp": "localizer",
}
"""Packages that not every service needs, and the extra of the distribution that brings them."""


def main(argv: list[str] | None = None) -> int:
    """Dispatch to a service or a tool; returns the exit code: 130 interrupted, 141 whoever reads has gone."""
    args = sys.argv[1:] if argv is None else argv
    try:
        try:
            return _dispatch(args)
        finally:
            print(end="", flush=True)  # here, where it can be caught
    except BrokenPipeError:
        output = select.poll()
        output.register(sys.stdout, 0)
        if not output.poll(0):  # it was another pipe
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt:
        print(f"{' '.join(['camber', *args[:1]])}: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT


def _dispatch(args: list[str]) -> int:
    if not args or args[0] in ("-h", "--help", "help"):
        print(_help())
        return 0
    name, rest = args[0].replace("-", "_"), args[1:]
    try:
        if name in SERVICES:
            return _run_service(name, rest)
        if name in TOOLS:
            return _run_tool(TOOLS[name][0], rest)
    except ModuleNotFoundError as error:
        missing = (error.name or "camber").partition(".")[0]
        if missing == "camber":
            raise
        extra = EXTRA_OF.get(missing)
        whence = f"camber[{extra}]" if extra else "all of Camber, and not with the image of a single service"
        print(f"camber {name}: {missing} is not installed; it comes with {whence}", file=sys.stderr)
        return 2
    print(f"camber: {args[0]!r} is neither a service nor a tool; `camber --help` lists them", file=sys.stderr)
    return 2


def _run_tool(module: str, argv: list[str]) -> int:
    code: int = importlib.import_module(module).main(argv)
    return code


def _run_service(name: str, argv: list[str]) -> int:
    if name == "gnss" and argv and argv[0] in GNSS_TOOLS:
        return _run_tool(GNSS_TOOLS[argv[0]][0], argv[1:])
    if name == "gnss" and "--list-ports" in argv:
        print(importlib.import_module("camber.transport.serial_ports").describe_ports())
        return 0
    if name == "gnss" and {"-h", "--help"} & set(argv):
        print("\n".join(_gnss_tools()) + "\n\nor the service:")
    from camber.runtime.run import run

    module = importlib.import_module(f"camber.{name}.service")
    return run(module.SERVICE, argv)


def _help() -> str:
    lines = ["usage: camber NAME [options]      camber NAME --help for each", "", "services:"]
    lines += [f"  {name:<16} {text}" for name, text in SERVICES.items()]
    lines += ["", "tools:"]
    lines += [f"  {name:<16} {text}" for name, (_, text) in TOOLS.items()]
    lines += ["", *_gnss_tools(), "camber gnss --list-ports        the serial ports that are here"]
    return "\n".join(lines)


def _gnss_tools() -> list[str]:
    files = {"inspect": "FILE", "solve": "drive.toml"}
    return [f"camber gnss {name + ' ' + files[name]:<19} {text}" for name, (_, text) in GNSS_TOOLS.items()]


if __name__ == "__main__":
    raise SystemExit(main())
