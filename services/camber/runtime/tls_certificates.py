"""What joining over TLS needs, looked at before Zenoh does: its own words do not name the file that is at fault."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

from camber.schemas.plain_file import read_plain_file

_MOST_BYTES = 1 << 20  # chosen: a bundle of authorities has some 200 kB
_GENERATION = re.compile(r"\+\d+$")
RENEW_BEFORE = timedelta(days=14)
"""So long before its end a certificate is to be renewed: warnings are given from then on."""
_READERS = {
    "root_ca_certificate": x509.load_pem_x509_certificate,
    "listen_certificate": x509.load_pem_x509_certificate,
    "listen_private_key": lambda data: load_pem_private_key(data, password=None),
    "connect_certificate": x509.load_pem_x509_certificate,
    "connect_private_key": lambda data: load_pem_private_key(data, password=None),
}


class TlsError(ValueError):
    """A certificate or a key cannot be used; one line that names the file and nothing of what is in a key."""


def tls_table(ca: Path, certificate: Path, key: Path) -> dict[str, Any]:
    """Zenoh's `transport/link/tls`: both sides show a certificate, and a link does not outlive either."""
    return {
        "root_ca_certificate": str(ca),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        "listen_certificate": str(certificate),
        "listen_private_key": str(key),
        "connect_certificate": str(certificate),
        "connect_private_key": str(key),
    }


def check_table(table: dict[str, Any]) -> None:
    """Raises TlsError for the first file of a `transport/link/tls` that is missing, damaged, foreign or expired."""
    read: dict[str, Any] = {}
    for name, reader in _READERS.items():
        if table.get(name):
            read[name] = _read(Path(table[name]), reader, secret="key" in name)
    now = datetime.now(UTC)
    for role in ("listen", "connect"):
        certificate, key = read.get(f"{role}_certificate"), read.get(f"{role}_private_key")
        path = table.get(f"{role}_certificate")
        if certificate is None:
            continue
        if certificate.not_valid_after_utc <= now:
            raise TlsError(f"{path}: expired {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; renew it")
        if certificate.not_valid_before_utc > now:
            raise TlsError(
                f"{path}: not valid before {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC; "
                "is this machine's clock right?"
            )
        if key is not None and key.public_key() != certificate.public_key():
            raise TlsError(f"{table[f'{role}_private_key']}: not the key of {path}")
        ca = read.get("root_ca_certificate")
        if ca is not None and certificate.issuer != ca.subject:
            raise TlsError(f"{path}: not signed by {table['root_ca_certificate']}")


def ends_soon(table: dict[str, Any], now: datetime) -> list[str]:
    """One line for each certificate of a `transport/link/tls`, and its authority's, that ends within 14 days."""
    lines = []
    for path in dict.fromkeys(table.get(name) for name in _READERS if "certificate" in name):
        try:
            certificate = _read(Path(path), x509.load_pem_x509_certificate, secret=False) if path else None
        except TlsError:
            continue  # reported where it is used
        if certificate is not None and certificate.not_valid_after_utc < now + RENEW_BEFORE:
            lines.append(f"{path}: until {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; renew it")
    return lines


def certificate_name(path: Path) -> str:
    """The common name in a certificate; raises TlsError."""
    certificate = _read(path, x509.load_pem_x509_certificate, secret=False)
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if not names:
        raise TlsError(f"{path}: a certificate without a common name; access rules go by it")
    return str(names[0].value)


def name_of(common_name: str) -> str:
    """The name that a common name stands for: after a revocation `camber certs` adds `+2`, `+3` …"""
    return _GENERATION.sub("", common_name)


def _read(path: Path, reader: Any, *, secret: bool) -> Any:
    try:
        return reader(read_plain_file(path, _MOST_BYTES))
    except OSError as error:
        raise TlsError(f"{path}: {error.strerror}") from None
    except (ValueError, TypeError):
        what = "a private key in PEM without a password" if secret else "a certificate in PEM"
        raise TlsError(f"{path}: not {what}") from None
