"""Compose projects of a test: names of their own, free ports, gone afterwards."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from support.tree import ROOT

BUILD_LIMIT_S = 1800.0
RELEASE = "local"


def missing_engine() -> str | None:
    """Why containers cannot be run here; None: they can."""
    if shutil.which("docker") is None:
        return "there is no docker command"
    for command in (["docker", "info"], ["docker", "compose", "version"]):
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            return f"`{' '.join(command)}` fails: no container engine answers"
    return None


def skip_without_engine() -> None:
    reason = missing_engine()
    if reason is not None:
        pytest.skip(reason)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def docker(*arguments: str, timeout_s: float = 60.0, check: bool = True) -> str:
    """`docker …`; its output, or an AssertionError with its output."""
    return _run(["docker", *arguments], dict(os.environ), timeout_s, check)


def _run(command: list[str], environ: dict[str, str], timeout_s: float, check: bool) -> str:
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=environ,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    assert done.returncode == 0 or not check, (
        f"{' '.join(command)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    )
    return done.stdout


class Stack:
    """The compose file with one profile; images are those that `camber` has, so that they are built once."""

    def __init__(self, name: str, profile: str, **variables: str | Path) -> None:
        self.project = f"camber-{name}-{os.getpid()}"
        self.profile = profile
        self.port, self.cloud_port, self.live_port = free_port(), free_port(), free_port()
        kept = {
            name: text for name, text in os.environ.items() if not name.startswith(("CAMBER_", "COMPOSE_"))
        }
        self._environ = {
            **kept,
            "CAMBER_IMAGES": f"localhost/{self.project}",
            "CAMBER_PORT": str(self.port),
            "CAMBER_LIVE_PORT": str(self.live_port),
            "CAMBER_CLOUD_PORT": f"127.0.0.1:{self.cloud_port}",
            "CAMBER_CPUS": str(min(2, os.cpu_count() or 1)),
            **{f"CAMBER_{name.upper()}": str(value) for name, value in variables.items()},
        }

    def compose(
        self, *arguments: str, timeout_s: float = 60.0, check: bool = True, release: str = RELEASE
    ) -> str:
        """`docker compose …`; its output, or an AssertionError with its output."""
        command = ["docker", "compose", "--project-name", self.project, "--profile", self.profile]
        return _run([*command, *arguments], {**self._environ, "CAMBER_RELEASE": release}, timeout_s, check)

    def image(self, service: str, release: str = RELEASE) -> str:
        """The name of a service's image."""
        return f"localhost/{self.project}/{service}:{release}"

    def build(self) -> None:
        """Images of all services, in the cache of the engine after the first time."""
        self.compose("build", "--quiet", timeout_s=BUILD_LIMIT_S)

    def services(self) -> list[str]:
        """Those of the profile."""
        return sorted(json.loads(self.compose("config", "--format", "json"))["services"])

    def container(self, service: str) -> str:
        """The id of a service's container, running or not."""
        return self.compose("ps", "--all", "--quiet", service).strip()

    def rows(self) -> list[dict[str, Any]]:
        """What `docker compose ps` says of each container."""
        text = self.compose("ps", "--all", "--format", "json")
        return [json.loads(row) for row in text.splitlines()]

    def states(self) -> dict[str, str]:
        """Health by service."""
        return {row["Service"]: row["Health"] for row in self.rows()}

    def inside(self, service: str, *command: str, check: bool = True) -> str:
        """A command in a running container."""
        return self.compose("exec", "-T", service, *command, check=check)

    def health(self, service: str) -> dict[str, Any]:
        """What a service says of itself; empty while it says nothing."""
        command = ("camber", "health", service, "--config", f"/etc/camber/{service}.toml", "--json")
        text = self.inside(service, *command, check=False)
        listed: dict[str, Any] = json.loads(text) if text.startswith("{") else {}
        return listed


@contextmanager
def stack(name: str, profile: str, **variables: str | Path) -> Iterator[Stack]:
    """A project with its images built; whatever it started is gone at the end, and its logs are shown on failure."""
    project = Stack(name, profile, **variables)
    try:
        project.build()
        yield project
    except BaseException:
        print(project.compose("logs", "--no-color", "--tail", "20", check=False))
        raise
    finally:
        project.compose("down", "--volumes", "--rmi", "all", "--timeout", "3", timeout_s=120.0)
