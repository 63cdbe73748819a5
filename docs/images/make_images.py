"""Make the pictures of the README: `make demo`, then `PYTHONPATH=tests python docs/images/make_images.py out/demo`.

The pictures are of the live page in Debian's Chromium, on the demo's own drive; nothing is drawn into them.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from support.browser import chromium, served_address, watched
from support.running import camber_started

FOLDER = Path(__file__).parent
READ = "camber.map.ready && camber.store.complete && Number.isFinite(camber.view.end)"
WRONG = "camber.map.goTo(camber.view.end); camber.map.map.jumpTo({ zoom: 19.6 })"


def main(run: Path) -> None:
    """Write live.png, the whole drive, and wrong-fix.png, the last wrong fix of it."""
    with chromium() as browser, camber_started("live", run, "--port", 0) as process:
        address = served_address(process)
        shown = watched(browser, f"{address}#theme=light")
        shown.wait_for(READ)
        save(shown.page, "live.png")
        shown.page.keyboard.press("w")
        shown.page.keyboard.press("p")
        shown.page.evaluate(WRONG)
        save(shown.page, "wrong-fix.png")


def save(page: Any, name: str) -> None:
    """Write what the page shows."""
    page.wait_for_timeout(4000)  # tiles, and no cursor
    Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(FOLDER / name, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
