"""Checks of the machine for `camber doctor`: clock, disk, certificates, cache of machine code."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import stat
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from camber.geodesy.gps_time import gps_minus_utc_s
from camber.runtime.clock import SystemClock
from camber.runtime.tls_certificates import RENEW_BEFORE

State = Literal["ok", "problem", "not checked"]

MOST_CLOCK_ERROR_S = 0.05  # chosen: moves a fix at 20 m/s by 1 m against the pose
LEAST_FREE_BYTES = 500 << 20  # chosen: an hour of uploads and logs
SLOW_FSYNC_S = 0.5  # chosen: each upload waits for one flush, and verdicts come five to ten times a second
_EARLIEST_UNIX_S = 1_704_067_200  # 2024-01-01: an earlier time means that the clock was never set
_TAI_MINUS_GPS_S = 19  # constant by definition of GPS time, IS-GPS-200


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The result of one check, with the remedy of a problem."""

    what: str
    state: State
    text: str
    todo: str = ""

    def __str__(self) -> str:
        return f"{self.state:<11} {self.what}: {self.text}{f' → {self.todo}' if self.todo else ''}"


def ok(what: str, text: str) -> Finding:
    """Return a passed check."""
    return Finding(what=what, state="ok", text=text)


def problem(what: str, text: str, todo: str) -> Finding:
    """Return a problem with its remedy."""
    return Finding(what=what, state="problem", text=text, todo=todo)


def not_checked(what: str, why: str) -> Finding:
    """Return a check that is not possible here."""
    return Finding(what=what, state="not checked", text=why)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockDiscipline:
    """The kernel's report on its clock: synchronised by NTP or PTP, largest error, TAI − UTC (0: not known)."""

    synchronised: bool
    most_error_s: float
    tai_minus_utc_s: int


class _Timex(ctypes.Structure):
    """`struct timex` of Linux (adjtimex(2)), on 64 bits."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        *((name, ctypes.c_long) for name in ("offset", "freq", "maxerror", "esterror")),
        ("status", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("constant", "precision", "tolerance", "sec", "usec", "tick")),
        ("shift", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("stabil", "jitcnt", "calcnt", "errcnt", "stbcnt")),
        ("tai", ctypes.c_int),
        ("padding", ctypes.c_int * 11),
    )


_STA_UNSYNC, _TIME_ERROR = 0x0040, 5  # linux/timex.h


def kernel_discipline() -> ClockDiscipline | None:
    """Return the clock's discipline by adjtimex(2), or None where the kernel does not report it."""
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):
        return None
    timex = _Timex()
    state = adjtimex(ctypes.byref(timex))
    if state < 0:
        return None
    synchronised = state != _TIME_ERROR and not timex.status & _STA_UNSYNC
    return ClockDiscipline(
        synchronised=synchronised, most_error_s=timex.maxerror / 1e6, tai_minus_utc_s=timex.tai
    )


def check_clock(discipline: ClockDiscipline | None, unix_s: float) -> Iterator[Finding]:
    """Check that the clock is plausible and synchronised, and that leap seconds agree with Camber's table."""
    if unix_s < _EARLIEST_UNIX_S:
        date = f"it is {datetime.fromtimestamp(unix_s, UTC):%Y-%m-%d}"
        yield problem("clock", date, "set it: without a time no fix is judged")
        return
    if discipline is None:
        yield not_checked("clock", "the kernel does not report whether it is synchronised")
        return
    error_s = discipline.most_error_s
    if not discipline.synchronised:
        remedy = "start chrony, systemd-timesyncd or phc2sys; stale messages are refused"
        yield problem("clock", "not synchronised by NTP or PTP", remedy)
    elif error_s > MOST_CLOCK_ERROR_S:
        remedy = f"a nearer time server: expected {MOST_CLOCK_ERROR_S} s or less"
        yield problem("clock", f"synchronised, but up to {error_s:.3f} s off", remedy)
    else:
        yield ok("clock", f"synchronised, at most {1e3 * error_s:.1f} ms off")
    known_s = gps_minus_utc_s(max(SystemClock().now_ns(), 0))
    kernel_s = discipline.tai_minus_utc_s - _TAI_MINUS_GPS_S
    what, text = "leap seconds", f"GPS − UTC is {known_s} s here"
    if discipline.tai_minus_utc_s == 0:
        yield ok(what, f"{text}; the kernel does not report it")
    elif kernel_s != known_s:
        remedy = "update Camber, or the machine's leap second file (tzdata)"
        yield problem(what, f"{text}, {kernel_s} s for the kernel", remedy)
    else:
        yield ok(what, f"{text} and in the kernel")


