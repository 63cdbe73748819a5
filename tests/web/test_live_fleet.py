"""The live page of a fleet in Chromium: every vehicle on the map and in the list, and why one is not usable."""

from __future__ import annotations

import io
import json
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh
from PIL import Image

from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.base import Message
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.fleet import (
    HELD_REASONS,
    HeldChanges,
    MapChanges,
    MapDecision,
    MapDecisionReceipt,
    PublishedChanges,
    RegionAlarms,
)
from camber.schemas.integrity import Position
from support.browser import chromium, served_address, watched
from support.release_world import write_signing_keys
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
    fields = {
        "status": "known",
        "map_version": 4,
        "reference_sha256": "a" * 64,
        "held": held,
        "published": published,
        "alarms": alarms,
    }
    return MapChanges(**{"time_ns": SystemClock().now_ns()} | fields | changed)


@contextmanager
def answering(endpoint: str, *replies: Message) -> Iterator[list[MapDecision]]:
    """What `map_update` answers of changes of the map and of decisions; the decisions that came."""
    decisions: list[MapDecision] = []

    def answer_with(reply: Message) -> Callable[[zenoh.Query], None]:
        def answer(query: zenoh.Query) -> None:
            with query:
                if isinstance(reply, MapDecisionReceipt) and query.payload is not None:
                    decisions.append(decode(MapDecision, query.payload.to_bytes()).message)
                data = encode(reply, source="map_update")
                query.reply(str(query.key_expr), data, encoding=encoding_of(type(reply)))

        return answer

    with closing(open_session(ZenohSettings(mode="client", connect=[endpoint]))) as session:
        for reply in replies:
            name = "decision" if isinstance(reply, MapDecisionReceipt) else "changes"
            session.declare_queryable(f"camber/v1/fleet/map/{name}", answer_with(reply))
        yield decisions


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


def test_on_a_phone_a_published_change_is_rolled_back_and_texts_of_others_stay_texts(tmp_path: Path) -> None:
    hostile = "<img src=x onerror=\"document.title='taken'\">"
    line = {"type": "LineString", "coordinates": [[137.0, 35.0], [137.0, 35.001]]}
    road = {"type": "Feature", "geometry": line, "properties": {"link_id": "7", "name": hostile}}
    (tmp_path / "roads.geojson").write_text(json.dumps({"features": [road]}))
    key, _ = write_signing_keys(tmp_path, tmp_path)
    refused = MapDecisionReceipt(time_ns=SystemClock().now_ns(), status="refused", reason=hostile)
    recorded = MapDecisionReceipt(time_ns=SystemClock().now_ns(), status="recorded")
    with chromium() as browser, ExitStack() as ends:
        endpoint = ends.enter_context(loopback_router())
        ends.enter_context(answering(endpoint, map_changes()))
        command = "live", "--fleet", "--connect", endpoint, "--port", 0, "--roads", tmp_path / "roads.geojson"
        process = ends.enter_context(camber_started(*command, "--review", key))
        shown = watched(browser, served_address(process) + "#theme=dark", width=390, height=844)
        page = shown.page
        shown.wait_for("camber.store.changes?.published.length === 1")
        page.locator("camber-changes [data-kind=published] button").click()
        assert hostile in page.locator("camber-changes section.chosen").text_content()
        page.get_by_role("button", name="Roll back").click()
        page.get_by_label("Who decides").fill("Ann")
        page.get_by_label("Why").fill("a ferry was mapped")
        send = page.locator("dialog.decision button[type=submit]")
        with answering(endpoint, refused) as decisions:
            send.click()
            shown.wait_for("document.querySelector('dialog.decision [role=alert]').textContent !== ''")
            assert page.locator("dialog.decision [role=alert]").text_content() == hostile
        (decision,) = decisions
        assert (decision.action, decision.map_version) == ("roll_back", 3)
        assert decision.reference_sha256 == "a" * 64
        assert (decision.who, decision.why) == ("Ann", "a ferry was mapped")
        assert "409" in shown.complaints.pop()  # of the browser itself
        with answering(endpoint, recorded):
            send.click()
            page.locator("dialog.decision").wait_for(state="detached")
        assert "Rolled back" in page.locator("camber-changes [role=status]").text_content()
        assert page.locator("[data-action=roll_back]").is_disabled()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert page.locator("camber-changes img").count() == 0
        assert (shown.complaints, shown.elsewhere()) == ([], [])
        page.close()
