"""Certificate authority of a fleet, kept in a folder with the index of what it has issued.

    ca.pem, ca.key          the authority; the key never leaves this folder
    NAME.pem, NAME.key      one for each router, vehicle, service and consumer
    issued.json             all certificates issued: `IssuedCertificate`
    issued.lock             held while issuing or revoking
    NAME.key.new, .pem.new  a pair being written

Access rules refer to the common name: the name itself, and after a revocation `NAME+2` and so on. Zenoh has no
revocation lists, so a revoked common name is removed from the rules and never used again.
"""

from __future__ import annotations

import fcntl
import ipaddress
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, get_args

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from pydantic import TypeAdapter, ValidationError

from camber.runtime.tls_certificates import name_of
from camber.schemas.base import Name

Kind = Literal["router", "vehicle", "map_update", "consumer", "judge", "operator"]
KINDS: tuple[Kind, ...] = get_args(Kind)
INDEX, LOCK = "issued.json", "issued.lock"
LONGEST_NAME = 60
"""A common name has at most 64 characters (RFC 5280, ub-common-name), and `+2` may follow the name."""
_BACKDATED = timedelta(minutes=5)  # chosen: accepted at once by machines whose clocks are minutes slow
_Extension = tuple[x509.ExtensionType, bool]  # and whether it is critical
_RESERVED = frozenset({"ca", "fleet", "*"})
_NAME: TypeAdapter[str] = TypeAdapter(Name)
_LABEL = r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?"
_HOST = re.compile(rf"(?=.{{1,253}}$)(?!(.*\.)?\d+$)(\*\.)?({_LABEL}\.)*{_LABEL}")  # last label not a number


