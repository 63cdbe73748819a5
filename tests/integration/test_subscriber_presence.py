"""A service knows whether somebody subscribes to one of its channels, through the router."""

from __future__ import annotations

from contextlib import closing

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from support.running import loopback_router, wait_until

KEY = "camber/v1/car/localizer/match_points"


def test_a_subscriber_is_seen_when_it_comes_and_when_it_leaves() -> None:
    with loopback_router() as endpoint:
        client = ZenohSettings(mode="client", connect=[endpoint])
        settings = ServiceSettings(vehicle="car", zenoh=client, log_level="error")
        with closing(open_session(client)) as other, closing(open_session(client)) as session:
            bus = Bus(session, settings, "localizer", SystemClock())
            assert not bus.has_subscriber("scan_match_points")
            subscriber = other.declare_subscriber(KEY, lambda _: None)
            wait_until(
                lambda: bus.has_subscriber("scan_match_points"),
                timeout_s=10.0,
                why="the subscriber is not seen",
            )
            subscriber.undeclare()
            wait_until(
                lambda: not bus.has_subscriber("scan_match_points"), timeout_s=10.0, why="it is still seen"
            )
