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


def _run(*words: object, check: bool = True) -> str:
    """Output of a command; LinkError where it fails."""
    done = subprocess.run(
        [str(word) for word in words], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if check and done.returncode != 0:
        raise LinkError(f"{' '.join(map(str, words))}: {done.stderr.strip()}")
    return done.stdout


def _iptables(name: str, *words: str) -> str:
    return _run("ip", "netns", "exec", name, "iptables", "-w", *words)


@dataclass
class Link:
    """The two ends; names of processes' surroundings are words that go before a command."""

    tag: str
    _rules: list[tuple[str, list[str]]] = field(default_factory=list)

    @property
    def ends(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Namespace and network device, of the vehicle and of the cloud."""
        return (f"cmbv{self.tag}", f"v{self.tag}"), (f"cmbc{self.tag}", f"c{self.tag}")

    @property
    def vehicle(self) -> list[str]:
        """Before a command: it then runs on the vehicle's side."""
        return ["ip", "netns", "exec", self.ends[0][0]]

    @property
    def cloud(self) -> list[str]:
        return ["ip", "netns", "exec", self.ends[1][0]]

    def make(self) -> None:
        for name, _ in self.ends:
            _run("ip", "netns", "add", name)
        _run("ip", "link", "add", self.ends[0][1], "type", "veth", "peer", "name", self.ends[1][1])
        for (name, device), address in zip(self.ends, (VEHICLE_ADDRESS, CLOUD_ADDRESS), strict=True):
            _run("ip", "link", "set", device, "netns", name)
            _run("ip", "-n", name, "addr", "add", f"{address}/24", "dev", device)
            _run("ip", "-n", name, "link", "set", device, "up")
            _run("ip", "-n", name, "link", "set", "lo", "up")

    def remove(self) -> None:
        for name, _ in self.ends:
            _run("ip", "netns", "del", name, check=False)

    def cut(self) -> None:
        """Drop every packet in both directions, silently."""
        self._drop()

    def lose(self, share: float) -> None:
        """Drop this share of the packets in both directions."""
        self._drop("-m", "statistic", "--mode", "random", "--probability", f"{share:.3f}")

    def slow(self, kbit_s: int) -> None:
        """Limit the rate in both directions; packets that wait for longer than 0.4 s are dropped."""
        shape = ("rate", f"{kbit_s}kbit", "burst", "4kb", "latency", f"{_LATENCY_MS}ms")
        for name, device in self.ends:
            _run("tc", "-n", name, "qdisc", "replace", "dev", device, "root", "tbf", *shape)

    def join(self) -> None:
        """Remove all drop rules; the rate limit stays."""
        while self._rules:
            name, rule = self._rules.pop()
            _iptables(name, "-D", *rule)

    def mend(self) -> None:
        """Remove drop rules and rate limit."""
        self.join()
        for name, device in self.ends:
            _run("tc", "-n", name, "qdisc", "del", "dev", device, "root", check=False)

    def dropped(self) -> int:
        """Packets that the rules in force have taken out so far."""
        listed = "".join(_iptables(name, "-nvxL", "INPUT") for name, _ in self.ends)
        return sum(int(line.split()[0]) for line in listed.splitlines() if " DROP " in line)

    def held_back(self) -> int:
        """How often the slow link has made a packet wait."""
        listed = [
            _run("tc", "-n", name, "-s", "-j", "qdisc", "show", "dev", device) for name, device in self.ends
        ]
        qdiscs = [qdisc for text in listed for qdisc in json.loads(text)]
        return sum(qdisc["overlimits"] for qdisc in qdiscs if qdisc["kind"] == "tbf")

    def _drop(self, *which: str) -> None:
        for name, device in self.ends:
            rule = ["INPUT", "-i", device, *which, "-j", "DROP"]
            _iptables(name, "-A", *rule)
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
