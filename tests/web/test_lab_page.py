"""The lab's page in Chromium, opened from a disk: one size of error in all charts, round ticks, no request."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from camber.validation.lab import command as lab
from support.browser import WatchedPage, chromium, watched
from support.tree import ROOT

pytestmark = pytest.mark.slow

SIZES = {"phone": (390, 844), "desk": (1440, 900)}
PICTURES = ROOT / "out" / "report"
CURSORS = "camber.curves.charts.map(chart => chart.plot.cursor.idx)"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WatchedPage]:
    out = tmp_path_factory.mktemp("lab")
    assert lab.main(["--trials", "400", "--seed", "3", "--out", str(out)]) == 0
    path: Path = out / "lab.html"
    with chromium() as browser:
        page = watched(browser, path.as_uri())
        page.wait_for("camber.curves.charts.length === 4")
        yield page
        assert page.complaints == []
        assert set(page.requests) == {path.as_uri()}


def test_pointing_at_one_chart_marks_the_size_in_all(shown: WatchedPage) -> None:
    page = shown.page
    box = page.locator("lab-curves .u-over").nth(1).bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    shown.wait_for(f"new Set({CURSORS}).size === 1 && {CURSORS}[0] !== null")
    texts = page.locator("lab-curves .head").all_text_contents()
    assert all("n = " in text for text in texts), texts
    page.mouse.move(1.0, 1.0)


def test_axes_have_round_ticks(shown: WatchedPage) -> None:
    assert shown.page.evaluate("camber.curves.charts[0].plot.axes[0]._splits") == [0.2, 0.5, 1, 2, 5, 10, 20]


@pytest.mark.parametrize("size", SIZES)
def test_pictures_of_the_lab_at_every_size(shown: WatchedPage, size: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    width, height = SIZES[size]
    shown.page.set_viewport_size({"width": width, "height": height})
    shown.page.wait_for_timeout(500)
    shown.page.screenshot(path=PICTURES / f"lab-{size}.png", full_page=True)
    assert shown.page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (
        "something is beyond the edge"
    )
