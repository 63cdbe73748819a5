"""Configurations of routers, for `camber router` and the official `zenohd` alike."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from camber.runtime.tls import tls_table
from camber.tools.security.access_rules import Kind, Party, cloud_access_control, vehicle_access_control

_SHORT_LIST = re.compile(r"\[[^\[\]{}]*\]")
_LINE = 90
_COMMON: dict[str, Any] = {
    # It tells nobody where the others are: who meets around it meets around its rules.
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    # No keys under @/ by which the router could be inspected or changed from the bus.
    "adminspace": {"enabled": False},
}
_SESSIONS_IN_A_VEHICLE = 128
_SESSIONS_IN_THE_CLOUD = 10_000
_LARGEST_MESSAGE_BYTES = 4 << 20
"""Over the link: uploads and map blobs are at most 256 kB; what is larger is nothing of ours."""


def cloud_config(
    parties: Sequence[Party],
    *,
    routers: Sequence[str],
    listen: Sequence[str],
    connect: Sequence[str] = (),
    folder: Path,
    own: str,
) -> dict[str, Any]:
    """A router of the cloud; `connect` are others of it, `folder` holds ca.pem, and `own`.pem and `own`.key."""
    return {
        "mode": "router",
        **_COMMON,
        "listen": {"endpoints": list(listen)},
        "connect": {"endpoints": list(connect), "timeout_ms": -1, "exit_on_failure": False},
        "transport": _transport(folder, own, sessions=_SESSIONS_IN_THE_CLOUD, largest=True),
        "access_control": cloud_access_control(parties, routers),
    }


def vehicle_config(
    vehicle: str,
    *,
    connect: Sequence[str],
    listen: Sequence[str],
    kinds: Iterable[Kind],
    folder: Path,
    own: str,
) -> dict[str, Any]:
    """A vehicle's router: services within join it as clients, and it joins one router of the cloud as a client.

    As a client it has one link, knows nobody else, and takes the next endpoint where one does not answer. Peers within
    would hear clients, but not one another: it has no way to bring them together.
    """
    return {
        "mode": "client",
        **_COMMON,
        "listen": {"endpoints": list(listen)},
        "connect": {
            "endpoints": list(connect),
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
        },
        "gateway": {"south": [{"filters": [{"modes": ["client", "peer"]}]}]},
        "transport": _transport(folder, own, sessions=_SESSIONS_IN_A_VEHICLE, largest=False),
        "access_control": vehicle_access_control(vehicle, kinds),
    }


def text_of(config: dict[str, Any], *, about: str, made_by: str) -> str:
    """As a file: JSON, which is JSON5, under two lines that say what it is and how it was made."""
    text = _SHORT_LIST.sub(_on_one_line, json.dumps(config, indent=2))
    return f"// {about}\n// Made by `{made_by}`: change that, not this.\n{text}\n"


def _on_one_line(found: re.Match[str]) -> str:
    line = " ".join(found[0].split()).replace("[ ", "[").replace(" ]", "]")
    return line if len(line) <= _LINE else found[0]


def _transport(folder: Path, own: str, *, sessions: int, largest: bool) -> dict[str, Any]:
    link: dict[str, Any] = {
        "tx": {"lease": 2000},
        "tls": tls_table(folder / "ca.pem", folder / f"{own}.pem", folder / f"{own}.key"),
    }
    if largest:
        link["rx"] = {"max_message_size": _LARGEST_MESSAGE_BYTES}
    return {
        "unicast": {"max_sessions": sessions, "accept_pending": 64},
        "shared_memory": {"enabled": False},
        "link": link,
    }
