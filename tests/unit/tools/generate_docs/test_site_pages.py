"""Pages of the site: links stay links, nothing is left out of the navigation, and a broken link is a failure."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.cli import SERVICES, TOOLS
from camber.tools.generate_docs.api_pages import PACKAGES, api_pages
from camber.tools.generate_docs.built_links import broken_links
from camber.tools.generate_docs.command_pages import commands_page, help_of
from camber.tools.generate_docs.site import check_navigation, main, site_text
from support.tree import ROOT


@pytest.fixture(scope="module")
def api() -> dict[str, str]:
    return api_pages()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with two pages, a folder of pages and a source file."""
    for name in (
        "README.md",
        "docs/drive.md",
        "docs/services/gnss.md",
        "docs/safety/README.md",
        "examples/a.py",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return tmp_path


@pytest.mark.parametrize(
    ("source", "link", "rewritten"),
    [
        ("README.md", "docs/drive.md#keys", "drive.md#keys"),
        ("README.md", "docs/safety", "safety/README.md"),
        ("README.md", "examples/a.py", "files/examples/a.py.txt"),
        ("docs/services/gnss.md", "../drive.md", "../drive.md"),
        ("docs/services/gnss.md", "../../README.md", "../index.md"),
        ("docs/drive.md", "#keys", "#keys"),
        ("docs/drive.md", "https://example.org/docs", "https://example.org/docs"),
    ],
)
def test_a_link_leads_to_the_same_file_in_the_site(
    repository: Path, source: str, link: str, rewritten: str
) -> None:
    assert site_text(f"see [it]({link})", source, repository) == f"see [it]({rewritten})"


def test_a_link_to_a_file_that_is_not_there_is_refused(repository: Path) -> None:
    with pytest.raises(ValueError, match=r"docs/drive.md: link to ../LICENSE, expected a file"):
        site_text("[licence](../LICENSE)", "docs/drive.md", repository)


def test_a_list_and_a_table_after_a_paragraph_begin_after_a_blank_line(repository: Path) -> None:
    page = "Text:\n- one\n- two\n\n```\nText:\n- one\n```\nText:\n| a |\n|---|"
    expected = "Text:\n\n- one\n- two\n\n```\nText:\n- one\n```\nText:\n\n| a |\n|---|"
    assert site_text(page, "docs/drive.md", repository) == expected


@pytest.mark.parametrize(
    ("navigation", "problem"),
    [
        ([{"Start": ["index.md"]}], "drive.md: listed 0 times"),
        ([{"Start": ["index.md", "drive.md", {"More": "drive.md"}]}], "drive.md: listed 2 times"),
        (["index.md", "drive.md", "gone.md"], "gone.md: no such page"),
    ],
)
def test_a_page_that_the_navigation_does_not_list_once_is_refused(
    navigation: list[object], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        check_navigation(navigation, {"index.md", "drive.md"})


def test_every_package_has_a_page_without_what_wires_services(api: dict[str, str]) -> None:
    assert {f"api/{package}.md" for package in PACKAGES} <= api.keys()
    assert not [
        name for name, text in api.items() for module in ("service", "settings") if f"\n## {module}\n" in text
    ]


def test_a_function_is_shown_with_its_signature_and_docstring(api: dict[str, str]) -> None:
    _, section = api["api/geodesy.md"].split("\n### wrap_pi\n")
    assert section.startswith(
        "\n```python\nwrap_pi(angle_rad: float) -> float\n```\n\nThe same direction in (−π, π]."
    )


def test_a_long_signature_has_a_line_for_each_parameter(api: dict[str, str]) -> None:
    _, section = api["api/localizer.matching.md"].split("\n### register\n")
    lines = section.partition("```\n\n")[0].split("\n")[2:-1]
    assert lines[0] == "register("
    assert lines[1:6:2] == ["    target: LayerTarget,", "    guess: Floats,", "    method: CloudMethod,"]
    assert lines[4] == "    *,"
    assert lines[-2:] == ["    max_iterations: int = 30,", ") -> LayerFit"]


def test_fields_have_type_default_and_meaning_where_one_has_it(api: dict[str, str]) -> None:
    matching, protection = api["api/localizer.matching.md"], api["api/integrity.protection.md"]
    assert (
        "| field | type | meaning |\n|---|---|---|\n| `points_m` | `Floats` | (n, 3) in the frame" in matching
    )
    assert "| field | type | default |\n|---|---|---|\n| `levels` |" in protection


def test_a_message_leads_to_its_fields_and_units(api: dict[str, str]) -> None:
    assert "[Fields and units](../data-flow.md#fix)" in api["api/schemas.md"]


def test_every_command_is_on_the_page_of_the_command_line() -> None:
    page = commands_page()
    names = {*SERVICES, *TOOLS, "gnss solve", "map build geotiff", "certs make", "access cloud"}
    assert [
        name for name in sorted(names) if f" camber {name}\n\n```text\nusage: camber {name} " not in page
    ] == []


def test_a_command_that_is_not_there_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match=r"camber map bild --help: exit code 2"):
        help_of(("map", "bild"))


@pytest.mark.parametrize(
    ("html", "problem"),
    [
        ('<a href="other.html">', None),
        ('<a href="other.html#there">', None),
        ('<a href="#here"><h2 id="here">', None),
        ('<a href="https://example.org">', None),
        ('<img src="data:image/png;base64,AA==">', None),
        ('<a href="gone.html">', "link to gone.html, expected a file of the site"),
        ('<a href="other.html#gone">', "link to other.html#gone, expected an anchor of that page"),
        ('<a href="#gone">', "link to #gone, expected an anchor of that page"),
        ('<img src="gone.png">', "link to gone.png, expected a file of the site"),
        (
            '<script src="https://example.org/a.js">',
            "loads https://example.org/a.js, expected a file of the site",
        ),
        ('<link href="//example.org/a.css">', "loads //example.org/a.css, expected a file of the site"),
    ],
)
def test_a_link_that_leads_nowhere_or_loads_from_elsewhere_is_reported(
    tmp_path: Path, html: str, problem: str | None
) -> None:
    (tmp_path / "index.html").write_text(html)
    (tmp_path / "other.html").write_text('<h2 id="there">')
    assert broken_links(tmp_path) == ([] if problem is None else [f"index.html: {problem}"])


def test_a_page_with_a_broken_anchor_fails_the_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole way, with the real generator and few pages."""
    monkeypatch.setattr("camber.tools.generate_docs.site.write_pages", _write_two_pages)
    assert main(["--out", str(tmp_path)]) == 1
    assert "index.html: link to other.html#gone, expected an anchor" in capsys.readouterr().err


def _write_two_pages(_root: Path, out: Path) -> None:
    pages = out / "docs-pages"
    pages.mkdir()
    (pages / "index.md").write_text("# One\n\n[there](other.md#there) and [nowhere](other.md#gone)\n")
    (pages / "other.md").write_text("# Other\n\n## There\n")
    config = (ROOT / "docs/site/zensical.toml").read_text("utf-8")
    before, _, rest = config.partition("nav = [")
    (out / "zensical.toml").write_text(
        before.replace('"site/site.css"', "")
        + rest.partition("\n]\n")[2].replace('"site/iframe-worker.js"', "")
    )
