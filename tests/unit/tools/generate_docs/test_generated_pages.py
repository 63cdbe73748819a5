"""Generated parts of the pages are written from the code, describe all of it, and are noticed where not current."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from camber.schemas.channels import CHANNELS
from camber.tools.generate_docs.__main__ import DOCS, SECTIONS, main, text_of
from camber.tools.generate_docs.data_flow import page as data_flow
from camber.tools.generate_docs.data_flow import unit_of
from support.messages import message_classes


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    return Path(shutil.copytree(DOCS, tmp_path / "docs"))


def test_the_pages_of_the_repository_are_current() -> None:
    assert main(["--check"]) == 0


@pytest.mark.parametrize("page", ["data-flow.md", "services/gnss.md"])
def test_a_changed_table_is_noticed_and_written_again(
    docs: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = docs / page
    current = path.read_text("utf-8")
    path.write_text(current.replace("| `source` |", "| `sauce` |").replace("camber/v1", "camber/v0"), "utf-8")
    assert main(["--check", "--docs", str(docs)]) == 1
    assert capsys.readouterr().err == f"{path}: not current, run `make docs`\n"
    assert main(["--docs", str(docs)]) == 0
    assert path.read_text("utf-8") == current


@pytest.mark.parametrize("page", sorted({page for page, _ in SECTIONS}))
def test_a_page_without_the_marks_of_its_section_is_refused(docs: Path, page: str) -> None:
    path = docs / page
    path.write_text(path.read_text("utf-8").replace("<!-- generated", "<!-- made"), "utf-8")
    with pytest.raises(ValueError, match="expected a section"):
        text_of(path, docs)


def test_text_around_a_generated_section_stays(docs: Path) -> None:
    path = docs / "services/gnss.md"
    path.write_text("first\n" + path.read_text("utf-8") + "last\n", "utf-8")
    assert text_of(path, docs) == path.read_text("utf-8")


def test_every_channel_has_a_row_with_its_key() -> None:
    rows = [line for line in data_flow().splitlines() if line.startswith("|")]
    for channel in CHANNELS:
        assert sum(f"`{channel.key}`" in row for row in rows) == 1


def test_every_message_is_described_once_with_all_its_fields() -> None:
    text = data_flow()
    for cls in message_classes():
        _, section = text.split(f"### {cls.__name__}\n")
        table = section.split("\n### ")[0]
        for field in cls.model_fields:
            assert table.count(f"| `{field}` |") == 1


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("height_m", "m"),
        ("yaw_rate_rad_s", "rad/s"),
        ("covariance_enu_m2", "m²"),
        ("covariance_enu_m2_s2", "m²/s²"),
        ("velocity_enu_m_s", "m/s"),
        ("time_ns", "ns of GPS time"),
        ("offset_ns", "ns"),
        ("cn0_dbhz", "dB-Hz"),
        ("status", ""),
    ],
)
def test_a_unit_is_what_the_name_ends_in(name: str, unit: str) -> None:
    assert unit_of(name) == unit
