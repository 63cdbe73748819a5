"""`python -m camber.tools.generate_docs.site [--out FOLDER]`: build the documentation site into FOLDER/docs-site.

Its pages are those of the repository with their links rewritten, the reference of the Python API and that of the
command line. Zensical makes HTML of them; then every link and anchor of the result is checked.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from posixpath import dirname, join, normpath, relpath
from typing import Any

from camber.tools.generate_docs.api_pages import api_pages
from camber.tools.generate_docs.built_links import broken_links
from camber.tools.generate_docs.command_pages import commands_page

ROOT = Path(__file__).parents[4]
_TOP_LEVEL = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Pages outside `docs`, and where they are in the site."""
_CONFIG = "docs/site/zensical.toml"
_LOADED = ("docs/site/site.css", "docs/site/iframe-worker.js")
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:)([^)\s#]+)(?=[)#])")
_LIST_ITEM = re.compile(r"([-*]|\d+\.) ")


def main(argv: list[str] | None = None) -> int:
    """Build the site; return the exit code: 1 where a page, a link or an anchor is missing."""
    parser = argparse.ArgumentParser(
        prog="python -m camber.tools.generate_docs.site",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=Path("out"), metavar="FOLDER", help="default: out")
    out: Path = parser.parse_args(argv).out
    try:
        write_pages(ROOT, out)
    except ValueError as error:
        print(f"docs-site: {error}", file=sys.stderr)
        return 1
    shutil.rmtree(out / "docs-site", ignore_errors=True)
    config = str(out / "zensical.toml")
    command = [sys.executable, "-m", "zensical", "build", "--clean", "--config-file", config]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    (out / "docs-site" / "404.html").unlink(missing_ok=True)  # for the root of a server only, by its links
    broken = broken_links(out / "docs-site") if done.returncode == 0 else [done.stdout]
    for line in broken:
        print(f"docs-site: {line}", file=sys.stderr)
    if not broken:
        print(out / "docs-site" / "index.html")
    return int(bool(broken))


def write_pages(root: Path, out: Path) -> None:
    """Write what Zensical reads into `out`; ValueError where a link or the navigation names what is not there."""
    sources = {source: (root / source).read_text("utf-8") for source in _sources(root)}
    pages = {place_in_site(source): site_text(text, source, root) for source, text in sources.items()}
    api = api_pages()
    pages |= {**api, "commands.md": commands_page()}
    config = (root / _CONFIG).read_text("utf-8").replace('"api/"', _api_navigation(api))
    check_navigation(tomllib.loads(config)["project"]["nav"], set(pages))
    folder = out / "docs-pages"
    shutil.rmtree(folder, ignore_errors=True)
    linked = {target for source, text in sources.items() for target in _targets(text, source, root)}
    for source in {*linked, *_LOADED} - sources.keys():
        _write(folder / place_in_site(source), (root / source).read_bytes())
    for name, text in pages.items():
        _write(folder / name, text.encode())
    _write(out / "zensical.toml", config.encode())


def check_navigation(navigation: list[Any], pages: set[str]) -> None:
    """Raise ValueError where the navigation of the site does not list each page exactly once."""
    listed = list(_leaves(navigation))
    for name in sorted({*listed, *pages}):
        if name not in pages or listed.count(name) != 1:
            times = f"listed {listed.count(name)} times" if name in pages else "no such page"
            raise ValueError(f"{_CONFIG}: nav: {name}: {times}, expected each page once")


def place_in_site(source: str) -> str:
    """Return the place in the site of a file of the repository; other files than pages are text for a browser."""
    if source in _TOP_LEVEL:
        return _TOP_LEVEL[source]
    if source.startswith("docs/") and source.endswith((".md", ".png", ".css", ".js")):
        return source.removeprefix("docs/")
    return f"files/{source}.txt"


def site_text(text: str, source: str, root: Path) -> str:
    """Return the Markdown of a page as the site needs it: links within the site, and a blank line before each list.

    GitHub's Markdown lets a list or a table follow a paragraph, Python-Markdown only a blank line.
    """
    here = dirname(place_in_site(source))
    text = _LINK.sub(lambda link: relpath(place_in_site(_target(link[1], source, root)), here or "."), text)
    lines: list[str] = []
    is_code = False
    for line in text.split("\n"):
        is_code ^= line.startswith("```")
        before = lines[-1] if lines else ""
        begins = (_LIST_ITEM.match(line) and not _LIST_ITEM.match(before.lstrip()) and before[:1] != " ") or (
            line.startswith("|") and not before.startswith("|")
        )
        lines += ["", line] if begins and before and not is_code else [line]
    return "\n".join(lines)


def _sources(root: Path) -> Iterator[str]:
    yield from _TOP_LEVEL
    yield from sorted(path.relative_to(root).as_posix() for path in (root / "docs").rglob("*.md"))


def _targets(text: str, source: str, root: Path) -> Iterator[str]:
    return (_target(link, source, root) for link in _LINK.findall(text))


def _target(link: str, source: str, root: Path) -> str:
    """Return the file of the repository that a link of a page names; of a folder its README."""
    target = normpath(join(dirname(source), link))
    if (root / target).is_dir():
        target = f"{target}/README.md"
    if not (root / target).is_file():
        raise ValueError(f"{source}: link to {link}, expected a file of the repository")
    return target


def _api_navigation(pages: Iterable[str]) -> str:
    """Return the navigation of the API in TOML: a package with subpackages is a section of its own."""
    sections: dict[str, list[str]] = {}
    for page in pages:
        name = page.removeprefix("api/").removesuffix(".md")
        title = "Overview" if name == "index" else name
        sections.setdefault(name.partition(".")[0], []).append(f'{{ "{title}" = "{page}" }}')
    entries = [
        pages_of[0] if len(pages_of) == 1 else f'{{ "{name}" = [{", ".join(pages_of)}] }}'
        for name, pages_of in sections.items()
    ]
    return f"[{', '.join(entries)}]"


def _leaves(navigation: Any) -> Iterator[str]:
    if isinstance(navigation, str):
        yield navigation
        return
    for entry in navigation.values() if isinstance(navigation, dict) else navigation:
        yield from _leaves(entry)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


if __name__ == "__main__":
    raise SystemExit(main())
