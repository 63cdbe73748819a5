"""Certificates, routers and links of a fleet on the loopback, for tests: real processes, real TLS."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from socket import create_connection, create_server, socket
from typing import Any

import zenoh

from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.tools.security import access
from camber.tools.security.certificates import Authority, Kind
from support.running import environment, free_port, wait_until

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


def cloud_file(certificates: Certificates, endpoint: str, path: Path, *more: str) -> Path:
    """What `camber access cloud` makes of all that was issued."""
    folder = str(certificates.folder)
    words = ["cloud", "--certs", folder, "--tls", folder, "--listen", endpoint, "--out", str(path), *more]
    assert access.main(words) == 0
    return path


def vehicle_file(
    certificates: Certificates, name: str, inside: str, path: Path, *connect: str, more: Sequence[str] = ()
) -> Path:
    """What `camber access vehicle` makes."""
    words = ["vehicle", name, "--listen", inside, "--tls", str(certificates.folder), "--out", str(path)]
    for endpoint in connect:
        words += ["--connect", endpoint]
    assert access.main([*words, *more]) == 0
    return path


@dataclass
class Router:
    """A `camber router` process; `output` is all it has printed so far."""

    process: subprocess.Popen[str]
    log: Path

    @property
    def output(self) -> str:
        return self.log.read_text("utf-8")

    def end(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@contextmanager
def router(file: Path) -> Iterator[Router]:
    """`camber router --config-file FILE`, until it is left."""
    log = file.with_suffix(".log")
    with log.open("a") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "camber.cli", "router", "--config-file", str(file)],
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
            text=True,
        )
    running = Router(process, log)
    try:
        wait_until(lambda: "listens on" in running.output, timeout_s=30.0, why=f"{file.name} was not read")
        yield running
    finally:
        running.end()


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
        from camber.runtime.tls import tls_table

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


class CountedLink:
    """Passes what comes on to a port of the loopback, both ways, and counts the bytes; can be cut."""

    def __init__(self, port: int) -> None:
        self._to = port
        self.up = self.down = 0
        self._open: list[socket] = []
        self._cut = False
        self._server = create_server((HOST, 0))
        self.port = int(self._server.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self, cut: bool) -> None:
        """From now on nothing passes, or it does again."""
        self._cut = cut
        for end in self._open if cut else ():
            end.close()

    def close(self) -> None:
        self.cut(True)
        self._server.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
                if self._cut:
                    near.close()
                    continue
                far = create_connection((HOST, self._to))
            except OSError:
                if self._server.fileno() < 0:
                    return
                near.close()
                continue
            self._open += [near, far]
            threading.Thread(target=self._pass, args=(near, far, "up"), daemon=True).start()
            threading.Thread(target=self._pass, args=(far, near, "down"), daemon=True).start()

    def _pass(self, source: socket, sink: socket, direction: str) -> None:
        try:
            while data := source.recv(1 << 16):
                setattr(self, direction, getattr(self, direction) + len(data))
                sink.sendall(data)
        except OSError:
            pass
        finally:
            source.close()
            sink.close()
