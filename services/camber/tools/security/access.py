"""`camber access`: who may say what on the cloud's router, made from the table of channels.

    camber access cloud --certs FOLDER --out cloud.json5               for all that FOLDER has issued and not revoked
    camber access cloud --vehicle car-1 --vehicle car-2 --consumer dashboard --out cloud.json5
    camber access vehicle car-1 --connect tls/cloud.example:7448 --out vehicle.json5
    camber access table                                                the rules for people, as in docs/security.md
    camber access check vehicle.json5                                  is what this certificate says heard?

`camber router --config-file FILE` and `zenohd --config FILE` take what comes out. A router reads it when it starts.
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
from camber.runtime.tls import TlsError, certificate_name, name_of
from camber.tools.options.number_options import SECONDS
from camber.tools.security.access_rules import INSIDE, Kind, Party
from camber.tools.security.access_table import table_text
from camber.tools.security.certificates import Authority, CertsError, check_name
from camber.tools.security.router_config import cloud_config, text_of, vehicle_config

LISTEN_CLOUD, LISTEN_VEHICLE = "tls/[::]:7448", "tcp/127.0.0.1:7447"
FOLDER = Path("/etc/camber/tls")
_KINDS: tuple[Kind, ...] = get_args(Kind)


def main(argv: list[str] | None = None) -> int:
    """Returns 2 where nothing was made; from `check` 1 where we are not heard, 3 where nobody is reached."""
    words = sys.argv[1:] if argv is None else argv
    args = _parser().parse_args(words)
    args.made_by = shlex.join(["camber", "access", *_without_out(words)])
    try:
        code: int = args.work(args)
        return code
    except (CertsError, TlsError, ValueError, OSError) as error:
        print(f"camber access: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="camber access", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    cloud = commands.add_parser("cloud", help="configuration of a router of the cloud")
    cloud.set_defaults(work=_cloud)
    cloud.add_argument("--certs", type=Path, metavar="FOLDER", help="all that this authority has issued")
    for kind in ("vehicle", "consumer", "judge", "operator"):
        cloud.add_argument(
            f"--{kind}",
            action="append",
            default=[],
            metavar="NAME",
            help="repeatable; NAME=CN where the common name of the certificate is another",
        )
    cloud.add_argument(
        "--router",
        action="append",
        metavar="CN",
        help="names of all routers (cloud); the first is this",
    )
    cloud.add_argument("--listen", action="append", help=f"({LISTEN_CLOUD})")
    cloud.add_argument("--connect", action="append", default=[], help="another router of the cloud")
    vehicle = commands.add_parser("vehicle", help="configuration of a vehicle's router")
    vehicle.set_defaults(work=_vehicle)
    vehicle.add_argument("name", metavar="NAME")
    vehicle.add_argument(
        "--connect", action="append", required=True, help="the cloud's; more: if one is away"
    )
    vehicle.add_argument("--listen", action="append", help=f"within the vehicle ({LISTEN_VEHICLE})")
    vehicle.add_argument(
        "--to",
        nargs="+",
        choices=[kind for kind in _KINDS if kind != "vehicle"],
        default=["map_update", "consumer"],
        help="who there is in the cloud that this vehicle lets its words out to (map_update consumer)",
    )
    for command in (cloud, vehicle):
        command.add_argument(
            "--tls", type=Path, default=FOLDER, help=f"folder of ca.pem and the pair ({FOLDER})"
        )
        command.add_argument("--out", type=Path, metavar="FILE", help="(standard output)")
    table = commands.add_parser("table", help="who may say what, in Markdown")
    table.set_defaults(work=lambda _: print(table_text(), end="") or 0)
    check = commands.add_parser("check", help="is what this certificate says heard?")
    check.set_defaults(work=_check)
    check.add_argument("file", type=Path, metavar="FILE", help="configuration of a router")
    check.add_argument("--name", help="vehicle in whose name (that of the rules, or of the certificate)")
    check.add_argument("--timeout-s", type=SECONDS, default=5.0)
    return parser


def _cloud(args: argparse.Namespace) -> int:
    issued = [] if args.certs is None else Authority(args.certs).issued()
    parties = [] if args.certs is not None else [Party("map_update", "map_update")]
    of_folder = {row.name: row.common_name for row in issued if row.kind == "router" and row.revoked is None}
    routers = [of_folder.get(name, name) for name in args.router or ()] + list(of_folder.values())
    for row in issued:
        if row.kind != "router" and row.revoked is None:
            parties.append(Party(row.kind, row.name, row.common_name))
    for kind in _KINDS:
        for text in getattr(args, kind, ()):
            name, _, common_name = text.partition("=")
            parties.append(Party(kind, name, common_name))
    parties = list(dict.fromkeys(parties))  # renewed ones share their name
    for party in parties:
        check_name(party.name)
    routers = list(dict.fromkeys(routers or ["cloud"]))
    revoked = {row.common_name for row in issued if row.revoked is not None}
    for common_name in (*routers, *(party.certificate for party in parties)):
        if common_name in revoked:
            raise CertsError(f"{common_name}: is revoked in {args.certs}")
    config = cloud_config(
        parties,
        routers=routers,
        listen=args.listen or [LISTEN_CLOUD],
        connect=args.connect,
        folder=args.tls,
        own=name_of(routers[0]),  # as `camber certs` names the file
    )
    about = f"A router of the cloud: {len(parties)} certificates may join, each with its own rules; others nothing."
    _write(args.out, text_of(config, about=about, made_by=args.made_by))
    return 0


def _vehicle(args: argparse.Namespace) -> int:
    check_name(args.name)
    for endpoint in args.connect:
        if not endpoint.startswith(OVER_TLS):  # its rules take what comes otherwise for a service within
            raise ValueError(f"--connect {endpoint}: expected tls/… or quic/…")
    for endpoint in args.listen or ():
        if endpoint.partition("/")[0] not in INSIDE:  # and what comes over TLS for the cloud
            raise ValueError(f"--listen {endpoint}: expected {' or '.join(f'{name}/…' for name in INSIDE)}")
    config = vehicle_config(
        args.name,
        connect=args.connect,
        listen=args.listen or [LISTEN_VEHICLE],
        kinds=args.to,
        folder=args.tls,
        own=args.name,
    )
    about = (
        f"The router in the vehicle {args.name}: all within it, one link to the cloud, and little over that."
    )
    _write(args.out, text_of(config, about=about, made_by=args.made_by))
    return 0


def _check(args: argparse.Namespace) -> int:
    try:
        _, connect, table = router_endpoints(args.file)
        settings = settings_of(connect, table)
        own = name_of(certificate_name(Path(table["connect_certificate"])))
        name = args.name or name_in(router_rules(args.file)) or own
        heard = can_publish(settings, name, timeout_s=args.timeout_s)
    except (BusError, TlsError) as error:
        print(f"camber access: {args.file}: {error}", file=sys.stderr)
        return 3
    if heard == "permitted":
        print(f"accepted as {name} at {', '.join(settings.connect)}")
        return 0
    print(f"camber access: {denial_message(settings, name)}", file=sys.stderr)
    return 1


def settings_of(connect: Sequence[str], table: dict[str, object]) -> ZenohSettings:
    """What a router's own configuration would be as that of a client. Raises ValueError where it joins nobody."""
    if not connect or not table.get("connect_certificate"):
        raise ValueError("it joins no other router over TLS, so there is nobody to be heard by")
    return ZenohSettings(
        mode="client",
        connect=list(connect),
        tls_ca=Path(str(table["root_ca_certificate"])),
        tls_certificate=Path(str(table["connect_certificate"])),
        tls_key=Path(str(table["connect_private_key"])),
    )


def _write(path: Path | None, text: str) -> None:
    if path is None:
        print(text, end="")
        return
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


def _without_out(words: Sequence[str]) -> list[str]:
    kept, skip = [], False
    for word in words:
        if skip or word == "--out" or word.startswith("--out="):
            skip = word == "--out"
            continue
        kept.append(word)
    return kept


if __name__ == "__main__":
    raise SystemExit(main())
