"""The live page in Chromium beside a vehicle of real processes: roads, a wrong fix in red with its reason, health."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from support.browser import WatchedPage, chromium, served_address, watched
from support.live_vehicle import VEHICLE, LiveVehicle, driving
from support.running import camber_started, free_endpoint, wait_until
from support.tree import ROOT

pytestmark = pytest.mark.slow

SIZES = {
    "phone": {"width": 390, "height": 844},
    "desk": {"width": 1440, "height": 900},
    "wall": {"width": 3840, "height": 2160},
}
PICTURES = ROOT / "out" / "live"
ERRONEOUS = (217, 58, 30)
"""`--erroneous` of the page's light colours."""


@dataclass(kw_only=True)
class Here:
    vehicle: LiveVehicle
    server: Any
    shown: WatchedPage


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Here]:
    with ExitStack() as ends:
        browser = ends.enter_context(chromium())
        vehicle = LiveVehicle(tmp_path_factory.mktemp("vehicle"), free_endpoint())
        ends.enter_context(driving(vehicle))
        command = ("live", "--connect", vehicle.endpoint, "--vehicle", VEHICLE, "--port", 0)
        server = ends.enter_context(camber_started(*command))
        address = served_address(server)
        shown = watched(browser, f"{address}#span=60&theme=light")
        shown.wait_for("camber.map.ready && camber.store.tables.verdict.length > 20")
        yield Here(vehicle=vehicle, server=server, shown=shown)


def pixels_near(page: Any, selector: str, colour: tuple[int, int, int]) -> int:
    picture = np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB"), np.int64)
    return int((np.abs(picture - colour).max(axis=2) < 24).sum())


def state_of(page: Any, service: str) -> str:
    row = page.locator(f'camber-health [data-service="{service}"]')
    return str(row.get_attribute("data-state")) if row.count() else "absent"


def test_the_roads_of_the_vehicles_map_are_drawn(here: Here) -> None:
    drawn = "camber.map.map.queryRenderedFeatures({ layers: ['surfaces'] }).length"
    here.shown.wait_for(f"{drawn} > 5")
    sigma = "camber.map.map.queryRenderedFeatures({ layers: ['surfaces'] })[0].properties.sigma"
    assert here.shown.page.evaluate(sigma) == pytest.approx(0.03, abs=0.02)


def test_a_wrong_fix_is_red_and_its_reason_is_one_click_away(here: Here) -> None:
    page = here.shown.page
    wrong = "camber.store.tables.verdict.arrays.verdict.subarray(0, camber.store.tables.verdict.length).includes(2)"
    here.shown.wait_for(wrong)
    page.get_by_role("button", name="show it", exact=True).click()
    here.shown.wait_for("document.querySelector('camber-fix .detail').textContent !== ''")
    assert page.locator("camber-fix .verdict").text_content() == "erroneous"
    assert page.locator("camber-fix .reason").text_content() in {
        "height disagrees", "position disagrees", "height and position disagree", "estimates disagree",
        "continuity disagrees",
    }  # fmt: skip
    here.shown.wait_for("camber.map.map.areTilesLoaded()")
    page.wait_for_timeout(500)
    # The points of at least one fix, of ten pixels and more across.
    assert pixels_near(page, "camber-map .canvas", ERRONEOUS) > 60
    page.keyboard.press("Escape")
    page.keyboard.press("End")


def test_a_killed_service_turns_red_and_green_again(here: Here) -> None:
    page = here.shown.page
    wait_until(lambda: state_of(page, "antenna_height") == "ok", timeout_s=30.0, why="it is not green")
    here.vehicle.kill("antenna_height")
    wait_until(lambda: state_of(page, "antenna_height") == "bad", timeout_s=30.0, why="it is not red")
    here.vehicle.start("antenna_height")
    wait_until(lambda: state_of(page, "antenna_height") == "ok", timeout_s=60.0, why="it is not green again")


@pytest.mark.parametrize("size", SIZES)
def test_pictures_at_every_size(here: Here, size: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    page = here.shown.page
    page.set_viewport_size(SIZES[size])
    page.wait_for_timeout(1000)
    # Eight million pixels are drawn by software while other tests compute: 30 s were once too few.
    page.screenshot(path=PICTURES / f"{size}.png", timeout=120_000)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "something is beyond the edge"
    page.keyboard.press("t")


def test_the_server_is_small(here: Here) -> None:
    status = Path(f"/proc/{here.server.pid}/status").read_text()
    (peak_kb,) = (int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    assert peak_kb < 150_000


def test_nothing_left_the_machine_and_nothing_went_wrong(here: Here) -> None:
    """Last, of all that the page did before."""
    assert any(address.startswith("ws://127.0.0.1") for address in here.shown.requests)
    assert (here.shown.complaints, here.shown.elsewhere()) == ([], [])
