"""Open a Zenoh session as the settings say."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from camber.schemas.plain_file import check_plain_file

if TYPE_CHECKING:  # what only probes need not read all that settings are made with
    from camber.runtime.settings import ZenohSettings


_PLACE = re.compile(r"(?:--> |line: )(\d+)(?::|, column: )(\d+)")
_FIELD = re.compile(r"(?:unknown|missing|duplicate) field `\w+`")


OUTSIDE = ("tls", "quic")
"""Protocols of links between vehicles and the cloud; what comes by another counts as within."""
OVER_TLS = tuple(f"{protocol}/" for protocol in OUTSIDE)
_SMALL_MESSAGES_QUEUED = 16
"""Batches of one link: Zenoh's maximum, and more than the messages of an epoch. Memory is taken when it is used."""


class BusError(RuntimeError):
    """The bus could not be joined."""


class NobodyThereError(BusError):
    """It was looked for and not found; all else was wrong before, and no waiting helps."""


def open_session(settings: ZenohSettings, *, timeout_s: float | None = None) -> zenoh.Session:
    """Join the bus; raises BusError, with `timeout_s` also where nobody has answered by then.

    Departures from Zenoh's defaults: no multicast (what is not configured is not reached), and a router or peer that
    is not there yet is tried again for ever, at most 0.5 s apart (a default client fails at once).
    """
    config = _base(settings.config_file)
    if settings.tls_ca and settings.tls_certificate and settings.tls_key:
        from camber.runtime.tls_certificates import tls_table

        table = tls_table(settings.tls_ca, settings.tls_certificate, settings.tls_key)
        _put(config, "transport/link/tls", table)
    _check_tls(config)
    _put(config, "mode", settings.mode)
    _put(config, "connect/endpoints", settings.connect)
    _put(config, "listen/endpoints", [] if settings.mode == "client" else settings.listen)
    # -1: for ever. 0 would be one attempt, after which a peer never looks for its router again.
    _put(config, "connect/timeout_ms", -1 if timeout_s is None else round(1000 * timeout_s))
    _put(config, "connect/exit_on_failure", timeout_s is not None)
    _put(config, "scouting/gossip/enabled", True)
    _depart_from_defaults(config, settings.lease_s)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NobodyThereError(
            f"cannot join the bus ({settings.mode}, {settings.connect}): {_reason(error)}"
        ) from None


def open_router(
    config_file: Path | None, *, listen: list[str] | None = None, connect: list[str] | None = None
) -> zenoh.Session:
    """Open a session that routes for others; what is given here goes before what stands in the file.

    Returns once it is connected to its endpoints: a vehicle's router joins the cloud's as a client, and until it
    has found it, it routes within the vehicle while this waits. Raises BusError.
    """
    config = _router_config(config_file, listen, connect)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(f"cannot route: {_reason(error)}") from None


def router_endpoints(
    config_file: Path | None, *, listen: list[str] | None = None, connect: list[str] | None = None
) -> tuple[list[str], list[str], dict[str, Any]]:
    """Where `open_router` would listen and connect, and its `transport/link/tls`. Raises BusError."""
    config = _router_config(config_file, listen, connect)
    return (
        _get(config, "listen/endpoints") or [],
        _get(config, "connect/endpoints") or [],
        _get(config, "transport/link/tls") or {},
    )


def router_rules(config_file: Path | None) -> list[dict[str, Any]]:
    """The access rules of a router's file. Raises BusError."""
    return _get(_base(config_file), "access_control/rules") or []


def _router_config(
    config_file: Path | None, listen: list[str] | None, connect: list[str] | None
) -> zenoh.Config:
    config = _base(config_file)
    if _get(config, "mode") is None:
        _put(config, "mode", "router")
    # What no file has set is a default for each mode, on all interfaces.
    if listen is not None or not isinstance(_get(config, "listen/endpoints"), list):
        _put(config, "listen/endpoints", listen or ["tcp/127.0.0.1:7447"])
    if connect is not None:
        _put(config, "connect/endpoints", connect)
    _check_link_of_rules(config)
    # A vehicle's bus does not depend on its link: that is tried until certificate and clock are right, and reported.
    if _get(config, "mode") != "client":
        _check_tls(config)
    _put(config, "connect/timeout_ms", -1)
    _put(config, "connect/exit_on_failure", False)
    _depart_from_defaults(config)
    return config


def _check_link_of_rules(config: zenoh.Config) -> None:
    """A vehicle's rules take what does not come over TLS for a service within: its link has to be one that does."""
    if _get(config, "mode") != "client" or not _get(config, "access_control/enabled"):
        return
    for endpoint in _get(config, "connect/endpoints") or []:
        if not endpoint.startswith(OVER_TLS):
            raise BusError(
                f"connect/endpoints: expected {' or '.join(OVER_TLS)} beside access rules, got {endpoint}"
            )


def _depart_from_defaults(config: zenoh.Config, lease_s: float = 2.0) -> None:
    _put(
        config, "connect/retry", {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
    )
    _put(config, "scouting/multicast/enabled", False)
    _put(config, "transport/link/tx/lease", round(1000.0 * lease_s))  # Zenoh's own is 10 s
    # Small messages of an epoch follow one another at once, each in a batch of its own (express). Where the thread that
    # sends waits for a processor, Zenoh's own two batches are full after two, and the third is dropped after 1 ms: lost
    # were 0.2 % on an idle machine, up to 30 % on a busy one (tests/integration/test_bursts_of_messages.py).
    _put(config, "transport/link/tx/queue/size/interactive_high", _SMALL_MESSAGES_QUEUED)
    # Small messages gain nothing by shared memory, and containers do not share /dev/shm.
    _put(config, "transport/shared_memory/enabled", False)


def _put(config: zenoh.Config, key: str, value: object) -> None:
    try:
        config.insert_json5(key, json.dumps(value))
    except zenoh.ZError:
        raise BusError(
            f"{key}: expected what Zenoh takes, protocol/address of an endpoint, got {value}"
        ) from None


def _get(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _check_tls(config: zenoh.Config) -> None:
    table = {name: value for name, value in _get(config, "transport/link/tls").items() if value}
    if not table:
        return
    # Not for those on the loopback: it takes a while to load.
    from camber.runtime.tls_certificates import TlsError, check_table

    try:
        check_table(table)
    except TlsError as error:
        raise BusError(str(error)) from None


def _base(config_file: Path | None) -> zenoh.Config:
    if config_file is None:
        return zenoh.Config()
    try:
        check_plain_file(config_file)
    except OSError as error:
        raise BusError(f"{config_file}: {error.strerror}") from None
    try:
        return zenoh.Config.from_file(str(config_file))
    except zenoh.ZError as error:
        raise BusError(f"{config_file}: {_without_contents(str(error))}") from None


def _without_contents(text: str) -> str:
    """Where a configuration is wrong: Zenoh shows the line itself, and a password may stand in it."""
    if "os error" in text:
        return text.partition(" at /")[0]
    place = _PLACE.search(text)
    field = _FIELD.search(text)
    where = f" at line {place[1]}, column {place[2]}" if place else ""
    return f"not a configuration of Zenoh{where}{f': {field[0]}' if field else ''}"


def _reason(error: zenoh.ZError) -> str:
    """What Zenoh says, without the place in its source that it adds."""
    return str(error).partition(" at /")[0][:300]
