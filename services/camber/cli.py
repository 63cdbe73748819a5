"""`camber`: one command, with a subcommand for each service and each tool."""

from __future__ import annotations

import importlib
import os
import select
import signal
import sys

from camber.tools.options.subcommands import Command, choose_command, help_text

SERVICES = {
    "gnss": Command("camber.gnss.service", "candidate fixes and velocity from receivers and their files"),
    "map_server": Command("camber.map_server.service", "road elevation, links and tiles from a map release"),
    "localizer": Command(
        "camber.localizer.service", "prior pose and road elevation from motion, sweeps and map"
    ),
    "antenna_height": Command("camber.antenna_height.service", "height of the antenna above the road"),
    "integrity": Command("camber.integrity.service", "verdicts, positions with protection levels, uploads"),
    "sensors": Command("camber.sensors.service", "sweeps and motion from a LiDAR and a CAN bus"),
    "ros2": Command(
        "camber.ros2.service", "sensors from a ROS 2 graph by rmw_zenoh; positions and verdicts to it"
    ),
    "map_update": Command("camber.map_update.service", "fleet uploads, their fusion, new map releases"),
}
TOOL_GROUPS = {
    "drives": {
        "demo": Command("camber.tools.demo", "simulate two minutes of city driving and replay them"),
        "simulate": Command(
            "camber.tools.simulate", "simulate a drive or a fleet, with truth, from a scenario"
        ),
        "replay": Command("camber.replay.command", "run a recorded drive through all services"),
        "evaluate": Command("camber.validation.evaluate", "write summary and report of a replay again"),
        "localize": Command(
            "camber.tools.localize.command", "run the localizer alone over a drive, with plots"
        ),
        "calibrate": Command(
            "camber.tools.calibrate.command", "estimate lever arm, antenna height and base offset"
        ),
    },
    "validation": {
        "lab": Command("camber.validation.lab.command", "Monte Carlo simulation of wrong fixes and faults"),
        "evidence": Command(
            "camber.validation.evidence.command", "run the benchmark drives, write docs/evidence.md"
        ),
        "common_faults": Command(
            "camber.validation.common_faults.command", "drives whose fixes are all off by one vector"
        ),
    },
    "maps and fleet": {
        "map": Command("camber.tools.maps.command", "build, inspect, diff and export map releases"),
        "upload": Command(
            "camber.tools.operate.upload", "send road heights from a file to the fleet's store"
        ),
        "uploads": Command("camber.tools.operate.uploads", "export the fleet's store as CSV"),
    },
    "operation": {
        "live": Command("camber.live.command", "serve a web page of the bus, a recording or a replay"),
        "foxglove": Command(
            "camber.live.foxglove_server", "serve what is on the bus to Foxglove and Lichtblick"
        ),
        "router": Command("camber.runtime.router", "run a Zenoh router in Python"),
        "status": Command(
            "camber.tools.operate.status", "show services, rates, ages, queues and last issues"
        ),
        "health": Command("camber.tools.operate.health", "query the health of a running service"),
        "doctor": Command("camber.tools.operate.doctor", "check settings, clock, disk, map and receiver"),
        "log_level": Command("camber.tools.operate.log_level", "change a service's log level for a while"),
    },
    "recording": {
        "record": Command("camber.tools.record.record", "record a vehicle's bus into MCAP files"),
        "play": Command("camber.tools.record.play", "play a recording back onto a bus"),
        "feed": Command("camber.tools.record.feed", "feed a recorded drive live to running services"),
        "import": Command("camber.tools.bags.import_command", "make a drive of a ROS bag"),
        "export": Command("camber.tools.bags.export_command", "make a ROS 2 bag of a run"),
    },
    "security": {
        "certs": Command(
            "camber.tools.security.certificate_command", "create a CA; issue and revoke certificates"
        ),
        "access": Command("camber.tools.security.access", "generate and check router access-control rules"),
    },
}
TOOLS = {name: command for group in TOOL_GROUPS.values() for name, command in group.items()}
GNSS_COMMANDS = {
    "inspect": Command("camber.tools.gnss.inspect", "show the contents of a recording of observations"),
    "setup": Command("camber.tools.gnss.setup", "configure a u-blox or Septentrio receiver"),
    "solve": Command("camber.tools.gnss.solve", "solve positions from raw observations, with plots"),
}
"""Tools that share their first word with the service `gnss`."""
COMPLETION = Command("camber.tools.options.completion", "print the completion script of bash, zsh or fish")
LIST_PORTS = Command("camber.transport.serial_ports", "list the serial ports of this machine")
VERSION = Command("importlib.metadata", "print the version")