def check_folder(what: str, folder: Path, *, least_free_bytes: int = LEAST_FREE_BYTES) -> Finding:
    """Check a state folder: it exists or can be made, is writable, flushes quickly and has room."""
    # os.path reports False without permission; the nearest accessible folder then gives the reason.
    place = next((path for path in (folder, *folder.parents) if os.path.exists(path)), Path("/"))
    if not os.path.isdir(place):
        return problem(what, f"{place} is not a folder", "remove it, or set another folder")
    probe = place / f".camber-doctor-{uuid.uuid4().hex}"
    began_s = time.monotonic()
    try:
        with probe.open("wb") as file:
            file.write(b"\0" * 4096)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        text = f"{place}: {error.strerror or error} as user {os.getuid()}"
        return problem(what, text, "owner, mount options and free space of this folder")
    finally:
        with suppress(OSError):
            probe.unlink()
    took_s = time.monotonic() - began_s
    free = shutil.disk_usage(place).free
    if free < least_free_bytes:
        remedy = f"make room: expected {least_free_bytes >> 20} MB or more"
        return problem(what, f"{place}: {free >> 20} MB free", remedy)
    if took_s > SLOW_FSYNC_S:
        return problem(what, f"{place}: a flush took {took_s:.1f} s", "a faster disk: uploads wait for it")
    made = "" if place == folder else f", {folder} will be created"
    return ok(what, f"{place}: {free >> 20} MB free, a flush takes {1e3 * took_s:.0f} ms{made}")


def check_certificates(what: str, files: tuple[Path | None, ...], now: datetime) -> Iterator[Finding]:
    """Check authority, certificate and key: readable, valid, signed by the authority; the key fits and is private."""
    authority, certificate, key = files
    authorities = _read(authority)
    if isinstance(authorities, str):
        yield problem(f"{what}, authority", authorities, "camber certs")
    elif authority is not None:
        yield from (_check_validity(f"{what}, authority", each, now) for each in authorities)
    chain = _read(certificate)
    if isinstance(chain, str):
        yield problem(f"{what}, certificate", chain, "camber certs")
    elif chain:
        yield _check_validity(f"{what}, certificate", chain[0], now)
        if not isinstance(authorities, str) and authorities:
            yield _check_issuer(f"{what}, certificate", chain[0], authorities)
    if key is not None:
        yield _check_key(f"{what}, key", key, None if isinstance(chain, str) or not chain else chain[0])


def _read(path: Path | None) -> list[x509.Certificate] | str:
    if path is None:
        return []
    try:
        return x509.load_pem_x509_certificates(path.read_bytes())
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    except ValueError:
        return f"{path}: expected a certificate in PEM"


def _check_validity(what: str, certificate: x509.Certificate, now: datetime) -> Finding:
    name = certificate.subject.rfc4514_string()
    begins, ends = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now < begins:
        return problem(what, f"{name}: not valid before {begins:%Y-%m-%d %H:%M} UTC", "check the clock")
    if now >= ends:
        return problem(what, f"{name}: expired {ends:%Y-%m-%d %H:%M} UTC", "camber certs: issue a new one")
    if ends - now < RENEW_BEFORE:
        return problem(what, f"{name}: expires {ends:%Y-%m-%d}", "camber certs: issue a new one now")
    return ok(what, f"{name}, until {ends:%Y-%m-%d}")


def _check_issuer(what: str, certificate: x509.Certificate, authorities: list[x509.Certificate]) -> Finding:
    for authority in authorities:
        try:
            certificate.verify_directly_issued_by(authority)
            return ok(what, f"signed by {authority.subject.rfc4514_string()}")
        except (ValueError, TypeError, InvalidSignature):
            continue
    remedy = "certificate and authority of the same `camber certs`"
    return problem(what, "not signed by this authority", remedy)


def _check_key(what: str, path: Path, certificate: x509.Certificate | None) -> Finding:
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        key = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        return problem(what, f"{path}: {error.strerror or error}", "owner and mode of this file")
    except (ValueError, TypeError):
        return problem(what, f"{path}: expected a private key in PEM, without a password", "camber certs")
    if mode & 0o077:
        return problem(what, f"{path}: mode {mode:04o}: others may read it", f"chmod 600 {path}")
    if certificate is None:
        return ok(what, f"{path}: mode {mode:04o}")
    if key.public_key() != certificate.public_key():
        remedy = "certificate and key that were issued together"
        return problem(what, f"{path}: not the key of the certificate", remedy)
    return ok(what, f"{path}: mode {mode:04o}, of this certificate")


def check_python() -> Iterator[Finding]:
    """Check the interpreter and the cache of machine code, without which every start compiles for a minute."""
    yield ok("Python", ".".join(map(str, sys.version_info[:3])))
    if importlib.util.find_spec("numba") is None:
        yield not_checked("machine code", "numba is not installed; it comes with the services that need it")
        return
    spec = importlib.util.find_spec("camber.compiled")
    package = Path((spec.submodule_search_locations or ["/"])[0]) if spec is not None else Path("/")
    named = os.environ.get("NUMBA_CACHE_DIR")
    places = [Path(named)] if named else [package, Path.home() / ".cache"]
    for place in places:
        finding = check_folder("machine code", place, least_free_bytes=50 << 20)
        if finding.state == "ok":
            yield finding
            return
    if next((package / "__pycache__").glob("*.nbc"), None):
        yield ok("machine code", f"shipped in {package}")
        return
    text = f"none of {', '.join(map(str, places))} is writable: compiled again at each start"
    yield problem("machine code", text, "set NUMBA_CACHE_DIR to a writable folder")
