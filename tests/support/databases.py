"""PostgreSQL and NATS, as Debian packages them, on free ports of the loopback; with data in a folder of the test."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pwd
import random
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

POSTGRES = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
NATS = shutil.which("nats-server", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
needs_postgres = pytest.mark.skipif(not POSTGRES, reason="PostgreSQL is not installed")
needs_nats = pytest.mark.skipif(NATS is None, reason="nats-server is not installed")
START_LIMIT_S = 30.0
_INITDB = ("-U", "camber", "-A", "trust", "-E", "UTF8", "--no-locale", "-N")
CONFIGURATION = """
listen_addresses = '127.0.0.1'
unix_socket_directories = ''
max_connections = 40
max_wal_size = 4GB
shared_buffers = 128MB
log_min_messages = fatal
"""


def lasting_port() -> int:
    """A free port of the loopback that stays free while its server is down.

    Below those that the system gives to connecting clients (from 32768): a client that tries again and again would
    sooner or later be given the port that it tries, and hold it.
    """
    while True:
        port = random.SystemRandom().randrange(12_000, 32_000)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


class Server:
    """A server that is started, killed and started again, with a folder of its own; ended by its process id."""

    def __init__(self) -> None:
        # Not in a folder of pytest's, which are closed to the user that PostgreSQL runs as.
        self.folder = Path(tempfile.mkdtemp(prefix="camber-"))
        self.port = lasting_port()
        self.process: subprocess.Popen[bytes] | None = None

    def command(self) -> list[str]:
        raise NotImplementedError

    def start(self) -> None:
        """Start it, and wait until it listens."""
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                self.command(),
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                **self.identity(),
            )
        deadline = time.monotonic() + START_LIMIT_S
        while not self.ready():
            assert self.process.poll() is None, (self.folder / "log").read_text()[-2000:]
            assert time.monotonic() < deadline, f"{self.command()[0]} does not answer"
            time.sleep(0.02)

    def identity(self) -> dict[str, Any]:
        return {}

    def ready(self) -> bool:
        with socket.socket() as probe:
            probe.settimeout(1.0)
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def end(self) -> None:
        """Kill it and the processes that it has started.

        PostgreSQL gives each connection a process in a process group of its own, which outlives the first process
        until it notices that it is gone, and answers meanwhile.
        """
        if self.process is not None:
            pid = self.process.pid
            os.kill(pid, signal.SIGSTOP)  # starts no further ones
            for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(child), signal.SIGKILL)
            os.kill(pid, signal.SIGKILL)
            self.process.wait()
            self.process = None

    def remove(self) -> None:
        """End it for good, with all it holds."""
        self.end()
        shutil.rmtree(self.folder)


class PostgresServer(Server):
    """A cluster of one's own, durable as a real one. As root it is run as the user postgres, which it insists on."""

    def __init__(self) -> None:
        super().__init__()
        self._made = 0
        self.data = self.folder / "data"
        if os.geteuid() == 0:
            os.chown(self.folder, *self._ids())
        subprocess.run(
            [POSTGRES[-1] / "initdb", "-D", self.data, *_INITDB],
            check=True,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            **self.identity(),
        )
        with (self.data / "postgresql.conf").open("a") as file:
            file.write(f"{CONFIGURATION}port = {self.port}\n")

    @staticmethod
    def _ids() -> tuple[int, int]:
        user = pwd.getpwnam("postgres")
        return user.pw_uid, user.pw_gid

    def identity(self) -> dict[str, Any]:
        if os.geteuid() != 0:
            return {}
        uid, gid = self._ids()
        return {"user": uid, "group": gid, "extra_groups": []}

    def command(self) -> list[str]:
        return [str(POSTGRES[-1] / "postgres"), "-D", str(self.data)]

    def ready(self) -> bool:
        try:
            self.execute("SELECT 1")
        except Exception:  # whatever it is, it does not answer yet
            return False
        return True

    def address(self, database: str = "postgres") -> str:
        return f"postgresql://camber@127.0.0.1:{self.port}/{database}"

    def execute(self, *statements: str, database: str = "postgres") -> list[Any]:
        """The rows of the last statement."""
        import asyncpg

        async def run() -> list[Any]:
            connection = await asyncpg.connect(self.address(database), timeout=5.0)
            try:
                rows: list[Any] = []
                for statement in statements:
                    rows = await connection.fetch(statement)
                return rows
            finally:
                await connection.close(timeout=5.0)

        return asyncio.run(run())

    def new_database(self) -> str:
        """An address at which nothing is stored yet: a schema of its own, which is made faster than a database."""
        self._made += 1
        name = f"camber_{self._made}"
        self.execute(f"CREATE SCHEMA {name}")
        return f"{self.address()}?search_path={name}"


class NatsServer(Server):
    """JetStream with its streams in files."""

    def __init__(self) -> None:
        super().__init__()
        (self.folder / "nats.conf").write_text(
            f'listen: "127.0.0.1:{self.port}"\nmax_payload: 8MB\n'
            f'jetstream: {{store_dir: "{self.folder / "data"}"}}\n'
        )

    def command(self) -> list[str]:
        assert NATS is not None
        return [NATS, "-c", str(self.folder / "nats.conf")]

    @property
    def address(self) -> str:
        return f"nats://127.0.0.1:{self.port}"


S = TypeVar("S", bound=Server)


@contextmanager
def running(server: S) -> Iterator[S]:
    """Started, and removed whatever happens."""
    try:
        server.start()
        yield server
    finally:
        server.remove()
