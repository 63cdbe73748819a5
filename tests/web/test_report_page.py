"""The report in Chromium, opened from a disk: one epoch in all charts, roads below the track, no request."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from camber.replay.short_drive import write_short_drive
from camber.validation.evaluate import main
from support.browser import WatchedPage, chromium, watched
from support.running import replayed
from support.tree import ROOT

pytestmark = pytest.mark.slow

SIZES = {"phone": (390, 844), "desk": (1440, 900)}
PICTURES = ROOT / "out" / "report"
READ = "Number.isFinite(camber.view.end) && camber.map.placed"
CURSORS = (
    "camber.charts.charts.map(c => c.plot.cursor.left < 0 ? NaN : c.plot.posToVal(c.plot.cursor.left, 'x'))"
)
MARKED = "camber.map.marked.filter(mark => mark.kind === 'hover').map(mark => mark.at)"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return replayed(write_short_drive(folder / "drive"), folder / "out") / "report.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as program:
        yield program


@pytest.fixture
def shown(browser: Any, report: Path) -> Iterator[WatchedPage]:
    page = watched(browser, report.as_uri())
    page.wait_for(READ)
    yield page
    assert page.complaints == []
    assert set(page.requests) == {report.as_uri()}
    page.page.close()


def test_the_report_of_a_replay_is_that_of_its_recording(report: Path) -> None:
    replayed_report = report.read_bytes()
    assert main([str(report.parent)]) == 0
    assert report.read_bytes() == replayed_report


def middle_of(page: Any, selector: str) -> tuple[float, float]:
    box = page.locator(selector).first.bounding_box()
    return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]


def test_pointing_at_one_chart_marks_the_epoch_in_all(shown: WatchedPage) -> None:
    page = shown.page
    page.mouse.move(*middle_of(page, "camber-charts .u-over"))
    shown.wait_for("Number.isFinite(camber.view.hover)")
    hover = page.evaluate("camber.view.hover")
    pixel_s = page.evaluate("camber.view.span") / 200.0
    assert page.evaluate(CURSORS) == pytest.approx(
        [hover] * page.evaluate("camber.charts.charts.length"), abs=pixel_s
    )
    shown.wait_for(f"{MARKED}.length === 1")
    table = "camber.store.tables.verdict"
    row = f"{table}.at({hover} + 0.05)"
    assert page.evaluate(f"{MARKED}[0]") == page.evaluate(
        f"[{table}.arrays.lon[{row}], {table}.arrays.lat[{row}]]"
    )
    ring = page.locator("camber-stanford .ring")
    assert ring.is_visible()
    error = f"camber.store.tables.position.arrays.error_m[camber.store.tables.position.at({hover} + .05)]"
    assert ring.evaluate("e => parseFloat(e.style.left)") == pytest.approx(
        page.evaluate(f"camber.stanford.axes.x({error})"), abs=0.5
    )


def test_pointing_at_the_track_marks_the_epoch_in_the_charts(shown: WatchedPage) -> None:
    page = shown.page
    page.locator("camber-map").scroll_into_view_if_needed()
    at = 100
    x, y = page.evaluate(
        f"[camber.map.px(camber.map.places.verdict[{2 * at}]), camber.map.py(camber.map.places.verdict[{2 * at + 1}])]"
    )
    box = page.locator("camber-map").bounding_box()
    page.mouse.move(box["x"] + x, box["y"] + y)
    shown.wait_for("Number.isFinite(camber.view.hover)")
    hover = page.evaluate("camber.view.hover")
    assert hover == pytest.approx(page.evaluate(f"camber.store.tables.verdict.arrays.t[{at}]"), abs=1.0)
    pixel_s = page.evaluate("camber.view.span") / 200.0
    assert page.evaluate(CURSORS) == pytest.approx(
        [hover] * page.evaluate("camber.charts.charts.length"), abs=pixel_s
    )


def test_the_roads_of_the_release_are_below_the_track(shown: WatchedPage) -> None:
    under = """(map => {
      const c = document.createElement('canvas').getContext('2d'), [x, y] = map.places.verdict;
      return [...map.paths.values()].some(path => c.isPointInPath(path, x, y));
    })(camber.map)"""
    assert shown.page.evaluate(under)


def test_an_episode_is_shown_by_a_click_with_the_judges_text(shown: WatchedPage) -> None:
    page = shown.page
    row = page.locator("tr.go").first
    begin = float(row.get_attribute("data-begin"))
    row.click()
    shown.wait_for("camber.view.span < 60")
    assert page.evaluate("camber.view.begin") < begin < page.evaluate("camber.view.end")
    assert page.evaluate("camber.view.selected") == pytest.approx(begin, abs=1e-3)
    assert page.locator("camber-fix .verdict").text_content() != "none so far"
    assert page.locator("camber-fix .detail").text_content() != ""


@pytest.mark.parametrize("size", SIZES)
def test_pictures_of_the_report_at_every_size(shown: WatchedPage, size: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    width, height = SIZES[size]
    shown.page.set_viewport_size({"width": width, "height": height})
    shown.page.wait_for_timeout(500)
    shown.page.screenshot(path=PICTURES / f"{size}.png", full_page=True)
    assert shown.page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (
        "something is beyond the edge"
    )
