"""Open a Zenoh session as the settings say."""

from __future__ import annotations

import json
from pathlib import Path

import zenoh

from camber.runtime.settings import ZenohSettings


class BusError(RuntimeError):
    """The bus could not be joined."""


def open_session(settings: ZenohSettings, *, timeout_s: float | None = None) -> zenoh.Session:
    """Join the bus; raises BusError, with `timeout_s` also where nobody has answered by then.

    Departures from Zenoh's defaults: no multicast (what is not configured is not reached), and a router or peer that
    is not there yet is tried again for ever, at most 0.5 s apart (a default client fails at once).
    """
    config = _base(settings.config_file)

    def put(key: str, value: object) -> None:
        config.insert_json5(key, json.dumps(value))

    put("mode", settings.mode)
    put("connect/endpoints", settings.connect)
    put("listen/endpoints", [] if settings.mode == "client" else settings.listen)
    # -1: for ever. 0 would be one attempt, after which a peer never looks for its router again.
    put("connect/timeout_ms", -1 if timeout_s is None else round(1000 * timeout_s))
    put("connect/exit_on_failure", timeout_s is not None)
    put("connect/retry", {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5})
    put("scouting/multicast/enabled", False)
    put("scouting/gossip/enabled", True)
    put("transport/link/tx/lease", 2000)  # a frozen peer is gone after 2 s, not 10
    # Small messages gain nothing by shared memory, and containers do not share /dev/shm.
    put("transport/shared_memory/enabled", False)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(
            f"cannot join the bus ({settings.mode}, {settings.connect}): {_reason(error)}"
        ) from None


def _base(config_file: Path | None) -> zenoh.Config:
    if config_file is None:
        return zenoh.Config()
    try:
        return zenoh.Config.from_file(str(config_file))
    except zenoh.ZError as error:
        raise BusError(f"{config_file}: {_reason(error)}") from None


def _reason(error: zenoh.ZError) -> str:
    """What Zenoh says, without the place in its source that it adds."""
    return str(error).partition(" at /")[0][:300]
