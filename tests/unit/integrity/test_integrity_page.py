"""The judge's page names what can be set, and every reason the judge can give."""

import re
import typing

from camber.integrity.settings import IntegritySettings
from camber.runtime.settings import ServiceSettings
from camber.schemas.integrity import Reason
from support.tree import ROOT

PAGE = (ROOT / "docs" / "services" / "integrity.md").read_text("utf-8")
ONLY_IN_POSITIONS = {"pose_provisional", "no_independent_position"}


def test_every_setting_stands_on_the_page():
    specific = IntegritySettings.model_fields.keys() - ServiceSettings.model_fields.keys()
    assert specific
    assert [name for name in specific if f"| `{name}` |" not in PAGE] == []


def test_every_reason_stands_in_the_table_of_verdicts():
    table = PAGE.partition("\n## The verdict\n")[2].partition("\n## ")[0]
    # `…_stale` stands for the reason before it with another ending.
    named = set(re.findall(r"`(\w+)`", table)) | {
        f"antenna_height_{ending}" for ending in re.findall(r"`…_(\w+)`", table)
    }
    assert set(typing.get_args(Reason)) - named == ONLY_IN_POSITIONS
