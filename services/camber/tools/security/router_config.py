"""Configurations of routers, for `camber router` and the official `zenohd` alike."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from camber.runtime.tls_certificates import tls_table
from camber.tools.security.access_rules import Kind, Party, cloud_access_control, vehicle_access_control

_SHORT_LIST = re.compile(r"\[[^\[\]{}]*\]")
_LINE_CHARACTERS = 90
"""Chosen: a list of keys up to this long stays on one line of the generated file."""
_COMMON: dict[str, Any] = {
    # No discovery: sessions that found each other directly would bypass the access rules.
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    # No admin keys (@/…) through which the router could be inspected or reconfigured from the bus.
    "adminspace": {"enabled": False},
}
_CONNECTING = {"timeout_ms": -1, "exit_on_failure": False}
_VEHICLE_SESSIONS = 128
"""Chosen: a vehicle runs some ten processes; leaves room for tools."""
_CLOUD_SESSIONS = 10_000
"""Chosen: twice the 5,000 vehicles of the largest planned fleet (docs/security.md)."""
_LARGEST_MESSAGE_BYTES = 4 << 20
"""Chosen: 16 times the largest message on the link (uploads and map blobs are at most 256 kB)."""


def cloud_config(
    parties: Sequence[Party],
    *,
    routers: Sequence[str],
    listen: Sequence[str],
    connect: Sequence[str],
    folder: Path,
    certificate_name: str,
) -> dict[str, Any]:
    """Return the configuration of a cloud router.

    `connect`: endpoints of other cloud routers. `folder` holds ca.pem and the pair `certificate_name`.pem, .key.
    """
    rx = {"max_message_size": _LARGEST_MESSAGE_BYTES}
    return {
        "mode": "router",
        **_COMMON,
        "listen": {"endpoints": list(listen)},
        "connect": {"endpoints": list(connect), **_CONNECTING},
        "transport": _transport(folder, certificate_name, _CLOUD_SESSIONS, rx=rx),
        "access_control": cloud_access_control(parties, routers),
    }


def vehicle_config(
    vehicle: str,
    *,
    connect: Sequence[str],
    listen: Sequence[str],
    kinds: Iterable[Kind],
    folder: Path,
) -> dict[str, Any]:
    """Return the configuration of a vehicle's router: services join it as clients, it joins the cloud as a client.

    `folder` holds ca.pem and the pair `vehicle`.pem, .key. As a client it has one uplink and falls back to the next
    endpoint where one does not answer. Services must not join as peers: they would receive from clients, but not from
    one another.
    """
    retry = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
    return {
        "mode": "client",
        **_COMMON,
        "listen": {"endpoints": list(listen)},
        "connect": {"endpoints": list(connect), **_CONNECTING, "retry": retry},
        "gateway": {"south": [{"filters": [{"modes": ["client", "peer"]}]}]},
        "transport": _transport(folder, vehicle, _VEHICLE_SESSIONS),
        "access_control": vehicle_access_control(vehicle, kinds),
    }


def text_of(config: dict[str, Any], *, about: str, made_by: str) -> str:
    """Return the configuration as JSON5: JSON after two comment lines on what it is and the command that made it."""
    text = _SHORT_LIST.sub(_on_one_line, json.dumps(config, indent=2))
    return f"// {about}\n// Made by `{made_by}`: regenerate, do not edit.\n{text}\n"


def _on_one_line(match: re.Match[str]) -> str:
    line = " ".join(match[0].split()).replace("[ ", "[").replace(" ]", "]")
    return line if len(line) <= _LINE_CHARACTERS else match[0]


def _transport(folder: Path, name: str, sessions: int, **more: dict[str, int]) -> dict[str, Any]:
    tls = tls_table(folder / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")
    return {
        "unicast": {"max_sessions": sessions, "accept_pending": 64},
        "shared_memory": {"enabled": False},
        "link": {"tx": {"lease": 2000}, "tls": tls, **more},
    }
