"""`camber router`: a Zenoh router in Python, for machines where the official `zenohd` is not installed."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path

from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ZenohSettings


def main(argv: list[str] | None = None) -> int:
    """Route until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(prog="camber router", description=__doc__)
    parser.add_argument(
        "--listen", action="append", metavar="ENDPOINT", help="default tcp/127.0.0.1:7447; repeatable"
    )
    parser.add_argument("--connect", action="append", metavar="ENDPOINT", help="another router; repeatable")
    parser.add_argument(
        "--config-file", type=Path, metavar="FILE", help="Zenoh configuration (json5) to start from"
    )
    args = parser.parse_args(argv)
    settings = ZenohSettings(
        mode="router",
        listen=args.listen or ["tcp/127.0.0.1:7447"],
        connect=args.connect or [],
        config_file=args.config_file,
    )
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        session = open_session(settings)
    except BusError as error:
        print(f"camber router: {error}", file=sys.stderr)
        return 3
    print(
        f"camber router: {session.zid()} listens on {', '.join(settings.listen)}", file=sys.stderr, flush=True
    )
    stop.wait()
    session.close()  # type: ignore[no-untyped-call]
    return 0
