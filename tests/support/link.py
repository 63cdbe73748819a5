"""Two machines and a link that can be cut, lose packets and be slow: network namespaces, made with iproute2.

    with link() as line:
        processes.start("router", …, within=line.vehicle)
        line.cut()

A cut is silent, as in a tunnel: packets vanish, and both ends notice by themselves. Unix sockets reach across
namespaces, so a test can listen to a vehicle in one of them.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

VEHICLE_ADDRESS, CLOUD_ADDRESS = "10.137.0.1", "10.137.0.2"
_LATENCY_MS = 400  # of the slow link's queue, at most


class LinkError(RuntimeError):
    """A command that the link is made with has failed."""


def _run(*words: object) -> None:
    done = subprocess.run(
        [str(word) for word in words], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise LinkError(f"{' '.join(map(str, words))}: {done.stderr.strip()}")


@dataclass
class Link:
    """The two ends; names of processes' surroundings are words that go before a command."""

    tag: str
    _rules: list[tuple[str, list[str]]] = field(default_factory=list)

    @property
    def ends(self) -> tuple[str, str]:
        return f"cmbv{self.tag}", f"cmbc{self.tag}"

    @property
    def vehicle(self) -> list[str]:
        """Before a command: it then runs on the vehicle's side."""
        return ["ip", "netns", "exec", self.ends[0]]

    @property
    def cloud(self) -> list[str]:
        return ["ip", "netns", "exec", self.ends[1]]

    def make(self) -> None:
        for name in self.ends:
            _run("ip", "netns", "add", name)
        _run("ip", "link", "add", f"v{self.tag}", "type", "veth", "peer", "name", f"c{self.tag}")
        for name, letter, address in zip(self.ends, "vc", (VEHICLE_ADDRESS, CLOUD_ADDRESS), strict=True):
            _run("ip", "link", "set", f"{letter}{self.tag}", "netns", name)
            _run("ip", "-n", name, "addr", "add", f"{address}/24", "dev", f"{letter}{self.tag}")
            _run("ip", "-n", name, "link", "set", f"{letter}{self.tag}", "up")
            _run("ip", "-n", name, "link", "set", "lo", "up")

    def remove(self) -> None:
        for name in self.ends:
            subprocess.run(
                ["ip", "netns", "del", name], stdin=subprocess.DEVNULL, capture_output=True, check=False
            )

    def cut(self) -> None:
        """Drop every packet in both directions, silently."""
        self._drop()

    def lose(self, share: float) -> None:
        """Drop this share of the packets in both directions."""
        self._drop("-m", "statistic", "--mode", "random", "--probability", f"{share:.3f}")

    def slow(self, kbit_s: int) -> None:
        """Limit the rate in both directions; packets that wait for longer than 0.4 s are dropped."""
        for name, letter in zip(self.ends, "vc", strict=True):
            _run(
                "tc", "-n", name, "qdisc", "replace", "dev", f"{letter}{self.tag}", "root", "tbf",
                "rate", f"{kbit_s}kbit", "burst", "4kb", "latency", f"{_LATENCY_MS}ms",
            )  # fmt: skip

    def join(self) -> None:
        """Remove all drop rules; the rate limit stays."""
        while self._rules:
            name, rule = self._rules.pop()
            _run("ip", "netns", "exec", name, "iptables", "-w", "-D", *rule)

    def mend(self) -> None:
        """Remove drop rules and rate limit."""
        self.join()
        for name, letter in zip(self.ends, "vc", strict=True):
            subprocess.run(
                ["tc", "-n", name, "qdisc", "del", "dev", f"{letter}{self.tag}", "root"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                check=False,
            )

    def dropped(self) -> int:
        """Packets that the rules in force have taken out so far."""
        result = 0
        for name in self.ends:
            listed = subprocess.run(
                ["ip", "netns", "exec", name, "iptables", "-w", "-nvxL", "INPUT"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                check=True,
            )
            result += sum(int(line.split()[0]) for line in listed.stdout.splitlines() if " DROP " in line)
        return result

    def held_back(self) -> int:
        """How often the slow link has made a packet wait."""
        result = 0
        for name, letter in zip(self.ends, "vc", strict=True):
            listed = subprocess.run(
                ["tc", "-n", name, "-s", "-j", "qdisc", "show", "dev", f"{letter}{self.tag}"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                check=True,
            )
            result += sum(
                qdisc["overlimits"] for qdisc in json.loads(listed.stdout) if qdisc["kind"] == "tbf"
            )
        return result

    def _drop(self, *which: str) -> None:
        for name, letter in zip(self.ends, "vc", strict=True):
            rule = ["INPUT", "-i", f"{letter}{self.tag}", *which, "-j", "DROP"]
            _run("ip", "netns", "exec", name, "iptables", "-w", "-A", *rule)
            self._rules.append((name, rule))


@contextmanager
def link() -> Iterator[Link]:
    """A link, taken away on leaving; skips where this machine does not let one be made."""
    missing = [tool for tool in ("ip", "tc", "iptables") if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"no link can be made here: {', '.join(missing)} not installed (iproute2, iptables)")
    line = Link(f"{os.getpid() % 10**6}")
    try:
        try:
            line.make()
            line.cut()
            line.slow(100)
            line.mend()
        except LinkError as error:
            pytest.skip(f"no link can be made here: {error}")
        yield line
    finally:
        line.remove()
