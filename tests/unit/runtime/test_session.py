"""Who is on the bus before its router joins it later; who asks with a limit gets an error that nobody is there."""

from __future__ import annotations

import pytest
import zenoh

from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ZenohSettings
from support.running import free_port, wait_until


def test_a_peer_finds_a_router_that_comes_later_and_one_that_went_away() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    settings = ZenohSettings(mode="router", connect=[], listen=[endpoint])
    with open_session(ZenohSettings(connect=[endpoint])) as peer:

        def wait_for(*routers: zenoh.ZenohId) -> None:
            wait_until(
                lambda: list(peer.info.routers_zid()) == list(routers), timeout_s=20.0, why=f"not {routers}"
            )

        assert list(peer.info.routers_zid()) == []
        for _ in range(2):
            with open_session(settings) as router:
                wait_for(router.info.zid())
            wait_for()


def test_with_a_limit_nobody_there_is_an_error_that_names_the_place() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(BusError, match=endpoint):
        open_session(ZenohSettings(mode="client", connect=[endpoint]), timeout_s=0.3)
