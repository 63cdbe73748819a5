"""A service's page names all its settings as they are, and every issue that it can raise."""

from __future__ import annotations

import importlib
import re
import typing
from typing import Any

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from camber.gnss.position.rtk_engine import REASON, Warning_
from camber.localizer.settings import GivenPose
from camber.runtime.settings import ServiceSettings
from support.tree import ROOT

PAGES = ("gnss", "antenna_height", "localizer", "integrity", "sensors")


def page_of(service: str) -> str:
    return (ROOT / "docs" / "services" / f"{service}.md").read_text("utf-8")


def rows_of(name: str, settings: type[BaseModel], prefix: str = "") -> list[str]:
    """What must stand in the table of parameters of one setting, or of each one of a table."""
    info = settings.model_fields[name]
    if info.default_factory is not None and issubclass(info.annotation or object, BaseModel):
        table: Any = info.annotation
        return [row for inner in table.model_fields for row in rows_of(inner, table, f"{prefix}{name}.")]
    return [
        f"| `{prefix}{name}` | {shown(info.get_default())} | {limits(info.metadata)} | {info.description} |"
    ]


def shown(default: Any) -> str:
    if default is PydanticUndefined:
        return "must be set"
    if default is None:
        return "unset"
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def limits(metadata: list[Any]) -> str:
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    bounds = ((word, getattr(item, name, None)) for item in metadata for name, word in words.items())
    return " ".join(f"{word} {bound:g}" for word, bound in bounds if bound is not None).replace("-", "−")


@pytest.mark.parametrize("service", PAGES)
def test_the_table_of_parameters_is_that_of_the_settings(service: str) -> None:
    settings = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    own = [name for name in settings.model_fields if name not in ServiceSettings.model_fields]
    expected = ["| setting | default | range | meaning |", "|---|---|---|---|"]
    expected += [row for name in own for row in rows_of(name, settings)]
    parameters = page_of(service).partition("\n## Parameters\n")[2]
    found = [line for line in parameters.splitlines() if line.startswith("|")]
    assert found == expected, "\n".join(["the table should be:", *expected])


@pytest.mark.parametrize("service", PAGES)
def test_every_issue_a_service_can_raise_stands_on_its_page(service: str) -> None:
    page = page_of(service)
    folder = ROOT / "services" / "camber" / service
    source = "".join(path.read_text("utf-8") for path in sorted(folder.rglob("*.py")))
    codes = re.findall(r'\bissue\(\s*"(\w+)"', source)
    if service == "gnss":
        codes += [*typing.get_args(Warning_), "ephemeris_refused"]
    assert codes
    assert [code for code in codes if f"`{code}`" not in page] == []


def test_every_reason_to_refuse_an_epoch_stands_on_the_page_of_gnss() -> None:
    source = (ROOT / "services/camber/gnss/candidates/receiver_candidates.py").read_text("utf-8")
    reasons = set(re.findall(r'"(\w+_epoch\w*|epoch_\w+)"', source))
    assert len(reasons) == 3
    assert [reason for reason in reasons if f"`{reason}`" not in page_of("gnss")] == []


def test_every_reason_why_an_epoch_is_not_fixed_stands_on_the_page_of_gnss() -> None:
    source = (ROOT / "services/camber/gnss/position/rtk_engine.py").read_text("utf-8")
    without_base = set(re.findall(r'return "(\w+)", (?:math\.inf|age_s)', source))
    assert len(without_base) == 4
    reasons = {*REASON.values(), *without_base} - {"resolved"}
    assert [reason for reason in sorted(reasons) if f"`{reason}`" not in page_of("gnss")] == []


@pytest.mark.parametrize("service", PAGES)
def test_a_page_says_what_comes_in_what_goes_out_and_when_it_does_not(service: str) -> None:
    headings = re.findall(r"^## (.*)$", page_of(service), re.M)
    assert headings[:2] == ["Inputs", "Outputs"]
    assert headings[-1] == "Parameters"
    assert len(headings) >= 4


def test_the_given_pose_on_the_localizers_page_is_one() -> None:
    example = page_of("localizer").partition("    [initial_pose]\n")[2].partition("\n\n")[0]
    given = dict(re.findall(r"^    (\w+) = ([\d.]+)", example, re.M))
    assert given.keys() == GivenPose.model_fields.keys()
    GivenPose.model_validate(given)
