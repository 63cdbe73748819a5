"""`camber router`: a Zenoh router in Python, for machines where the official `zenohd` is not installed.

With a configuration made by `camber access vehicle` it is the router of a vehicle: it routes within at once, joins the
cloud when it is there, and says whether the cloud lets pass what comes from here.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from camber.runtime.session import OVER_TLS, BusError, open_router, router_endpoints, router_rules

if TYPE_CHECKING:
    from camber.runtime.settings import ZenohSettings

_LOOK_S = 1.0  # between two looks at whether the link to the cloud is there
_FIRST_S = 2.0  # chosen: time for the link to come up
_CHECK_LIMIT_S = 5.0  # chosen: longest access probe
_CHECK_AGAIN_S = 15.0  # chosen: period of probes without access
_PERMITTED_AGAIN_S = 60.0  # an access list may change, the link stay
_SAY_AGAIN_S = 60.0  # chosen: period of repeated messages
_STUCK = 2  # looks in a row at which Zenoh still waits for one router while another would accept us
_DAY_S = 86_400.0  # seconds of a day
_NEEDED = ("root_ca_certificate", "connect_certificate", "connect_private_key")
_CLOSE_LIMIT_S = 2.0  # chosen: longest wait for the session to close


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
        rules = router_rules(args.config_file)
    except BusError as error:
        _say(str(error))
        return 3
    over_tls = [endpoint for endpoint in connect if endpoint.startswith(OVER_TLS)]
    if any(endpoint.startswith("unixsock-stream/") for endpoint in listen):
        os.umask(0o007)  # who joins must be able to write the socket: its owner and its group
    opened: list[zenoh.Session | BusError] = []

    def open_it() -> None:
        try:
            opened.append(open_router(args.config_file, **ends))
        except BusError as error:
            opened.append(error)
            stop.set()

    def begin_anew(first: str) -> None:
        _say(f"begins anew with {first}: Zenoh waits for {connect[0]}, and for nobody else")
        ends_now = {"listen": args.listen, "connect": [first, *(end for end in connect if end != first)]}
        arguments = [
            text
            for option, endpoints in ends_now.items()
            for endpoint in endpoints or ()
            for text in (f"--{option}", endpoint)
        ]
        arguments += ["--config-file", str(args.config_file)] if args.config_file else []
        try:
            if not stop.is_set():
                _replace_by([sys.executable, "-m", "camber.cli", "router", *arguments])
        except OSError as error:  # what is, goes on
            _say(f"cannot begin anew: {error}")

    # Joining as a client waits for the cloud for ever; within the vehicle it routes meanwhile.
    threading.Thread(target=open_it, daemon=True).start()
    if tls.get("root_ca_certificate"):
        threading.Thread(target=_report_expiry, args=(tls,), daemon=True).start()
    if over_tls and all(tls.get(name) for name in _NEEDED):
        watched = (opened, over_tls, tls, rules, begin_anew)
        threading.Thread(target=_watch, args=watched, daemon=True).start()
    _say(f"listens on {', '.join(listen)}" + (f", joins {', '.join(connect)}" if connect else ""))
    stop.wait()
    return _end(opened)


def _replace_by(command: list[str]) -> None:
    """This process becomes that command, and holds nothing open: Zenoh locks its sockets in the file system."""
    for name in os.listdir("/dev/fd"):
        with contextlib.suppress(OSError):
            if int(name) > sys.stderr.fileno():
                os.set_inheritable(int(name), False)
    os.execv(command[0], command)


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
    os._exit(0)  # Zenoh still waits for the cloud, and cannot be interrupted


def _watch(
    opened: list[zenoh.Session | BusError],
    connect: list[str],
    tls: dict[str, Any],
    rules: list[dict[str, Any]],
    begin_anew: Callable[[str], None],
) -> None:
    """Say when the cloud is found and lost, and whether what comes from here is let pass.

    At its start Zenoh tries a client's first endpoint alone (a link that is lost it seeks at all of them): where
    another one would accept us, the router begins anew with that.
    """
    from camber.runtime.access_probe import name_in
    from camber.runtime.settings import ZenohSettings

    name = name_in(rules)
    settings = ZenohSettings(
        mode="client",
        connect=connect,
        tls_ca=tls["root_ca_certificate"],
        tls_certificate=tls["connect_certificate"],
        tls_key=tls["connect_private_key"],
    )
    reported, reported_s, peers_reported = "", float("-inf"), False
    checked_s = time.monotonic() - _CHECK_AGAIN_S + _FIRST_S  # time for the link to come first
    was_linked: frozenset[str] = frozenset()
    stuck = 0
    while True:
        session, now = (opened[0] if opened else None), time.monotonic()
        info = session.info if isinstance(session, zenoh.Session) else None
        linked = frozenset(map(str, info.routers_zid())) if info is not None else frozenset()
        if not peers_reported and info is not None and info.peers_zid():
            peers_reported = True
            _say(
                'peers have joined, and do not receive from one another: services here need [zenoh] mode = "client"'
            )
        again_s = (
            _PERMITTED_AGAIN_S if reported.startswith("accepted") else _FIRST_S if stuck else _CHECK_AGAIN_S
        )
        if linked != was_linked or now - checked_s >= again_s:
            was_linked, checked_s = linked, now
            status, by = _access_status(settings, name, linked)
            if status != reported or (not status.startswith("accepted") and now - reported_s >= _SAY_AGAIN_S):
                reported, reported_s = status, now
                _say(status)
            stuck = stuck + 1 if by not in (None, connect[0]) and not opened else 0
            if by is not None and stuck >= _STUCK:
                stuck = 0
                begin_anew(by)
        time.sleep(_LOOK_S)


def _access_status(
    settings: ZenohSettings, name: str | None, linked: frozenset[str]
) -> tuple[str, str | None]:
    """Return the status as text, and the endpoint that accepts us; only of the router that we are linked to."""
    from camber.runtime.access_probe import can_publish, denial_message
    from camber.runtime.tls_certificates import TlsError, certificate_name, name_of

    several, problems = len(settings.connect) > 1, []
    for endpoint in settings.connect:
        there = settings.model_copy(update={"connect": [endpoint]})
        try:
            name = name or name_of(certificate_name(settings.tls_certificate or Path()))
            answer = can_publish(there, name, timeout_s=_CHECK_LIMIT_S, at=linked if several else ())
            if answer == "denied":
                return denial_message(there, name), None
            if linked:
                return f"accepted as {name} at {endpoint}", endpoint
            return f"no link, though {endpoint} would accept {name}", endpoint
        except (BusError, TlsError) as error:
            problems.append(str(error))
    return f"no link: {'; '.join(dict.fromkeys(problems))}", None


def _report_expiry(tls: dict[str, Any]) -> None:
    """Say each day which certificates end soon."""
    from camber.runtime.tls_certificates import ends_soon

    while True:
        for line in ends_soon(tls, datetime.now(UTC)):
            _say(line)
        time.sleep(_DAY_S)


def _say(text: str) -> None:
    print(f"camber router: {text}", file=sys.stderr, flush=True)
