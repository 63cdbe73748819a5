"""Who is on the bus before its router joins it later; who asks with a limit gets an error that nobody is there."""

from __future__ import annotations

import pytest

from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ZenohSettings
from support.running import free_port, wait_until


def test_a_peer_that_is_there_before_its_router_finds_it() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session(ZenohSettings(connect=[endpoint])) as peer:
        assert list(peer.info.routers_zid()) == []
        with open_session(ZenohSettings(mode="router", connect=[], listen=[endpoint])) as router:
            result = wait_until(
                lambda: list(peer.info.routers_zid()), timeout_s=20.0, why="the router was not found"
            )
            assert result == [router.info.zid()]


def test_a_router_that_went_away_is_rejoined() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = ZenohSettings(mode="router", connect=[], listen=[endpoint])
    with open_session(ZenohSettings(connect=[endpoint])) as peer:
        for _ in range(2):
            with open_session(router) as there:
                expected = [there.info.zid()]
                wait_until(
                    lambda expected=expected: list(peer.info.routers_zid()) == expected,
                    timeout_s=20.0,
                    why="the router was not found",
                )
            wait_until(
                lambda: not list(peer.info.routers_zid()), timeout_s=20.0, why="the router was not missed"
            )


def test_with_a_limit_nobody_there_is_an_error_that_names_the_place() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(BusError, match=endpoint):
        open_session(ZenohSettings(mode="client", connect=[endpoint]), timeout_s=0.3)
