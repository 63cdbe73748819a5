"""What CI's script says: nothing is skipped silently, nothing takes too long silently."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from support.tree import ROOT

PROGRAMS = {
    "docker": 'case "$1" in info) {info} ;; compose) {compose} ;; esac',
    "dpkg-query": "echo install ok installed",
    # Nothing is installed by a test.
    **dict.fromkeys(("apt-get", "sudo"), "exit 1"),
    **dict.fromkeys(
        ("make", "git", "rnx2rtkp", "ip", "iptables", "nats-server", "chromium", "python3"), "exit 0"
    ),
}
NO_ENGINE = "ci: SKIPPED what needs a container engine"


def ci(folder: Path, *, info: bool = True, compose: bool = True, took_s: int = 0) -> str:
    """What it says where every stage is well and the container engine answers these two."""
    (folder / ".ci").mkdir()
    (folder / "stubs").mkdir()
    shutil.copy(ROOT / ".ci" / "run", folder / ".ci")
    answers = {"info": "true" if info else "false", "compose": "true" if compose else "false"}
    for name, text in PROGRAMS.items():
        path = folder / "stubs" / name
        path.write_text(f"#!/bin/sh\n{text.format(**answers) if name == 'docker' else text}\n")
        path.chmod(0o755)
    environ = {**os.environ, "PATH": f"{folder / 'stubs'}:{os.environ['PATH']}", "CAMBER_DATA": str(folder)}
    environ["SECONDS"] = str(took_s)  # from where bash counts on
    command = ["bash", str(folder / ".ci" / "run")]
    return subprocess.run(command, env=environ, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(("info", "compose"), [(True, False), (False, True), (False, False)])
def test_it_says_where_containers_cannot_be_tested(tmp_path: Path, info: bool, compose: bool) -> None:
    """The tests need both, as they say themselves where they skip."""
    assert NO_ENGINE in ci(tmp_path, info=info, compose=compose)


def test_it_says_nothing_of_containers_where_they_are_tested(tmp_path: Path) -> None:
    output = ci(tmp_path)
    assert "ci: took" in output
    assert NO_ENGINE not in output
    assert "TOO LONG" not in output


def test_on_a_slow_machine_it_says_so_and_does_not_fail(tmp_path: Path) -> None:
    assert "ci: TOO LONG on this machine" in ci(tmp_path, took_s=1600)
