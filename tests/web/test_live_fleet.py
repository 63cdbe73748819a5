"""The live page of a fleet in Chromium: every vehicle on the map and in the list, and why one is not usable."""

from __future__ import annotations

import math
import threading
from contextlib import ExitStack, closing

import pytest

from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.codec import encode
from camber.schemas.integrity import Position
from support.browser import chromium, served_address, watched
from support.running import camber_started, loopback_router

pytestmark = pytest.mark.slow

VEHICLES = 12
EVERY_S = 0.2


def position(vehicle: int) -> Position:
    angle = 2.0 * math.pi * vehicle / VEHICLES
    return Position(
        time_ns=SystemClock().now_ns(),
        source="rtk",
        usable=vehicle > 0,
        reason="none" if vehicle else "no_independent_position",
        latitude_rad=math.radians(35.0 + 0.004 * math.sin(angle)),
        longitude_rad=math.radians(137.0 + 0.004 * math.cos(angle)),
        height_m=40.0,
        yaw_rad=angle,
        horizontal_protection_level_m=1.0,
        alert_limit_m=1.5,
    )


def publish(endpoint: str, ended: threading.Event) -> None:
    with closing(open_session(ZenohSettings(mode="client", connect=[endpoint]))) as session:
        while not ended.wait(EVERY_S):
            for vehicle in range(VEHICLES):
                data = encode(position(vehicle), source="integrity")
                session.put(f"camber/v1/car{vehicle:02d}/integrity/position", data)


def test_all_vehicles_are_shown_the_one_that_is_not_usable_first() -> None:
    ended = threading.Event()
    with chromium() as browser, ExitStack() as ends:
        endpoint = ends.enter_context(loopback_router())
        publisher = threading.Thread(target=publish, args=(endpoint, ended), daemon=True)
        publisher.start()
        ends.callback(publisher.join)
        ends.callback(ended.set)
        process = ends.enter_context(camber_started("live", "--fleet", "--connect", endpoint, "--port", 0))
        shown = watched(browser, served_address(process))
        shown.wait_for(f"camber.map.ready && camber.store.fleet.length === {VEHICLES}")
        shown.wait_for(f"document.querySelectorAll('camber-fleet tr').length === {VEHICLES}")
        first = shown.page.locator("camber-fleet tr").first
        assert first.text_content() == "car00no independent position"
        assert f"position usable: {VEHICLES - 1}" in shown.page.locator("camber-fleet h2").text_content()
        assert not shown.page.locator("camber-charts").is_visible()
        centre = "(place => place[1] > 34.9 && place[1] < 35.1)(camber.map.map.getCenter().toArray())"
        shown.wait_for(centre)
        shown.page.get_by_role("button", name="car03").click()
        shown.wait_for("Math.abs(camber.map.map.getCenter().lng - 137.0) < 1e-4")
        # The services of the cloud are not there, and it says so.
        shown.wait_for("document.querySelector('[data-service=map_update]')?.dataset.state === 'bad'")
        assert (shown.complaints, shown.elsewhere()) == ([], [])
        shown.page.close()
