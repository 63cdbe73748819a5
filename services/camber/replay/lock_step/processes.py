"""Starts the services of a drive as real processes, keeps them running, ends them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from camber.schemas.drive import ManifestError

_REFUSES = 2  # a service's exit code where its settings are wrong
_RESTARTS = 20  # of one service in one run; beyond that it stays down


@dataclass(slots=True)
class _Child:
    process: subprocess.Popen[bytes]
    restarts: int = 0


@dataclass(slots=True, kw_only=True)
class Processes:
    """The processes of one run; `folder` holds their settings, logs and state."""

    folder: Path
    configs: Mapping[str, Mapping[str, Any]]
    _children: dict[str, _Child] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def start(self) -> None:
        """Write each service's settings and start it."""
        for name, config in self.configs.items():
            path = self.folder / "config" / f"{name}.toml"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(config_text(config), "utf-8")
            self._children[name] = _Child(self._spawn(name))
        self._write_pids()

    def restart_ended(self) -> None:
        """Start again what has ended without being asked to, and note it."""
        for name, child in self._children.items():
            code = child.process.poll()
            if code is None or code == _REFUSES or child.restarts >= _RESTARTS:
                continue
            child.restarts += 1
            self.notes.append(f"{name} ended ({_how(code)}) and was started again")
            child.process = self._spawn(name)
            self._write_pids()

    def kill(self, name: str) -> None:
        """SIGKILL, as a crash is; `restart_ended` starts it again."""
        child = self._children[name]
        if child.process.poll() is None:
            child.process.kill()

    def raise_refused_settings(self) -> None:
        """Raise ManifestError with the last log line of a service that cannot use its settings, if there is one."""
        for name, child in self._children.items():
            if child.process.poll() == _REFUSES:
                lines = (self.folder / "logs" / f"{name}.log").read_text("utf-8", "replace").splitlines()
                raise ManifestError(lines[-1] if lines else f"{name} refuses its settings")

    def stop(self, timeout_s: float = 5.0) -> None:
        """SIGTERM to all, SIGKILL to who has not ended by then."""
        for child in self._children.values():
            if child.process.poll() is None:
                child.process.terminate()
        deadline = time.monotonic() + timeout_s
        for name, child in self._children.items():
            try:
                child.process.wait(max(deadline - time.monotonic(), 0.01))
            except subprocess.TimeoutExpired:
                self.notes.append(f"{name} did not end within {timeout_s:.0f} s and was killed")
                child.process.kill()
                child.process.wait()

    def _spawn(self, name: str) -> subprocess.Popen[bytes]:
        logs = self.folder / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        # The drive's settings alone count: an operator's environment must not change a replay.
        environ = {key: value for key, value in os.environ.items() if not key.startswith("CAMBER_")}
        # Small matrices gain nothing from more threads.
        environ["OMP_NUM_THREADS"] = environ["OPENBLAS_NUM_THREADS"] = "1"
        config = self.folder / "config" / f"{name}.toml"
        with (logs / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"camber.{name}", "--config", str(config)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environ,
                start_new_session=True,  # Ctrl-C goes to the replay, which ends them in order
            )

    def _write_pids(self) -> None:
        pids = {name: child.process.pid for name, child in self._children.items()}
        fresh = self.folder / "processes.tmp"
        fresh.write_text(json.dumps(pids), "utf-8")
        fresh.replace(self.folder / "processes.json")


def _how(code: int) -> str:
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def config_text(table: Mapping[str, Any], prefix: str = "") -> str:
    """A service's settings as TOML."""
    lines = [f"{key} = {_value(value)}" for key, value in table.items() if not isinstance(value, Mapping)]
    for key, value in table.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{prefix}{key}]", config_text(value, f"{prefix}{key}.")]
    return "\n".join(lines)


def _value(value: Any) -> str:
    return json.dumps(str(value) if isinstance(value, Path) else value, ensure_ascii=False)
