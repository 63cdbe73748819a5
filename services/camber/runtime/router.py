"""`camber router`: a Zenoh router in Python, for machines where the official `zenohd` is not installed.

With a configuration made by `camber access vehicle` it is the router of a vehicle: it routes within at once, joins the
cloud when it is there, and says whether the cloud lets pass what comes from here.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh

from camber.runtime.session import BusError, open_router, router_endpoints

_LOOK_S = 1.0  # between two looks at whether the link to the cloud is there
_CHECK_LIMIT_S = 5.0
_CHECK_AGAIN_S = 15.0
_CLOSE_LIMIT_S = 2.0


def main(argv: list[str] | None = None) -> int:
    """Route until SIGTERM or SIGINT; 3 where that is not possible."""
    parser = argparse.ArgumentParser(
        prog="camber router", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--listen", action="append", metavar="ENDPOINT", help="default tcp/127.0.0.1:7447; repeatable"
    )
    parser.add_argument("--connect", action="append", metavar="ENDPOINT", help="another router; repeatable")
    parser.add_argument(
        "--config-file",
        type=Path,
        metavar="FILE",
        help="Zenoh configuration (json5); --listen and --connect go before its own",
    )
    args = parser.parse_args(argv)
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, lambda *_: stop.set())
    ends = {"listen": args.listen, "connect": args.connect}
    try:
        listen, connect, tls = router_endpoints(args.config_file, **ends)
    except BusError as error:
        _say(str(error))
        return 3
    opened: list[zenoh.Session | BusError] = []

    def open_it() -> None:
        try:
            opened.append(open_router(args.config_file, **ends))
        except BusError as error:
            opened.append(error)
            stop.set()

    # Joining as a client waits for the cloud for ever; within the vehicle it routes meanwhile.
    threading.Thread(target=open_it, daemon=True).start()
    if connect and tls.get("connect_certificate"):
        threading.Thread(target=_watch, args=(opened, connect, tls), daemon=True).start()
    _say(f"listens on {', '.join(listen)}" + (f", joins {', '.join(connect)}" if connect else ""))
    stop.wait()
    return _end(opened)


def _end(opened: list[zenoh.Session | BusError]) -> int:
    session = opened[0] if opened else None
    if isinstance(session, BusError):
        _say(str(session))
        return 3
    if session is not None:
        closing = threading.Thread(target=session.close, daemon=True)
        closing.start()
        closing.join(_CLOSE_LIMIT_S)
        if not closing.is_alive():
            return 0
    sys.stderr.flush()
    os._exit(0)  # Zenoh still waits for the cloud, and cannot be told to leave off


def _watch(opened: list[zenoh.Session | BusError], connect: list[str], tls: dict[str, Any]) -> None:
    """Say when the cloud is found and lost, and whether what comes from here is let pass."""
    from camber.runtime.heard import are_we_heard, denial
    from camber.runtime.settings import ZenohSettings
    from camber.runtime.tls import certificate_name, name_of

    path = Path(tls["connect_certificate"])
    settings = ZenohSettings(
        mode="client",
        connect=connect,
        tls_ca=tls["root_ca_certificate"],
        tls_certificate=path,
        tls_key=tls["connect_private_key"],
    )
    name, at, said = name_of(certificate_name(path)), ", ".join(connect), ""
    was_linked, checked_s, peers_told = False, float("-inf"), False
    while True:
        session, now = (opened[0] if opened else None), time.monotonic()
        linked = isinstance(session, zenoh.Session) and bool(session.info.routers_zid())
        if not peers_told and isinstance(session, zenoh.Session) and session.info.peers_zid():
            peers_told = True
            _say(
                'peers have joined, and will not hear one another: services here need [zenoh] mode = "client"'
            )
        heard = said.startswith("heard")
        if linked != was_linked or (not heard and now - checked_s >= _CHECK_AGAIN_S):
            was_linked, checked_s = linked, now
            try:
                answer = are_we_heard(settings, name, timeout_s=_CHECK_LIMIT_S)
                word = f"heard as {name} at {at}" if answer == "heard" else denial(settings, name)
            except BusError as error:
                word = f"no link: {error}"
            if word != said:
                said = word
                _say(word)
        time.sleep(_LOOK_S)


def _say(text: str) -> None:
    print(f"camber router: {text}", file=sys.stderr, flush=True)
