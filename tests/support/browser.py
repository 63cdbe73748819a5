"""Debian's Chromium, driven by Playwright, and a page whose every request and complaint is kept."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import pytest

from support.running import wait_until

PROGRAM = shutil.which("chromium")
# WebGL without a graphics processor; nothing of its own that asks other machines.
OPTIONS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
)


@dataclass(kw_only=True)
class WatchedPage:
    """A page, what it asked for and what it complained of."""

    page: Any
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def wait_for(self, expression: str, *, timeout_s: float = 30.0) -> None:
        """Until an expression is true; asked again and again, since the page's policy forbids it to evaluate texts."""
        wait_until(lambda: self.page.evaluate(expression), timeout_s=timeout_s, why=expression)

    def elsewhere(self) -> list[str]:
        """Requests that left the machine."""
        names = ("127.0.0.1", "localhost", None)
        return [address for address in self.requests if urlsplit(address).hostname not in names]


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser; the test is skipped visibly where it is not installed."""
    if PROGRAM is None:
        pytest.skip("needs Debian's chromium: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=list(OPTIONS))
        try:
            yield browser
        finally:
            browser.close()


def watched(browser: Any, address: str, *, width: int = 1440, height: int = 900) -> WatchedPage:
    """The page at an address."""
    watched_page = WatchedPage(page=browser.new_page(viewport={"width": width, "height": height}))
    page = watched_page.page
    page.on("request", lambda request: watched_page.requests.append(request.url))
    page.on("websocket", lambda socket: watched_page.requests.append(socket.url))
    page.on("pageerror", lambda error: watched_page.complaints.append(str(error)))
    page.on(
        "console",
        lambda message: (
            watched_page.complaints.append(message.text)
            if message.type in ("error", "warning") and "GPU stall" not in message.text
            else None
        ),
    )
    page.goto(address)
    return watched_page


def served_address(process: Any) -> str:
    """The address that `camber live` prints when it serves."""
    line = str(process.stdout.readline())
    assert "http" in line, line + process.stdout.read()
    return line[line.index("http") :].strip()
