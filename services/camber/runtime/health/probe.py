"""Is a service well? What `camber health` asks, for those who ask every few seconds.

usage: python -m camber.runtime.health.probe [SERVICE [SETTINGS.toml]]; without arguments, what runs in this
container (its first process), with the settings that it was given. Exit codes: as `camber health`.

On purpose it knows neither messages nor settings as classes: to import those takes a second of a processor, and each
container would do so four times a minute. It writes the one question and reads the one word of the answer.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgpack

from camber.runtime.session import BusError, open_session
from camber.schemas.bounded_toml import read_toml

ROUTER = "router"
FIRST_PROCESS = Path("/proc/1/cmdline")
WITHIN_S = 5.0  # chosen: longest wait for the reply
_ENCODING = "application/msgpack;camber.HealthRequest.v1"
_GPS_EPOCH_UNIX_S = 315_964_800  # 1980-01-06T00:00:00Z
_FILES = ("config_file", "tls_ca", "tls_certificate", "tls_key")
_EARLIEST_NS = 630_720_000 * 10**9  # of what a message may bear: schemas/base.py
_LENGTH = struct.Struct("<I")


@dataclass(kw_only=True)
class ProbeSettings:
    """Where the service is asked, as ZenohSettings say it."""

    vehicle: str = "vehicle"
    connect: list[str] = field(default_factory=lambda: ["tcp/127.0.0.1:7447"])
    config_file: Path | None = None
    tls_ca: Path | None = None
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    mode: str = "client"
    listen: tuple[str, ...] = ()
    lease_s: float = 2.0


def bus_of(service: str, settings: Path, environ: dict[str, str]) -> ProbeSettings:
    """Vehicle and endpoints, as the service reads them: environment before file before default.

    Whether they are right is the service's own affair; ValueError and OSError are those of reading them.
    """
    table = read_toml(settings) if settings.exists() else {}
    prefix = f"CAMBER_{service.upper()}_"
    here = {
        name.upper().removeprefix(prefix): text
        for name, text in environ.items()
        if name.upper().startswith(prefix)
    }
    values = {**table, **table.get("zenoh", {}), **json.loads(here.get("ZENOH", "{}"))}
    values |= {"vehicle": here["VEHICLE"]} if "VEHICLE" in here else {}
    for name in ("connect", *_FILES):
        if (text := here.get(f"ZENOH__{name.upper()}")) is not None:
            values[name] = json.loads(text) if name == "connect" else text
    bus = ProbeSettings(**{name: values[name] for name in ("vehicle", "connect") if name in values})
    for name in _FILES:
        setattr(bus, name, Path(values[name]) if values.get(name) else None)
    return bus


def runs_here(command: Sequence[str]) -> tuple[str, Path | None]:
    """Service and settings of a command line, whatever starts it: `… camber gnss --config FILE …`; ValueError."""
    arguments = [part for argument in command for part in argument.split("=", 1)]
    start = next((n for n, text in enumerate(arguments) if Path(text).name in ("camber", "camber.cli")), None)
    if start is None or start + 1 == len(arguments) or arguments[start + 1].startswith("-"):
        raise ValueError(f"expected the name of a service; {' '.join(command)} runs here")
    options = arguments[start + 2 :]
    file = next((Path(after) for option, after in pairwise(options) if option == "--config"), None)
    return arguments[start + 1].replace("-", "_"), file


def key_of(vehicle: str, service: str) -> str:
    """Where a service is asked how it is."""
    return f"camber/v1/{vehicle}/{service}/health"


def question(now_ns: int) -> bytes:
    """The bytes of a HealthRequest, `now_ns` in GPS time."""
    # A clock that is years behind must not make a service look ill: what is asked is how it is.
    time_ns = max(now_ns, _EARLIEST_NS)
    header: bytes = msgpack.packb(["camber.HealthRequest.v1", "probe", 0, {"time_ns": time_ns}])
    return _LENGTH.pack(len(header)) + header


def status_in(answer: bytes) -> str:
    """Return the status in a Health message; ValueError where these bytes are none."""
    end = _LENGTH.size + _LENGTH.unpack_from(answer)[0] if len(answer) > _LENGTH.size else 0
    header = msgpack.unpackb(answer[_LENGTH.size : end])
    fields = header[3] if isinstance(header, list) and len(header) == 4 else None
    status = fields.get("status") if isinstance(fields, dict) else None
    if not isinstance(status, str):
        raise ValueError("the answer is no Health")
    return status


def status_of(service: str, bus: ProbeSettings) -> str:
    """What a service says of itself; of a router `ok`, where it can be joined.

    Raises BusError, TimeoutError, ValueError.
    """
    settings: Any = bus
    with open_session(settings, timeout_s=WITHIN_S) as session:
        if service == ROUTER:
            return "ok"
        now_ns = time.time_ns() - _GPS_EPOCH_UNIX_S * 10**9
        key = key_of(bus.vehicle, service)
        for reply in session.get(key, payload=question(now_ns), encoding=_ENCODING, timeout=WITHIN_S):
            if reply.ok is not None:
                return status_in(reply.ok.payload.to_bytes())
    raise TimeoutError(f"{service} of {bus.vehicle} does not answer")


def main(argv: list[str]) -> int:
    """Ask, say it in one line; returns the exit code."""
    given: Path | None
    try:
        if argv:
            service, given = argv[0], Path(argv[1]) if len(argv) > 1 else None
        else:
            service, given = runs_here(FIRST_PROCESS.read_text("utf-8").rstrip("\0").split("\0"))
    except (OSError, ValueError) as error:
        print(f"probe: {error}", file=sys.stderr)
        return 2
    settings = given or Path(f"/etc/camber/{service}.toml")
    try:
        status = status_of(service, bus_of(service, settings, dict(os.environ)))
    except (BusError, OSError, ValueError, TypeError) as error:
        print(f"{service}: no answer: {error}")
        return 1
    print(f"{service}: {status}")
    return 1 if status == "failing" else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
