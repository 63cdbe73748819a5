"""The links of a built site: each leads to a file of it and an anchor there, and nothing is loaded from elsewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_ADDRESSES = {"a": "href", "link": "href", "script": "src", "img": "src", "source": "src", "iframe": "src"}
"""Elements with an address, and the attribute that has it."""


class PageLinks(HTMLParser):
    """Anchors and addresses of a page of HTML."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = {"", "__search"}
        self.addresses: list[tuple[str, str]] = []
        """Element and address, in the order of the page."""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the anchor and the address of an element."""
        values = dict(attrs)
        self.anchors |= {value for name in ("id", "name") if (value := values.get(name))}
        address = values.get(_ADDRESSES.get(tag, ""))
        if address is not None:
            self.addresses.append((tag, address))


def broken_links(site: Path) -> list[str]:
    """Return a line for each link that leads nowhere, and for each file that a page loads from elsewhere."""
    pages = {path: PageLinks(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    lines = {
        f"{path.relative_to(site)}: {problem}": None
        for path, page in pages.items()
        for tag, address in page.addresses
        if (problem := _problem(path, tag, address, pages))
    }
    return list(lines)


def _problem(path: Path, tag: str, address: str, pages: dict[Path, PageLinks]) -> str | None:
    parts = urlsplit(address)
    if parts.scheme or parts.netloc:
        is_loaded = tag != "a" and parts.scheme != "data"
        return f"loads {address}, expected a file of the site" if is_loaded else None
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if not target.is_file():
        return f"link to {address}, expected a file of the site"
    if target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return f"link to {address}, expected an anchor of that page"
    return None
