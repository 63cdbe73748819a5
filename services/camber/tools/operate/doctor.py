"""`camber doctor`: check a deployment before a drive; one line for each check: ok, or a problem and its remedy.

The settings are read as the services read them. Checked are settings, ports, router, clock, disk, certificates, map,
receiver and corrections. Nothing is changed.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from camber.runtime.settings import ConfigError, ServiceSettings, load
from camber.schemas.channels import VEHICLE_SERVICES
from camber.tools.operate.doctor_machine_checks import (
    LEAST_FREE_BYTES,
    Finding,
    check_certificates,
    check_clock,
    check_folder,
    check_python,
    kernel_discipline,
    not_checked,
    ok,
    problem,
)
from camber.tools.options.number_options import SECONDS
from camber.tools.options.parsers import add_with_default, tool_parser

_PROG = "camber doctor"
_CLOUD = ("map_update",)
_TLS_FIELDS = ("tls_ca", "tls_certificate", "tls_key")
_HELP = """\
exit codes: 0 no problem; 1 at least one problem; 2 wrong usage. A check that is not possible here is no problem.
"""


def main(argv: Sequence[str]) -> int:
    """Check a deployment; return the exit code."""
    parser = tool_parser(_PROG, __doc__, _HELP)
    text = "a TOML for each service, as deploy/config/vehicle"
    parser.add_argument("config", type=Path, metavar="FOLDER", help=text)
    add_with_default(parser, "--seconds", 5.0, "to listen to the receiver", type=SECONDS, metavar="S")
    parser.add_argument("--offline", action="store_true", help="leave out bus, ports, receiver and caster")
    parser.add_argument("--json", action="store_true", help="a list of findings")
    args = parser.parse_args(argv)
    if not os.path.isdir(args.config):  # False also without permission
        print(f"{_PROG}: {args.config}: expected the folder of a deployment's settings", file=sys.stderr)
        return 2
    findings = []
    for finding in examine(args.config, receiver_s=args.seconds, offline=args.offline):
        findings.append(finding)
        if not args.json:
            print(finding, flush=True)
    wrong = sum(finding.state == "problem" for finding in findings)
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings]))
    else:
        print(f"\n{wrong or 'no'} problem{'s' if wrong > 1 else ''}")
    return 1 if wrong else 0


def examine(folder: Path, *, receiver_s: float = 5.0, offline: bool = False) -> Iterator[Finding]:
    """Yield all findings of a folder of TOML files; `offline` leaves out bus, ports, receiver and caster."""
    yield from check_python()
    yield from check_clock(kernel_discipline(), time.time())
    yield from _check_routers(folder)
    known: dict[str, Any] = {}
    for path in sorted(folder.glob("*.toml")):
        yield _check_settings(path, known)
    if not known:
        text = f"{folder}: no file of a service that can be read"
        yield problem("settings", text, "one TOML for each service")
        return
    yield _check_vehicle_names(known, folder)
    yield from _check_vehicle(known, folder)
    yield from _check_disks(known)
    yield from _check_service_certificates(known)
    checks = [_check_maps(known)]
    if not offline:
        checks = [_check_connections(known), *checks, _check_receivers(known, receiver_s)]
    for check in checks:
        try:
            yield from check
        except ModuleNotFoundError as error:
            yield not_checked("map and receiver", f"{error.name} is not installed here")


def _check_settings(path: Path, known: dict[str, Any]) -> Finding:
    """Read one service's file as that service does, into `known`."""
    what, name = f"settings {path.name}", path.stem
    try:
        classes = vars(importlib.import_module(f"camber.{name}.settings")).values()
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("camber"):
            text = f"{error.name} is not installed here; `camber {name} --check` where it is"
            return not_checked(what, text)
        classes = {}.values()
    services = (each for each in classes if isinstance(each, type) and issubclass(each, ServiceSettings))
    cls = next((each for each in services if name == each.SERVICE), None)
    if cls is None:
        return problem(what, "no service has this name", "rename or remove it")
    try:
        known[name], _ = load(cls, ["--config", str(path)], prog=_PROG)
    except ConfigError as error:
        return problem(what, str(error), f"`camber {name} --help` has all settings")
    return ok(what, f"right, for {known[name].vehicle}")


def _check_vehicle_names(known: dict[str, Any], folder: Path) -> Finding:
    names = {name: settings.vehicle for name, settings in known.items() if name not in _CLOUD}
    for path in folder.glob("*router*.json5") if names else ():
        if (name := _name_of(path)) is not None:
            names[path.name] = name
    if len(set(names.values())) > 1:
        each = ", ".join(f"{name} {vehicle}" for name, vehicle in sorted(names.items()))
        remedy = "services of different vehicles do not exchange messages"
        return problem("vehicle", f"not the same in all files: {each}", remedy)
    return ok("vehicle", next(iter(names.values()), "none: services of the cloud"))


