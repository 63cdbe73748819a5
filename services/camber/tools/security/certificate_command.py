"""`camber certs`: create a certificate authority; issue, renew, revoke, list and show certificates of a fleet.

    camber certs make FOLDER --host cloud.example --vehicle car-1 --vehicle car-2 --consumer dashboard
    camber certs issue FOLDER car-3 --kind vehicle --days 30     issue one more, or replace one with --renew
    camber certs revoke FOLDER car-2                             `camber access` no longer lists it
    camber certs list FOLDER
    camber certs show FILE…                                      subject, issuer, validity

An existing authority can sign instead: Camber requires only that the common name is the name of the vehicle.
docs/security.md lists what each kind may do.
"""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from camber.runtime.tls_certificates import RENEW_BEFORE
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default, tool_parser
from camber.tools.security import certificate_authority

DAYS, AUTHORITY_DAYS = 30.0, 3650.0
"""Chosen: short, since Zenoh has no revocation lists; the authority ten years."""
_DAYS = number_from(0.001, 36_500.0, "days")


def main(argv: list[str] | None = None) -> int:
    """Return 0 on success, 2 on failure; `show` returns 1 where a certificate is not valid now."""
    args = _parser().parse_args(argv)
    try:
        code: int = args.work(args)
        return code
    except (certificate_authority.CertsError, OSError) as error:
        print(f"camber certs: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = tool_parser("camber certs", __doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    make, issue, revoke, listing, show = (
        commands.add_parser(name, help=text)
        for name, text in (
            ("make", "create an authority and a certificate for each name given"),
            ("issue", "issue a certificate signed by the authority of the folder"),
            ("revoke", "revoke all certificates of a name"),
            ("list", "list the certificates issued"),
            ("show", "print subject, issuer and validity of certificate files"),
        )
    )
    show.set_defaults(work=_show)
    show.add_argument("files", type=Path, nargs="+", metavar="FILE")
    for command, work in ((make, _make), (issue, _issue), (revoke, _revoke), (listing, _list)):
        command.set_defaults(work=work)
        command.add_argument("folder", type=Path, metavar="FOLDER")
    make.add_argument("--name", default="Camber development", help="name of the authority")
    make.add_argument("--router", default="cloud", metavar="NAME", help="name of the cloud's router (cloud)")
    text = "host name or address of a router; repeatable"
    make.add_argument("--host", action="append", required=True, help=text)
    for kind in ("vehicle", "consumer", "judge", "operator"):
        make.add_argument(f"--{kind}", action="append", default=[], metavar="NAME", help="repeatable")
    make.add_argument("--authority-days", type=_DAYS, default=AUTHORITY_DAYS, metavar="DAYS")
    for command in (issue, revoke):
        command.add_argument("name", metavar="NAME")
    issue.add_argument("--kind", choices=certificate_authority.KINDS, required=True)
    issue.add_argument(
        "--host", action="append", default=[], help=f"{text} (with --renew default: unchanged)"
    )
    issue.add_argument("--renew", action="store_true", help="replace the existing certificate")
    for command in (make, issue):
        add_with_default(command, "--days", DAYS, "validity of certificates", type=_DAYS)
    return parser


def _make(args: argparse.Namespace) -> int:
    now = datetime.now(UTC)
    wanted: list[tuple[str, certificate_authority.Kind]] = [
        (args.router, "router"),
        ("map_update", "map_update"),
    ]
    for kind in certificate_authority.KINDS:
        wanted += [(name, kind) for name in getattr(args, kind, ()) if kind not in ("router", "map_update")]
    certificate_authority.check_hosts(
        args.host
    )  # check all arguments first: an authority can be created only once
    names = [name for name, _ in wanted]
    for name in names:
        certificate_authority.check_name(name)
        certificate_authority.check_length(name)
        if names.count(name) > 1:
            raise certificate_authority.CertsError(f"{name}: named twice")
    authority = certificate_authority.Authority.make(
        args.folder, name=args.name, days=args.authority_days, now=now
    )
    print(f"{args.folder / 'ca.pem'}: {args.name}, {args.authority_days:g} days")
    for name, kind in wanted:
        hosts = args.host if kind == "router" else ()
        _print_issued(args.folder, authority.issue(name, kind, hosts=hosts, days=args.days, now=now))
    return 0


def _issue(args: argparse.Namespace) -> int:
    row = certificate_authority.Authority(args.folder).issue(
        args.name, args.kind, hosts=args.host, days=args.days, now=datetime.now(UTC), renew=args.renew
    )
    _print_issued(args.folder, row)
    return 0


def _revoke(args: argparse.Namespace) -> int:
    for row in certificate_authority.Authority(args.folder).revoke(args.name, now=datetime.now(UTC)):
        print(f"{row.name}: {row.common_name}, serial {row.serial}, revoked; it expires {row.until}")
    print(
        "Not yet in force: regenerate the router's rules with `camber access cloud`, then restart the router."
    )
    return 0


def _list(args: argparse.Namespace) -> int:
    now = datetime.now(UTC)
    issued = certificate_authority.Authority(args.folder).issued()
    ca = certificate_authority.read_certificate(args.folder / "ca.pem")
    until, name = ca.not_valid_after_utc, certificate_authority.common_name(ca.subject)
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
        certificate = certificate_authority.read_certificate(path)
        left = certificate.not_valid_after_utc - now
        early = certificate.not_valid_before_utc > now
        good &= left > timedelta() and not early
        not_yet = " NOT YET VALID" if early else ""
        print(
            f"{path}:",
            f"  who    {certificate_authority.common_name(certificate.subject)} ({_uses(certificate)})",
            f"  by     {certificate_authority.common_name(certificate.issuer)}",
            f"  from   {certificate.not_valid_before_utc.isoformat(' ')}{not_yet}",
            f"  until  {certificate.not_valid_after_utc.isoformat(' ')}, {_state(left)}",
            f"  serial {certificate.serial_number:x}",
            sep="\n",
        )
        if hosts := certificate_authority.hosts_of(certificate):
            print(f"  hosts  {', '.join(hosts)}")
    return 0 if good else 1


def _print_issued(folder: Path, row: certificate_authority.IssuedCertificate) -> None:
    print(f"{folder / row.name}.pem: {row.kind} {row.common_name}, until {row.until}")


def _state(left: timedelta) -> str:
    if left <= timedelta():
        return "EXPIRED"
    in_hours = left < timedelta(days=2)
    text = f"{left.total_seconds() / 3600:.1f} h left" if in_hours else f"{left.days} days left"
    return f"{text}: renew it" if left < RENEW_BEFORE else text


def _uses(certificate: x509.Certificate) -> str:
    try:
        constraints = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        if constraints.ca:
            return "an authority"
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return "no extended key usage"
    return "client and server" if ExtendedKeyUsageOID.SERVER_AUTH in usage else "client"
