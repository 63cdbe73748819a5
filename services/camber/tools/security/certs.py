"""`camber certs`: certificates for a fleet: who may join the cloud's router, and under which name.

    camber certs make FOLDER --host cloud.example --vehicle car-1 --vehicle car-2 --consumer dashboard
    camber certs issue FOLDER car-3 --kind vehicle --days 30     one more, or --renew one
    camber certs revoke FOLDER car-2                             no more in the list of `camber access`
    camber certs list FOLDER
    camber certs show FILE…                                      who, by whom, until when

Where there is an authority already, let it sign: all that Camber asks of a certificate is its common name, the name of
the vehicle. docs/security.md says what each kind may do.
"""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from camber.runtime.tls import RENEW_BEFORE
from camber.tools.options.number_options import number_from
from camber.tools.security.certificates import (
    KINDS,
    Authority,
    CertsError,
    Issued,
    Kind,
    check_hosts,
    check_length,
    check_name,
    common_name,
    read_certificate,
)

DAYS, AUTHORITY_DAYS = 30.0, 3650.0
_DAYS = number_from(0.001, 36_500.0, "days")


def main(argv: list[str] | None = None) -> int:
    """Returns 2 where something could not be done, and from `show` 1 where a certificate is not valid now."""
    args = _parser().parse_args(argv)
    try:
        code: int = args.work(args)
        return code
    except (CertsError, OSError) as error:
        print(f"camber certs: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="camber certs", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    make = commands.add_parser("make", help="a new authority, and a certificate for each that is named")
    make.set_defaults(work=_make)
    make.add_argument("folder", type=Path, metavar="FOLDER")
    make.add_argument("--name", default="Camber development", help="name of the authority")
    make.add_argument("--router", default="cloud", metavar="NAME", help="name of the cloud's router (cloud)")
    make.add_argument(
        "--host", action="append", required=True, help="host name or address of the router; repeatable"
    )
    for kind in ("vehicle", "consumer", "judge", "operator"):
        make.add_argument(f"--{kind}", action="append", default=[], metavar="NAME", help="repeatable")
    make.add_argument("--authority-days", type=_DAYS, default=AUTHORITY_DAYS, metavar="DAYS")
    issue = commands.add_parser("issue", help="a certificate, signed by the authority of the folder")
    issue.set_defaults(work=_issue)
    issue.add_argument("folder", type=Path, metavar="FOLDER")
    issue.add_argument("name", metavar="NAME")
    issue.add_argument("--kind", choices=KINDS, required=True)
    issue.add_argument(
        "--host",
        action="append",
        default=[],
        help="of a router; repeatable (with --renew: those that it has)",
    )
    issue.add_argument("--renew", action="store_true", help="a new one in place of the one that is there")
    for command in (make, issue):
        command.add_argument(
            "--days", type=_DAYS, default=DAYS, help=f"how long certificates are valid ({DAYS:.0f})"
        )
    revoke = commands.add_parser("revoke", help="take a name out of the access list")
    revoke.set_defaults(work=_revoke)
    revoke.add_argument("folder", type=Path, metavar="FOLDER")
    revoke.add_argument("name", metavar="NAME")
    listing = commands.add_parser("list", help="what was issued")
    listing.set_defaults(work=_list)
    listing.add_argument("folder", type=Path, metavar="FOLDER")
    show = commands.add_parser("show", help="who, by whom, until when")
    show.set_defaults(work=_show)
    show.add_argument("files", type=Path, nargs="+", metavar="FILE")
    return parser


def _make(args: argparse.Namespace) -> int:
    now = datetime.now(UTC)
    wanted: list[tuple[str, Kind]] = [(args.router, "router"), ("map_update", "map_update")]
    for kind in KINDS:
        wanted += [(name, kind) for name in getattr(args, kind, ()) if kind not in ("router", "map_update")]
    check_hosts(args.host)  # all of it before anything is made: an authority is made once
    names = [name for name, _ in wanted]
    for name in names:
        check_name(name)
        check_length(name)
        if names.count(name) > 1:
            raise CertsError(f"{name}: named twice")
    authority = Authority.make(args.folder, name=args.name, days=args.authority_days, now=now)
    print(f"{args.folder / 'ca.pem'}: {args.name}, {args.authority_days:g} days")
    for name, kind in wanted:
        hosts = args.host if kind == "router" else ()
        _say(args.folder, authority.issue(name, kind, hosts=hosts, days=args.days, now=now))
    return 0


def _issue(args: argparse.Namespace) -> int:
    row = Authority(args.folder).issue(
        args.name, args.kind, hosts=args.host, days=args.days, now=datetime.now(UTC), renew=args.renew
    )
    _say(args.folder, row)
    return 0


def _revoke(args: argparse.Namespace) -> int:
    for row in Authority(args.folder).revoke(args.name, now=datetime.now(UTC)):
        print(f"{row.name}: {row.common_name}, serial {row.serial}, revoked; it would end {row.until}")
    print(
        "Not yet in force: make the router's rules anew with `camber access cloud`, and start the router again."
    )
    return 0


def _list(args: argparse.Namespace) -> int:
    now = datetime.now(UTC)
    issued, ca = Authority(args.folder).issued(), read_certificate(args.folder / "ca.pem")
    until, name = ca.not_valid_after_utc, common_name(ca.subject)
    print(f"{'name':<24} {'kind':<11} {'common name':<24} {'until':<26} state")
    print(f"{'ca':<24} {'authority':<11} {name:<24} {until.isoformat():<26} {_state(until - now)}")
    for row in issued:
        left = datetime.fromisoformat(row.until) - now
        state = f"revoked {row.revoked}" if row.revoked else _state(left)
        print(f"{row.name:<24} {row.kind:<11} {row.common_name:<24} {row.until:<26} {state}")
    return 0


def _show(args: argparse.Namespace) -> int:
    now, good = datetime.now(UTC), True
    for path in args.files:
        certificate = read_certificate(path)
        left = certificate.not_valid_after_utc - now
        early = certificate.not_valid_before_utc > now
        good &= left > timedelta() and not early
        print(f"{path}:")
        print(f"  who    {common_name(certificate.subject)} ({_uses(certificate)})")
        print(f"  by     {common_name(certificate.issuer)}")
        print(
            f"  from   {certificate.not_valid_before_utc.isoformat(' ')}{' NOT YET VALID' if early else ''}"
        )
        print(f"  until  {certificate.not_valid_after_utc.isoformat(' ')}, {_state(left)}")
        print(f"  serial {certificate.serial_number:x}")
        if hosts := _hosts(certificate):
            print(f"  hosts  {', '.join(hosts)}")
    return 0 if good else 1


def _say(folder: Path, row: Issued) -> None:
    print(f"{folder / row.name}.pem: {row.kind} {row.common_name}, until {row.until}")


def _state(left: timedelta) -> str:
    if left <= timedelta():
        return "EXPIRED"
    text = (
        f"{left.days} days left" if left >= timedelta(days=2) else f"{left.total_seconds() / 3600:.1f} h left"
    )
    return f"{text}: renew it" if left < RENEW_BEFORE else text


def _uses(certificate: x509.Certificate) -> str:
    try:
        constraints = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        if constraints.ca:
            return "an authority"
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return "no use named"
    return "joins and is joined" if ExtendedKeyUsageOID.SERVER_AUTH in usage else "joins"


def _hosts(certificate: x509.Certificate) -> list[str]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names if not isinstance(name, x509.UniformResourceIdentifier)]


if __name__ == "__main__":
    raise SystemExit(main())
