"""The live page in Chromium on a finished replay: truth, texts of a hostile vehicle, a damaged file, the address."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from camber.cli import main
from camber.formats.drive.mcap_recorder import Recorder
from camber.replay.short_drive import START_NS, write_short_drive
from camber.schemas.base import Message
from camber.schemas.codec import encode
from camber.schemas.gnss import SATELLITE_USES, Fix, SatellitesInView, SatelliteUse
from camber.schemas.integrity import Verdict
from camber.schemas.pose import ScanMatchPoints
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


def opened(ends: ExitStack, browser: Any, path: Path, fragment: str = "", *options: object) -> WatchedPage:
    address = served_address(ends.enter_context(camber_started("live", path, "--port", 0, *options)))
    shown = watched(browser, address + fragment)
    ends.callback(shown.page.close)
    shown.wait_for("camber.map.ready")
    return shown


def test_a_pmtiles_file_is_drawn_at_every_zoom_and_nothing_is_asked_of_others(
    browser: Any, run: Path, tmp_path: Path
) -> None:
    release, archive = run.parent / "drive" / "map", tmp_path / "map.pmtiles"
    assert main(["map", "export", str(release), "--to", "pmtiles", "--out", str(archive)]) == 0
    with ExitStack() as ends:
        shown = opened(ends, browser, run, "", "--map", archive)
        shown.wait_for(READ)
        drawn = "camber.map.map.queryRenderedFeatures({ layers: ['%s'] }).filter(each => %s).length > %d"
        # Only tiles of a file have heights.
        shown.wait_for(drawn % ("surfaces", "each.properties.height > 0", 20))
        for zoom in (14, 8):
            shown.page.evaluate(f"camber.map.map.jumpTo({{ zoom: {zoom} }})")
            shown.wait_for(drawn % ("links", "true", 0))
        shown.wait_for("document.querySelector('camber-notes').textContent.includes('Map: ')")
        assert (shown.elsewhere(), shown.complaints) == ([], [])


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


def recording(path: Path, detail: str, *more: tuple[str, str, Callable[[int], Message]]) -> Path:
    """Three epochs; `more` has channels, their keys and what makes a message of a time."""
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
            *((channel, key, make(time_ns)) for channel, key, make in more),
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


def satellites(time_ns: int) -> SatellitesInView:
    """One satellite in the south that is used, one in the west that is not, others without a direction."""
    uses: dict[str, SatelliteUse] = {
        "G05": "used",
        "E11": "outlier",
        "C07": "no_ephemeris",
        "R03": "use_not_reported",
    }
    return SatellitesInView(
        time_ns=time_ns,
        quality="fixed",
        satellite=np.array([ord(name[0]) * 256 + int(name[1:]) for name in uses], np.int32),
        present=np.array([3, 3, 2, 2], np.uint8),
        azimuth_rad=np.array([math.pi, 1.5 * math.pi, 0.0, 0.0], np.float32),
        elevation_rad=np.array([0.5, 0.5, 0.0, 0.0], np.float32),
        cn0_dbhz=np.array([50.0, 30.0, 30.0, 30.0], np.float32),
        use=np.array([SATELLITE_USES.index(use) for use in uses.values()], np.uint8),
    )


def test_the_sky_has_the_satellites_and_names_why_some_are_left_out(
    browser: Any, run: Path, tmp_path: Path
) -> None:
    path = recording(tmp_path / "sky.mcap", "", ("satellites", "gnss/satellites", satellites))
    with ExitStack() as ends:
        shown = opened(ends, browser, path, "#theme=light")
        shown.wait_for("document.querySelector('camber-sky canvas').ariaLabel?.startsWith('1 used')")
        sky = shown.page.locator("camber-sky")
        assert "1 used, 2 left out, 1 not reported; position: fixed" in sky.text_content()
        assert "codes contradict the others: E11" in sky.text_content()
        assert "no ephemeris: C07" in sky.text_content()
        assert "used or not, not reported: R03" in sky.text_content()
        # Filled as strong as it is, half-way down in the middle; the other one at the left is not filled.
        filled = (79, 143, 131)
        picture = Image.open(io.BytesIO(sky.locator("canvas").screenshot())).convert("RGB")
        rows, columns = np.nonzero(np.abs(np.asarray(picture, np.int64) - filled).max(axis=2) < 24)
        assert len(rows) > 60
        assert np.median(columns) == pytest.approx(picture.width / 2, abs=3)
        assert np.median(rows) == pytest.approx(picture.height * 0.82, abs=12)
        assert shown.complaints == []
        without = opened(ends, browser, run)
        without.wait_for(READ)
        assert "No satellites are published" in without.page.locator("camber-sky").text_content()
        assert not without.page.locator("camber-sky canvas").is_visible()


def scan_match_points(time_ns: int) -> ScanMatchPoints:
    """A wall in the north beyond that of the map, one in the south before it, and one point without a partner."""
    east_m = np.arange(-15.0, 15.0, 0.1, np.float32)
    north_m = np.concatenate((np.full(300, 10.0), np.full(300, -10.0))).astype(np.float32)
    residual_m = np.sign(north_m) * np.float32(0.2)
    return ScanMatchPoints(
        time_ns=time_ns,
        status="converged",
        latitude_rad=math.radians(35.0),
        longitude_rad=math.radians(137.0),
        east_m=np.append(np.tile(east_m, 2), np.float32(0.0)),
        north_m=np.append(north_m, np.float32(0.0)),
        paired=np.append(np.ones(600, np.uint8), np.uint8(0)),
        residual_m=np.append(residual_m, np.float32(0.0)),
    )


def test_a_scan_match_is_drawn_where_it_is_in_the_colours_of_its_residuals(
    browser: Any, run: Path, tmp_path: Path
) -> None:
    path = recording(
        tmp_path / "scan.mcap", "", ("scan_match_points", "localizer/match_points", scan_match_points)
    )
    with ExitStack() as ends:
        shown = opened(ends, browser, path, "#theme=light&map=19.5/35/137/0&follow=0")
        shown.wait_for(READ)
        page = shown.page
        page.keyboard.press("s")
        shown.wait_for("document.querySelector('camber-map .line').textContent.includes('601 points')")
        line = page.locator("camber-map .line").text_content()
        assert "half of them within 0.20 m of the map, 1 without a surface of the map near" in line
        assert "−10 cm" in page.locator("camber-map .key").text_content()
        page.wait_for_timeout(500)
        picture = Image.open(io.BytesIO(page.locator("camber-map .canvas").screenshot())).convert("RGB")
        for colour, north_m in (((224, 106, 16), 10.0), ((33, 102, 201), -10.0)):
            rows, columns = np.nonzero(np.abs(np.asarray(picture, np.int64) - colour).max(axis=2) < 24)
            assert len(rows) > 300
            expected = page.evaluate(f"camber.map.map.project([137, 35 + {north_m} / 110941]).y")
            assert np.median(rows) == pytest.approx(expected, abs=3)
            assert columns.max() - columns.min() > 200
        assert shown.complaints == []
        without = opened(ends, browser, run, "#scan=1")
        without.wait_for(READ)
        without.wait_for(
            "document.querySelector('camber-map .line').textContent.startsWith('No points of a scan match')"
        )
