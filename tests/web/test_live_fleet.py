"""The live page of a fleet in Chromium: every vehicle on the map and in the list, and why one is not usable."""

from __future__ import annotations

import io
import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager

import numpy as np
import pytest
import zenoh
from PIL import Image

from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.codec import encode, encoding_of
from camber.schemas.fleet import HELD_REASONS, HeldChanges, MapChanges, PublishedChanges, RegionAlarms
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


def map_changes(**changed: object) -> MapChanges:
    """One change that is held, a published one 60 m to the east, an alarm around them."""
    f4, i4 = np.float32, np.int32
    latitude_rad, longitude_rad = np.radians([35.0]), np.radians([137.0])
    held = HeldChanges(
        surface_id=np.array([11]), link_id=np.array([7]), latitude_rad=latitude_rad, longitude_rad=longitude_rad,
        in_map_m=np.array([0.0], f4), offset_m=np.array([0.62], f4), standard_error_m=np.array([0.008], f4),
        agreement=np.array([0.9], f4), vehicles=np.array([7], i4), votes=np.array([21], i4),
        days=np.array([3], i4), reason=np.array([HELD_REASONS.index("too_large")], np.uint8),
    )  # fmt: skip
    published = PublishedChanges(
        surface_id=np.array([12]), link_id=np.array([7]),
        latitude_rad=latitude_rad, longitude_rad=longitude_rad + 1.15e-5,
        offset_m=np.array([-0.052], f4), sigma_m=np.array([0.011], f4), vehicles=np.array([9], i4),
        since_map_version=np.array([4]),
    )  # fmt: skip
    alarms = RegionAlarms(
        everywhere=np.array([0], np.uint8), latitude_rad=latitude_rad + 4e-6, longitude_rad=longitude_rad,
        shift_m=np.array([0.06], f4), share=np.array([0.75], f4), surfaces=np.array([40], i4),
    )  # fmt: skip
    fields = {"status": "known", "map_version": 4, "held": held, "published": published, "alarms": alarms}
    return MapChanges(**{"time_ns": SystemClock().now_ns()} | fields | changed)


@contextmanager
def answering(endpoint: str, reply: MapChanges) -> Iterator[None]:
    """What `map_update` answers of changes of the map."""

    def answer(query: zenoh.Query) -> None:
        with query:
            data = encode(reply, source="map_update")
            query.reply(str(query.key_expr), data, encoding=encoding_of(MapChanges))

    with closing(open_session(ZenohSettings(mode="client", connect=[endpoint]))) as session:
        session.declare_queryable("camber/v1/fleet/map/changes", answer)
        yield


def test_changes_of_the_map_are_on_the_map_and_in_a_list() -> None:
    with chromium() as browser, ExitStack() as ends:
        endpoint = ends.enter_context(loopback_router())
        hostile = "<img src=x onerror=\"document.title='taken'\">"
        command = ("live", "--fleet", "--connect", endpoint, "--port", 0)
        with answering(
            endpoint, MapChanges(time_ns=SystemClock().now_ns(), status="unknown", reason=hostile)
        ):
            shown = watched(
                browser, served_address(ends.enter_context(camber_started(*command))) + "#theme=light"
            )
            line = "document.querySelector('camber-changes p').textContent"
            shown.wait_for(f"{line} === 'map_update does not say which: ' + {hostile!r}")
            assert shown.page.locator("camber-changes img").count() == 0
        ends.enter_context(answering(endpoint, map_changes()))
        shown.wait_for(f"{line} === '1 held, 0 pending, 1 published, 1 alarm'")
        page = shown.page
        rows = {
            kind: page.locator(f"camber-changes [data-kind={kind}]")
            for kind in ("held", "published", "alarm")
        }
        assert (
            "+62.0 cm, link 7, surface 11±0.8 cm, 21 votes of 7 vehicles on 3 days"
            in rows["held"].text_content()
        )
        assert "larger than is published unseen" in rows["held"].text_content()
        assert (
            "−5.2 cm, link 7, surface 12±1.1 cm, 9 vehicles, since version 4"
            in rows["published"].text_content()
        )
        assert "+6.0 cm75 % of 40 surfaces in this region" in rows["alarm"].text_content()
        rows["held"].get_by_role("button").click()
        shown.wait_for(
            "camber.map.map.getZoom() > 16 && Math.abs(camber.map.map.getCenter().lng - 137) < 1e-6"
        )
        page.evaluate("camber.map.map.setZoom(18)")
        page.wait_for_timeout(500)
        # Each mark is there in its colour: held in the middle, published to the east of it.
        picture = Image.open(io.BytesIO(page.locator("camber-map").screenshot())).convert("RGB")
        pixels = np.asarray(picture, np.int64)[:, : picture.width - 250]  # without the key
        columns = {}
        for kind, colour in (
            ("held", (183, 121, 31)),
            ("published", (31, 111, 178)),
            ("alarm", (198, 40, 40)),
        ):
            _, columns[kind] = np.nonzero(np.abs(pixels - colour).max(axis=2) < 24)
            assert len(columns[kind]) > 60, kind
        assert np.median(columns["held"]) == pytest.approx(picture.width / 2, abs=4)
        assert np.median(columns["published"]) > picture.width / 2 + 20
        assert (shown.complaints, shown.elsewhere()) == ([], [])
        page.close()
