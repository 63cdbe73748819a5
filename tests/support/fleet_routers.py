"""Certificates, routers and links of a fleet on the loopback, for tests: real processes, real TLS."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import zenoh

from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.tools.security import access
from camber.tools.security.certificate_authority import Authority, Kind
from support.running import camber_started, free_port, wait_until

HOST = "127.0.0.1"


@dataclass(frozen=True)
class Certificates:
    """An authority with one certificate of each kind and two vehicles, one that is revoked, one that has expired,
    and the certificate of another authority in the name of car-1."""

    folder: Path
    foreign: Path

    def settings(self, who: str, endpoint: str) -> ZenohSettings:
        """To join as this one; `other authority` has the name of car-1."""
        folder, name = (self.foreign, "car-1") if who == "other authority" else (self.folder, who)
        return ZenohSettings(
            mode="client",
            connect=[endpoint],
            # The router is to refuse it, not we the router.
            tls_ca=self.folder / "ca.pem",
            tls_certificate=folder / f"{name}.pem",
            tls_key=folder / f"{name}.key",
        )

    def cloud_file(self, endpoint: str, *more: str) -> Path:
        """What `camber access cloud` makes of all that was issued."""
        path = self.folder.parent / f"cloud-{endpoint.rpartition(':')[2]}.json5"
        issued = ("--certs", str(self.folder), "--tls", str(self.folder))
        assert access.main(["cloud", *issued, "--listen", endpoint, "--out", str(path), *more]) == 0
        return path

    def vehicle_file(self, name: str, inside: str, *connect: str, to: Sequence[str] = ()) -> Path:
        """What `camber access vehicle` makes."""
        path = self.folder.parent / f"{name}.json5"
        made = ("vehicle", name, "--listen", inside, "--tls", str(self.folder), "--out", str(path))
        links = [part for endpoint in connect for part in ("--connect", endpoint)]
        assert access.main([*made, *links, *(("--to", *to) if to else ())]) == 0
        return path


def make_certificates(folder: Path, *, host: str = HOST, vehicle: str = "car-1") -> Certificates:
    now = datetime.now(UTC)
    ours = Authority.make(folder / "ours", name="ours", days=30, now=now)
    kinds: tuple[tuple[str, Kind], ...] = (
        ("cloud", "router"),
        ("map_update", "map_update"),
        (vehicle, "vehicle"),
        ("car-2", "vehicle"),
        ("consumer", "consumer"),
        ("operator", "operator"),
        ("revoked", "vehicle"),
    )
    for name, kind in kinds:
        ours.issue(name, kind, hosts=[host] if kind == "router" else (), days=20, now=now)
    ours.revoke("revoked", now=now)
    ours.issue("expired", "vehicle", days=1, now=now - timedelta(days=2))
    # Of the authority, but in no list.
    ours.issue("unlisted", "vehicle", days=20, now=now)
    ours.revoke("unlisted", now=now)
    foreign = Authority.make(folder / "foreign", name="foreign", days=30, now=now)
    foreign.issue(vehicle, "vehicle", days=20, now=now)
    return Certificates(ours.folder, foreign.folder)


@dataclass
class Router:
    """A `camber router` process; `output` is all it has printed so far."""

    process: subprocess.Popen[str]
    log: Path

    @property
    def output(self) -> str:
        return self.log.read_text("utf-8")

    def wait_for(self, text: str, *, timeout_s: float = 60.0) -> None:
        wait_until(lambda: text in self.output, timeout_s=timeout_s, why=f"{text!r} is not printed")


@contextmanager
def router(file: Path) -> Iterator[Router]:
    """`camber router --config-file FILE`, until it is left."""
    log = file.with_suffix(".log")
    with log.open("a") as stream, camber_started("router", "--config-file", file, stdout=stream) as process:
        running = Router(process, log)
        running.wait_for("listens on", timeout_s=30.0)
        yield running


def tls_endpoint() -> str:
    return f"tls/{HOST}:{free_port()}"


def joined(settings: ZenohSettings, *, timeout_s: float = 20.0) -> zenoh.Session:
    """A session that has found its router."""
    session = open_session(settings, timeout_s=timeout_s)
    wait_until(lambda: list(session.info.routers_zid()), timeout_s=timeout_s, why="no router was found")
    return session


def unchecked(settings: ZenohSettings, *, mode: str = "client") -> Any:
    """Try to join without looking at one's own certificate first, as a foreign program would: a session or None."""
    from camber.runtime import session as module

    config = module._base(None)
    if settings.tls_certificate is not None:
        from camber.runtime.tls_certificates import tls_table

        assert settings.tls_ca is not None
        assert settings.tls_key is not None
        table = tls_table(settings.tls_ca, settings.tls_certificate, settings.tls_key)
    else:
        table = {"root_ca_certificate": str(settings.tls_ca), "verify_name_on_connect": True}
    module._put(config, "mode", mode)
    module._put(config, "transport/link/tls", table)
    module._put(config, "connect/endpoints", settings.connect)
    module._put(config, "connect/timeout_ms", 3000)
    module._put(config, "connect/exit_on_failure", True)
    module._depart_from_defaults(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None
