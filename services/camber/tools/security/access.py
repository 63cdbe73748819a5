"""`camber access`: generate and check access-control rules of routers, derived from the table of channels.

    camber access cloud --certs FOLDER --out cloud.json5               all certificates in FOLDER that are not revoked
    camber access cloud --vehicle car-1 --vehicle car-2 --consumer dashboard --out cloud.json5
    camber access vehicle car-1 --connect tls/cloud.example:7448 --out vehicle.json5
    camber access table                                                the rules in Markdown, as in docs/security.md
    camber access check vehicle.json5                                  test whether this certificate may publish

`camber router --config-file FILE` and `zenohd --config FILE` accept the generated file. A router reads it at startup.
"""

from __future__ import annotations

import argparse
import shlex
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from camber.runtime.access_probe import BusError, can_publish, denial_message, name_in
from camber.runtime.session import OVER_TLS, router_endpoints, router_rules
from camber.runtime.settings import ZenohSettings
from camber.runtime.tls_certificates import TlsError, certificate_name, name_of
from camber.schemas.channels import CHANNELS
from camber.tools.options.number_options import SECONDS
from camber.tools.options.output_check import check_output_file
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.tools.security.access_rules import INSIDE, AllowedMessage, Kind, Party, allowed_messages
from camber.tools.security.certificate_authority import Authority, CertsError, check_name
from camber.tools.security.router_config import cloud_config, text_of, vehicle_config

_PROG = "camber access"
LISTEN_CLOUD, LISTEN_VEHICLE = "tls/[::]:7448", "tcp/127.0.0.1:7447"
FOLDER = Path("/etc/camber/tls")
_KINDS: tuple[Kind, ...] = get_args(Kind)
_ACTIONS = {
    ("ingress", "put"): "publishes",
    ("ingress", "declare_subscriber"): "subscribes",
    ("ingress", "query"): "queries",
    ("ingress", "declare_queryable"): "replies",
}
_HEADINGS = {
    "vehicle": "vehicle `V`",
    "map_update": "`map_update`",
    "consumer": "consumer",
    "judge": "judge in the cloud",
    "operator": "operator",
}