class CertsError(Exception):
    """An operation on certificates failed; one line for the user."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IssuedCertificate:
    """One row of the index; times are ISO 8601, UTC."""

    name: str
    kind: Kind
    common_name: str
    serial: str
    until: str
    revoked: str | None = None


class Authority:
    """The folder of an authority."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def make(cls, folder: Path, *, name: str, days: float, now: datetime) -> Authority:
        """A new authority; raises CertsError where there is one."""
        if not 0 < len(name) <= LONGEST_NAME:
            raise CertsError(f"{name!r}: expected a name of 1 to {LONGEST_NAME} characters")
        folder.mkdir(parents=True, exist_ok=True)
        key = ec.generate_private_key(ec.SECP256R1())
        extensions = [(x509.BasicConstraints(ca=True, path_length=0), True), (_key_usage(signs=True), True)]
        builder = _builder(name, _distinguished(name), key, extensions, now=now, days=days)
        authority = cls(folder)
        with authority._locked():
            _must_be_free(folder / "ca")
            _write_pair(folder / "ca", key, builder.sign(key, hashes.SHA256()))
            authority._save([])
        return authority

    def issued(self) -> list[IssuedCertificate]:
        """All certificates so far, oldest first."""
        path = self.folder / INDEX
        try:
            return [IssuedCertificate(**row) for row in json.loads(path.read_text("utf-8"))]
        except FileNotFoundError:
            raise CertsError(f"{path}: no such file; `camber certs make` makes an authority") from None
        except (OSError, ValueError, TypeError) as error:
            raise CertsError(f"{path}: {error}") from None

    def issue(
        self,
        name: str,
        kind: Kind,
        *,
        hosts: Sequence[str] = (),
        days: float,
        now: datetime,
        renew: bool = False,
    ) -> IssuedCertificate:
        """Issue a certificate and its key.

        `renew` replaces the existing files (the old certificate stays valid until it expires); without `hosts` the new
        one is for the same hosts.
        """
        check_name(name)
        check_hosts(hosts)
        with self._changing() as known:
            if kind == "router" and renew and not hosts:
                hosts = hosts_of(read_certificate(self.folder / f"{name}.pem"))
            if kind == "router" and not hosts:
                text = "a router's certificate needs the host names or addresses it is reached at"
                raise CertsError(f"{name}: {text}")
            common_name = self._common_name(known, name, kind, renew=renew)
            authority, signing_key = self._signer()
            until = authority.not_valid_after_utc
            if until <= now:
                raise CertsError(f"{self.folder / 'ca.pem'}: expired {_iso(until)}")
            if all(row.name != name for row in known):
                _must_be_free(self.folder / name)
            key = ec.generate_private_key(ec.SECP256R1())
            days = min(days, (until - now) / timedelta(days=1))
            by = x509.AuthorityKeyIdentifier.from_issuer_public_key(signing_key.public_key())
            extensions = [*_extensions(name, kind, hosts), (by, False)]
            builder = _builder(common_name, authority.subject, key, extensions, now=now, days=days)
            certificate = builder.sign(signing_key, hashes.SHA256())
            serial, end = f"{certificate.serial_number:x}", _iso(certificate.not_valid_after_utc)
            row = IssuedCertificate(name=name, kind=kind, common_name=common_name, serial=serial, until=end)
            self._save([*known, row])
            _write_pair(self.folder / name, key, certificate)
            return row

    def _common_name(self, known: list[IssuedCertificate], name: str, kind: Kind, *, renew: bool) -> str:
        """Return the common name of the next certificate of `name`; raises CertsError where there may be none."""
        of_name = [row for row in known if row.name == name]
        if any(row.kind != kind for row in of_name):
            raise CertsError(f"{name}: was issued as {of_name[-1].kind}, not as {kind}")
        in_use = [row for row in of_name if row.revoked is None]
        if in_use and not renew:
            raise CertsError(
                f"{self.folder / name}.pem: there is one already; --renew makes one in its place"
            )
        if not in_use:
            check_length(name)
        revoked = {row.common_name for row in of_name if row.revoked is not None}
        common_name = name if not revoked else f"{name}+{len(revoked) + 1}"
        if any(row.common_name == common_name and row.name != name for row in known):
            raise CertsError(f"{common_name}: this common name is another's")
        return common_name

    def revoke(self, name: str, *, now: datetime) -> list[IssuedCertificate]:
        """Mark all valid certificates of `name` as revoked; returns them."""
        with self._changing() as known:
            revoked = [row for row in known if row.name == name and row.revoked is None]
            if not revoked:
                raise CertsError(f"{name}: {self.folder} has no valid certificate of this name")
            self._save([replace(row, revoked=_iso(now)) if row in revoked else row for row in known])
        return revoked

    @contextmanager
    def _changing(self) -> Iterator[list[IssuedCertificate]]:
        """Hold the lock, recover from an interrupted write, and yield all certificates so far."""
        self.issued()  # raises before a lock file is left in a folder that is not an authority's
        with self._locked():
            _finish_pairs(self.folder)
            yield self.issued()

    @contextmanager
    def _locked(self) -> Iterator[None]:
        with (self.folder / LOCK).open("a") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def _signer(self) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
        certificate = read_certificate(self.folder / "ca.pem")
        path = self.folder / "ca.key"
        try:
            key = serialization.load_pem_private_key(path.read_bytes(), password=None)
        except OSError as error:
            raise CertsError(f"{path}: {error.strerror}") from None
        except (ValueError, TypeError):
            raise CertsError(f"{path}: not a private key in PEM without a password") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise CertsError(f"{path}: not the key of ca.pem")
        return certificate, key

    def _save(self, rows: list[IssuedCertificate]) -> None:
        path = self.folder / INDEX
        text = json.dumps([asdict(row) for row in rows], indent=1) + "\n"
        _write_temporary(path, text.encode(), 0o644).replace(path)


def check_name(name: str) -> None:
    """Raise CertsError for a name that cannot be part of a bus key."""
    try:
        _NAME.validate_python(name)
    except ValidationError:
        raise CertsError(
            f"{name!r}: not a name: a letter or digit, then up to 63 of A-Za-z0-9_.:@+-"
        ) from None
    if name in _RESERVED or name != name_of(name):
        raise CertsError(f"{name}: this name is reserved")


def check_length(name: str) -> None:
    """Raise CertsError for a new name that leaves no room for the suffix after a revocation."""
    if len(name) > LONGEST_NAME:
        raise CertsError(f"{name}: {len(name)} characters, expected at most {LONGEST_NAME}")