def _name_of(router: Path) -> str | None:
    """Return the vehicle of a router's access rules; None without one, or with several."""
    from camber.runtime.access_probe import name_in
    from camber.runtime.session import BusError, router_rules

    with contextlib.suppress(BusError):  # reported with the file itself
        return name_in(router_rules(router))
    return None


def _check_vehicle(known: dict[str, Any], folder: Path) -> Iterator[Finding]:
    """Report what is missing that a verdict needs."""
    missing = [name for name in VEHICLE_SERVICES if not os.path.exists(folder / f"{name}.toml")]
    if missing and set(known) & set(VEHICLE_SERVICES):
        yield not_checked("services", f"no settings here of {', '.join(missing)}; a vehicle needs them all")
    height = known.get("antenna_height")
    if height is not None and height.way == "fixed" and height.fixed_height_m is None:
        text = "way = fixed without fixed_height_m: no fix will be confirmed"
        remedy = "measure it, or set another way: docs/services/antenna_height.md"
        yield problem("antenna height", text, remedy)


def _check_disks(known: dict[str, Any]) -> Iterator[Finding]:
    seen: set[Path] = set()
    for name, settings in known.items():
        store = getattr(settings, "store", None)
        store_folder = store.parent if isinstance(store, Path) else None
        for folder in (settings.state_dir, store_folder, getattr(settings, "releases", None)):
            if folder is not None and folder not in seen:
                seen.add(folder)
                least = max(LEAST_FREE_BYTES, int(getattr(settings, "outbox_limit_mb", 0)) << 20)
                yield check_folder(f"disk of {name}", folder, least_free_bytes=least)


def _check_service_certificates(known: dict[str, Any]) -> Iterator[Finding]:
    now, seen = datetime.now(UTC), set()
    for name, settings in known.items():
        files = tuple(getattr(settings.zenoh, field, None) for field in _TLS_FIELDS)
        caster = getattr(settings, "ntrip_ca_file", None)
        for what, each in ((f"TLS of {name}", files), ("TLS of the caster", (caster, None, None))):
            if any(each) and each not in seen:
                seen.add(each)
                yield from check_certificates(what, each, now)


def _check_routers(folder: Path) -> Iterator[Finding]:
    """Check the certificates that each router's file names."""
    from camber.runtime.session import BusError, router_endpoints

    now = datetime.now(UTC)
    for path in sorted(folder.glob("*router*.json5")):
        what = f"router {path.name}"
        try:
            _, _, tls = router_endpoints(path)
        except BusError as error:
            yield problem(what, str(error), "docs/security.md")
            continue
        sides = ("listen", "connect")
        pairs = {(tls.get(f"{side}_certificate"), tls.get(f"{side}_private_key")) for side in sides}
        for pair in pairs - {(None, None)}:
            files = (Path(file) if file else None for file in (tls.get("root_ca_certificate"), *pair))
            yield from check_certificates(what, tuple(files), now)


def _check_connections(known: dict[str, Any]) -> Iterator[Finding]:
    from camber.tools.operate.doctor_connection_checks import check_bus, check_ports

    yield from check_ports(list(known.items()))
    buses: dict[str, ServiceSettings] = {}
    for settings in known.values():
        buses.setdefault(settings.zenoh.model_dump_json(), settings)
    for settings in buses.values():
        yield from check_bus(settings)


def _check_maps(known: dict[str, Any]) -> Iterator[Finding]:
    from camber.tools.operate.doctor_connection_checks import check_map, check_reference

    if "map_update" in known:
        yield from check_reference(known["map_update"])
    if "map_server" in known:
        gnss = known.get("gnss")
        yield from check_map(known["map_server"], None if gnss is None else gnss.datum)


def _check_receivers(known: dict[str, Any], seconds: float) -> Iterator[Finding]:
    from camber.runtime.query import BusError, QueryClient
    from camber.tools.operate.doctor_connection_checks import check_receiver

    if "gnss" not in known:
        return
    settings, runs = known["gnss"], False
    with contextlib.suppress(BusError), QueryClient(settings, timeout_s=1.0) as client:
        runs = "gnss" in client.alive(settings.vehicle).get(settings.vehicle, ())
    yield from check_receiver(settings, seconds, gnss_runs=runs)