EXTRA_OF = {
    "arro3": "map",
    "asyncpg": "fleet",
    "foxglove": "foxglove",
    "hatanaka": "engine",
    "laspy": "map",
    "matplotlib": "plots",
    "nanoarrow": "map",
    "nats": "fleet",
    "numba": "engine",
    "open3d": "map",
    "osmium": "map",
    "pyproj": "map",
    "rasterio": "map",
    "rosbags": "ros",
    "ruamel": "map",
    "small_gicp": "localizer",
    "starlette": "web",
    "uvicorn": "web",
    "xxhash": "ros",
}
"""Optional packages, and the extra of the distribution that installs them."""


def main(argv: list[str] | None = None) -> int:
    """Run a service or a tool; return the exit code: 130 interrupted, 141 standard output closed by its reader."""
    args = sys.argv[1:] if argv is None else argv
    try:
        try:
            return _dispatch(args)
        finally:
            print(end="", flush=True)  # here, where a closed pipe can be handled
    except BrokenPipeError:
        output = select.poll()
        output.register(sys.stdout, 0)
        if not output.poll(0):  # another pipe was closed
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt:
        print(f"{' '.join(['camber', *args[:1]])}: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT


def _dispatch(args: list[str]) -> int:
    if "_ARGCOMPLETE" in os.environ:
        from camber.tools.options.completion import arguments_before_cursor

        args = arguments_before_cursor()
    elif not args or args[0] in ("-h", "--help", "help"):
        print(_help())
        return 0
    if args[:1] == ["--version"]:
        print(f"camber {importlib.import_module(VERSION.module).version('camber')}")
        return 0
    if args[:1] == ["--completion"]:
        return _run(COMPLETION, args[1:])
    name = choose_command("camber", {**SERVICES, **TOOLS}, args)
    if name is None:
        return 2
    try:
        return _run_service(name, args[1:]) if name in SERVICES else _run(TOOLS[name], args[1:])
    except ModuleNotFoundError as error:
        missing = (error.name or "camber").partition(".")[0]
        if missing == "camber":
            raise
        source = "a full installation of Camber, not with a single service's image"
        if missing in EXTRA_OF:
            source = f"camber[{EXTRA_OF[missing]}]"
        print(f"camber {name}: {missing} is not installed; it comes with {source}", file=sys.stderr)
        return 2


def _help() -> str:
    observations = {f"gnss {name}": command for name, command in GNSS_COMMANDS.items()}
    options = {"gnss --list-ports": LIST_PORTS, "--version": VERSION, "--completion": COMPLETION}
    groups = {"services": SERVICES, **TOOL_GROUPS, "observations": observations, "options": options}
    return help_text("camber", groups)


def _run(command: Command, argv: list[str]) -> int:
    code: int = importlib.import_module(command.module).main(argv)
    return code


def _run_service(name: str, argv: list[str]) -> int:
    if name == "gnss" and argv and argv[0] in GNSS_COMMANDS:
        return _run(GNSS_COMMANDS[argv[0]], argv[1:])
    if name == "gnss" and "--list-ports" in argv:
        print(importlib.import_module(LIST_PORTS.module).describe_ports())
        return 0
    if name == "gnss" and {"-h", "--help"} & set(argv):
        print(help_text("camber gnss", {"tools": GNSS_COMMANDS}) + "\n\nor the service:")
    from camber.runtime.run import run

    return run(importlib.import_module(SERVICES[name].module).SERVICE, argv)


if __name__ == "__main__":
    raise SystemExit(main())