def main(argv: list[str] | None = None) -> int:
    """Return 0 on success, 2 on failure; `check` returns 1 where publishing is denied, 3 where no router answers."""
    arguments = sys.argv[1:] if argv is None else argv
    args = _parser().parse_args(arguments)
    args.made_by = shlex.join(["camber", "access", *_without_out(arguments)])
    try:
        code: int = args.work(args)
        return code
    except (CertsError, TlsError, ValueError, OSError) as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser(_PROG, __doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    cloud = commands.add_parser("cloud", help="write the configuration of a cloud router")
    cloud.set_defaults(work=_cloud)
    add = cloud.add_argument
    add("--certs", type=Path, metavar="FOLDER", help="folder of the CA: include all certificates issued")
    text = "repeatable; NAME=CN where the certificate's common name differs from NAME"
    for kind in ("vehicle", "consumer", "judge", "operator"):
        add(f"--{kind}", action="append", default=[], metavar="NAME", help=text)
    text = "common names of all cloud routers, this one first (default cloud)"
    add("--router", action="append", metavar="CN", help=text)
    add("--listen", action="append", help=f"endpoint to listen on (default {LISTEN_CLOUD})")
    add("--connect", action="append", default=[], help="endpoint of another cloud router")
    vehicle = commands.add_parser("vehicle", help="write the configuration of a vehicle's router")
    vehicle.set_defaults(work=_vehicle)
    add = vehicle.add_argument
    add("name", metavar="NAME")
    text = "endpoint of a cloud router; repeat for failover"
    add("--connect", action="append", required=True, help=text)
    add("--listen", action="append", help=f"endpoint within the vehicle (default {LISTEN_VEHICLE})")
    receivers = [kind for kind in _KINDS if kind != "vehicle"]
    text = "cloud parties that may receive this vehicle's messages (default map_update consumer)"
    add("--to", nargs="+", choices=receivers, default=["map_update", "consumer"], help=text)
    for command in (cloud, vehicle):
        add_with_default(command, "--tls", FOLDER, "folder of CA, certificate and key", type=Path)
        command.add_argument("--out", type=Path, metavar="FILE", help="output file (default standard output)")
    table = commands.add_parser("table", help="print the access rules as a Markdown table")
    table.set_defaults(work=lambda _: print(table_text()) or 0)
    check = commands.add_parser("check", help="test whether this certificate may publish")
    check.set_defaults(work=_check)
    add = check.add_argument
    add("file", type=Path, metavar="FILE", help="configuration of a router")
    add("--name", help="vehicle to publish as (default: from the rules, else from the certificate)")
    add("--timeout-s", type=SECONDS, default=5.0)
    return parser


def _cloud(args: argparse.Namespace) -> int:
    issued = [] if args.certs is None else Authority(args.certs).issued()
    parties = [] if args.certs is not None else [Party(kind="map_update", name="map_update")]
    of_folder = {row.name: row.common_name for row in issued if row.kind == "router" and row.revoked is None}
    routers = [of_folder.get(name, name) for name in args.router or ()] + list(of_folder.values())
    for row in issued:
        if row.kind != "router" and row.revoked is None:
            parties.append(Party(kind=row.kind, name=row.name, common_name=row.common_name))
    for kind in _KINDS:
        for text in getattr(args, kind, ()):
            name, _, common_name = text.partition("=")
            parties.append(Party(kind=kind, name=name, common_name=common_name))
    parties = list(dict.fromkeys(parties))  # a renewed certificate keeps its name
    for party in parties:
        check_name(party.name)
    routers = list(dict.fromkeys(routers or ["cloud"]))
    revoked = {row.common_name for row in issued if row.revoked is not None}
    for common_name in (*routers, *(party.certificate for party in parties)):
        if common_name in revoked:
            raise CertsError(f"{common_name}: revoked in {args.certs}")
    config = cloud_config(
        parties,
        routers=routers,
        listen=args.listen or [LISTEN_CLOUD],
        connect=args.connect,
        folder=args.tls,
        certificate_name=name_of(routers[0]),  # as `camber certs` names the file
    )
    about = f"Cloud router: {len(parties)} certificates, each with its own rules; all others are denied."
    _write(args.out, text_of(config, about=about, made_by=args.made_by))
    return 0


def _vehicle(args: argparse.Namespace) -> int:
    check_name(args.name)
    for endpoint in args.connect:
        if not endpoint.startswith(OVER_TLS):  # the rules treat any other as a service inside the vehicle
            raise ValueError(f"--connect {endpoint}: expected tls/… or quic/…")
    for endpoint in args.listen or ():
        if endpoint.partition("/")[0] not in INSIDE:  # the rules treat TLS as the link to the cloud
            raise ValueError(f"--listen {endpoint}: expected {' or '.join(f'{name}/…' for name in INSIDE)}")
    listen = args.listen or [LISTEN_VEHICLE]
    config = vehicle_config(args.name, connect=args.connect, listen=listen, kinds=args.to, folder=args.tls)
    about = f"Router of vehicle {args.name}: everything inside; one restricted link to the cloud."
    _write(args.out, text_of(config, about=about, made_by=args.made_by))
    return 0


def table_text() -> str:
    """Return one row for each channel open to any kind of certificate, one column for each kind."""
    rules = {
        kind: allowed_messages(Party(kind=kind, name="V" if kind == "vehicle" else kind), _KINDS)
        for kind in _KINDS
    }
    lines = [
        "| channel | key | " + " | ".join(_HEADINGS[kind] for kind in _KINDS) + " |",
        "|---|---" + "|---" * len(_KINDS) + "|",
    ]
    for channel in CHANNELS:
        key = channel.key.replace("{vehicle}", "V")
        cells = [_cell(rules[kind], channel.key) for kind in _KINDS]
        if any(cells):
            lines.append(f"| `{channel.name}` | `{key}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(rules: list[AllowedMessage], key: str) -> str:
    """Return what the rules allow on a key of the table."""
    actions = [
        _ACTIONS[item.flow, item.message]
        for item in rules
        if (item.flow, item.message) in _ACTIONS and _matches(item.key, key)
    ]
    return ", ".join(dict.fromkeys(actions))


def _matches(key: str, pattern: str) -> bool:
    parts, wanted = key.split("/"), pattern.split("/")
    return len(parts) == len(wanted) and all(
        part == want or want.startswith("{") for part, want in zip(parts, wanted, strict=True)
    )


def _check(args: argparse.Namespace) -> int:
    try:
        _, connect, table = router_endpoints(args.file)
        settings = settings_of(connect, table)
        common_name = name_of(certificate_name(Path(table["connect_certificate"])))
        name = args.name or name_in(router_rules(args.file)) or common_name
        access = can_publish(settings, name, timeout_s=args.timeout_s)
    except (BusError, TlsError) as error:
        print(f"{_PROG}: {args.file}: {error}", file=sys.stderr)
        return 3
    if access == "permitted":
        print(f"accepted as {name} at {', '.join(settings.connect)}")
        return 0
    print(f"{_PROG}: {denial_message(settings, name)}", file=sys.stderr)
    return 1


def settings_of(connect: Sequence[str], table: dict[str, object]) -> ZenohSettings:
    """Return client settings equivalent to a router's uplink. Raises ValueError where it has none over TLS."""
    if not connect or not table.get("connect_certificate"):
        raise ValueError("connects to no other router over TLS, so there is no access to check")
    names = ("root_ca_certificate", "connect_certificate", "connect_private_key")
    ca, certificate, key = (Path(str(table[name])) for name in names)
    files = {"tls_ca": ca, "tls_certificate": certificate, "tls_key": key}
    return ZenohSettings(mode="client", connect=list(connect), **files)


def _write(path: Path | None, text: str) -> None:
    if path is None:
        print(text, end="")
        return
    check_output_file(path, _PROG)
    target = path.resolve()
    fresh = target.with_name(target.name + ".new")
    try:
        fresh.write_text(text, "utf-8")
        if target.exists():
            fresh.chmod(stat.S_IMODE(target.stat().st_mode))
        fresh.replace(target)
    except OSError:
        fresh.unlink(missing_ok=True)
        raise
    print(f"{path} written", file=sys.stderr)


def _without_out(arguments: Sequence[str]) -> list[str]:
    before = ["", *arguments]
    return [
        a
        for a, previous in zip(arguments, before, strict=False)
        if "--out" not in (a.partition("=")[0], previous)
    ]
