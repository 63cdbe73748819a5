"""Probe whether access rules let this certificate publish: Zenoh does not report denied messages.

Two sessions with the same certificate meet at the router, and one listens for the other on a key of the vehicle in
whose name it would speak. The rules of a certificate come all from one table: whose echo comes back may speak.
"""

from __future__ import annotations

import os
import queue
import re
import threading
import time
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ZenohSettings
from camber.runtime.tls_certificates import TlsError, certificate_name

Access = Literal["permitted", "denied"]
_ECHO = re.compile(r"camber/v1/([^/*]+)/echo")
_AGAIN_S = 0.2  # chosen: repetition of the probe
_ECHO_LIMIT_S = 3.0  # there and back, once both have joined
_LIMIT_S = 10.0  # chosen: longest wait to join the router


def echo_key(name: str) -> str:
    """Return the key on which a publisher for this vehicle receives its own probe."""
    return f"camber/v1/{name}/echo"


def name_in(rules: Iterable[Mapping[str, Any]]) -> str | None:
    """Return the name whose echo access rules permit; None if there is none, or more than one."""
    names = {match[1] for rule in rules for key in rule["key_exprs"] if (match := _ECHO.fullmatch(key))}
    return names.pop() if len(names) == 1 else None


def can_publish(
    settings: ZenohSettings, name: str, *, timeout_s: float, at: Collection[object] = ()
) -> Access:
    """Does the router let pass what we say in the name of a vehicle? Joins, asks, leaves.

    `name` is the second part of our keys; a service of the fleet says "fleet", a consumer its own name. `denied`: the
    router was joined, but its access list does not give this name to our certificate. Raises BusError where it cannot
    be joined: nobody there, one of the certificates is not accepted, or it is none of the routers `at`.
    """
    key, nonce = echo_key(name), os.urandom(16)
    came = threading.Event()
    settings = settings.model_copy(update={"mode": "client", "listen": []})
    with (
        open_session(settings, timeout_s=timeout_s) as hearing,
        open_session(settings, timeout_s=timeout_s) as saying,
    ):
        if at and not set(map(str, at)) & set(map(str, hearing.info.routers_zid())):
            raise BusError(f"{', '.join(settings.connect)}: not the router of our link")
        subscriber = hearing.declare_subscriber(
            key, lambda sample: came.set() if sample.payload.to_bytes() == nonce else None
        )
        deadline = time.monotonic() + _ECHO_LIMIT_S
        while not came.is_set() and time.monotonic() < deadline:
            saying.put(key, nonce)  # the subscription may not have come through yet
            came.wait(_AGAIN_S)
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    return "permitted" if came.is_set() else "denied"


def denial_message(settings: ZenohSettings, name: str) -> str:
    """What `denied` means, in one line."""
    certificate = certificate_name(settings.tls_certificate or Path())
    at = ", ".join(settings.connect)
    return (
        f"{at} lets nothing pass that {certificate} says as {name}: not in its access list (docs/security.md)"
    )


class AccessProbe:
    """Probes periodically in a thread, because the access list may change, and reports each denial."""

    def __init__(self, settings: ZenohSettings, name: str, *, again_s: float = 60.0) -> None:
        self._problems: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._settings, self._name, self._again_s = settings, name, again_s
        threading.Thread(target=self._ask, name="access_probe", daemon=True).start()

    def problems(self) -> list[str]:
        """What has come of asking since this was last called."""
        return [self._problems.get() for _ in range(self._problems.qsize())]

    def _ask(self) -> None:
        while True:
            try:
                if can_publish(self._settings, self._name, timeout_s=_LIMIT_S) == "denied":
                    self._problems.put(denial_message(self._settings, self._name))
            except (BusError, TlsError) as error:
                self._problems.put(str(error))
            time.sleep(self._again_s)


__all__ = ["AccessProbe", "BusError", "can_publish", "denial_message", "echo_key", "name_in"]