def check_hosts(hosts: Sequence[str]) -> None:
    """Raise CertsError for what is neither an IP address nor a host name."""
    for host in hosts:
        try:
            ipaddress.ip_address(host)
        except ValueError:
            if not _HOST.fullmatch(host):
                raise CertsError(
                    f"host {host!r}: expected an IP address, or a host name in ASCII (xn--… for others)"
                ) from None


def read_certificate(path: Path) -> x509.Certificate:
    """The first certificate of a PEM file; raises CertsError."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise CertsError(f"{path}: {error.strerror}") from None
    except ValueError:
        raise CertsError(f"{path}: not a certificate in PEM") from None


def common_name(name: x509.Name) -> str:
    """Return the common name of a distinguished name; empty where it has none."""
    attributes = name.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(attributes[0].value) if attributes else ""


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Return the host names and addresses that a certificate is valid for."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names if not isinstance(name, x509.UniformResourceIdentifier)]


def _builder(
    name: str,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    extensions: Sequence[_Extension],
    *,
    now: datetime,
    days: float,
) -> x509.CertificateBuilder:
    public, serial = key.public_key(), x509.random_serial_number()
    builder = x509.CertificateBuilder(issuer, _distinguished(name), public, serial)
    builder = builder.not_valid_before(now - _BACKDATED).not_valid_after(now + timedelta(days=days))
    for extension, critical in ((x509.SubjectKeyIdentifier.from_public_key(public), False), *extensions):
        builder = builder.add_extension(extension, critical)
    return builder


def _extensions(name: str, kind: Kind, hosts: Sequence[str]) -> list[_Extension]:
    server = [ExtendedKeyUsageOID.SERVER_AUTH] if kind == "router" else []
    # Strict verifiers require a subject alternative name in every certificate, also in a client's.
    names = [_general_name(host) for host in hosts] or [x509.UniformResourceIdentifier(f"urn:camber:{name}")]
    return [
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (_key_usage(signs=False), True),
        (x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH, *server]), False),
        (x509.SubjectAlternativeName(names), False),
    ]


def _distinguished(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _key_usage(*, signs: bool) -> x509.KeyUsage:
    others = ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement", "encipher_only")
    unused = dict.fromkeys((*others, "decipher_only"), False)
    return x509.KeyUsage(digital_signature=not signs, key_cert_sign=signs, crl_sign=signs, **unused)


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _must_be_free(stem: Path) -> None:
    for path in (stem.with_name(f"{stem.name}.key"), stem.with_name(f"{stem.name}.pem")):
        if path.exists():
            raise CertsError(f"{path}: there is one already; it is not overwritten")


def _write_pair(stem: Path, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
    """Write both files to disk, then rename them, key first: `_finish_pairs` completes an interrupted write."""
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    public = certificate.public_bytes(serialization.Encoding.PEM)
    files = ((".key", secret, 0o600), (".pem", public, 0o644))
    fresh = [_write_temporary(stem.with_name(stem.name + end), data, mode) for end, data, mode in files]
    for new in fresh:
        new.replace(new.with_suffix(""))


def _write_temporary(path: Path, data: bytes, mode: int) -> Path:
    """Write `path`.new through to the disk and return its path."""
    fresh = path.with_name(path.name + ".new")
    fresh.unlink(missing_ok=True)
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    return fresh


def _finish_pairs(folder: Path) -> None:
    """Complete or discard interrupted writes: a certificate is kept where its key was already renamed."""
    for fresh in folder.glob("*.pem.new"):
        path = fresh.with_suffix("")
        key, new_key = path.with_suffix(".key"), path.with_suffix(".key.new")
        if not new_key.exists() and _is_pair(fresh, key):
            fresh.replace(path)
        fresh.unlink(missing_ok=True)
    for fresh in folder.glob("*.key.new"):
        fresh.unlink()


def _is_pair(certificate: Path, key: Path) -> bool:
    try:
        read = serialization.load_pem_private_key(key.read_bytes(), password=None)
        return read.public_key() == x509.load_pem_x509_certificate(certificate.read_bytes()).public_key()
    except (OSError, ValueError, TypeError):
        return False


def _iso(time: datetime) -> str:
    return time.astimezone(UTC).isoformat(timespec="seconds")
