"""The live page in Chromium on a finished replay: truth, texts of a hostile vehicle, a damaged file, the address."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from camber.formats.drive.recorder import Recorder
from camber.replay.short_drive import START_NS, write_short_drive
from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from support.browser import WatchedPage, chromium, served_address, watched
from support.running import camber_started, replayed

pytestmark = pytest.mark.slow

HOSTILE = "<img src=x onerror=\"document.title='taken'\"><script>document.title='taken'</script>"
READ = "camber.store.complete && Number.isFinite(camber.view.end)"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as program:
        yield program


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return replayed(write_short_drive(folder / "drive"), folder / "out", "--quiet")


def opened(ends: ExitStack, browser: Any, path: Path, fragment: str = "") -> WatchedPage:
    address = served_address(ends.enter_context(camber_started("live", path, "--port", 0)))
    shown = watched(browser, address + fragment)
    ends.callback(shown.page.close)
    shown.wait_for("camber.map.ready")
    return shown


def test_a_replay_is_shown_with_its_map_and_its_truth(browser: Any, run: Path) -> None:
    with ExitStack() as ends:
        shown = opened(ends, browser, run)
        shown.wait_for(READ)
        page = shown.page
        shown.wait_for("camber.map.map.queryRenderedFeatures({ layers: ['surfaces'] }).length > 20")
        shown.wait_for("!document.querySelector('camber-stanford').hidden")
        assert page.evaluate("camber.store.tables.verdict.length") > 500
        assert "No map" not in page.locator("camber-notes").text_content()
        # Paused where a person stops, shared as an address, opened by another.
        page.keyboard.press("w")
        page.keyboard.press("ArrowLeft")
        end, selected = page.evaluate("[camber.view.end, camber.view.selected]")
        shown.wait_for(f"location.hash.includes('&t={end:.2f}&at={selected:.3f}')")
        shared = watched(browser, page.url)
        shared.wait_for(READ)
        again = shared.page.evaluate("[camber.view.end, camber.view.selected]")
        assert again == pytest.approx([end, selected], abs=0.02)
        shared.page.close()
        table = page.evaluate(
            "import('/static/exports.js').then(m => m.tableText(camber.store, camber.view))"
        )
        rows = [line.split(",") for line in table.splitlines()]
        assert {len(row) for row in rows} == {len(rows[0])}
        assert len(rows) > 100
        assert {row[rows[0].index("verdict")] for row in rows[1:]} >= {"confirmed", "erroneous"}
        with page.expect_download() as picture:
            page.get_by_role("button", name="PNG").click()
        with Image.open(picture.value.path()) as image:
            assert image.size[0] > 900
            assert len(image.convert("RGB").getcolors(1 << 20) or ()) > 100
        page.keyboard.press("?")
        assert page.locator("dialog").is_visible()
        assert (shown.complaints, shown.elsewhere()) == ([], [])


def recording(path: Path, detail: str) -> Path:
    recorder = Recorder(path)
    for k in range(3):
        time_ns = START_NS + k * 200_000_000
        place = {"latitude_rad": math.radians(35.0), "longitude_rad": math.radians(137.0), "height_m": 41.6}
        fix = Fix(
            time_ns=time_ns, fix_id=k, origin="receiver", quality="fixed", covariance_enu_m2=None, **place
        )
        verdict = Verdict(
            time_ns=time_ns, fix_id=k, verdict="erroneous", reason="height_disagrees", detail=detail
        )
        for channel, producer, message in (
            ("fix", "gnss/fix", fix),
            ("verdict", "integrity/verdict", verdict),
        ):
            recorder.add(
                channel,
                encode(message, source=producer.partition("/")[0], sequence=k),
                key=f"camber/v1/car/{producer}",
                arrival_ns=time_ns,
            )
    recorder.close()
    return path


def test_what_a_vehicle_sends_is_text(browser: Any, tmp_path: Path) -> None:
    with ExitStack() as ends:
        shown = opened(ends, browser, recording(tmp_path / "hostile.mcap", HOSTILE))
        shown.wait_for("document.querySelector('camber-fix .detail').textContent !== ''")
        assert shown.page.locator("camber-fix .detail").text_content() == HOSTILE
        assert shown.page.locator("camber-fix img, camber-fix script").count() == 0
        assert "taken" not in shown.page.title()
        assert shown.complaints == []


def test_of_a_recording_cut_in_half_the_readable_part_is_shown(
    browser: Any, run: Path, tmp_path: Path
) -> None:
    whole = (run / "recording.mcap").read_bytes()
    half = tmp_path / "half.mcap"
    half.write_bytes(whole[: len(whole) // 2])
    with ExitStack() as ends:
        shown = opened(ends, browser, half)
        shown.wait_for(READ)
        assert shown.page.evaluate("camber.store.tables.verdict.length") > 20
        assert "damage" in shown.page.locator("camber-notes .bad").first.text_content()
