"""A service's page has its parts, and the page of gnss names every reason; issues are in the run-book."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from camber.gnss.observations.differential_age import BaseProblem
from camber.gnss.position.rtk_engine import REASON
from camber.localizer.given_pose import GivenPose
from support.tree import ROOT

PAGES = ("gnss", "antenna_height", "localizer", "integrity", "sensors")


def page_of(service: str) -> str:
    return (ROOT / "docs" / "services" / f"{service}.md").read_text("utf-8")


def test_every_reason_why_an_epoch_is_not_fixed_stands_on_the_page_of_gnss() -> None:
    reasons = {*REASON.values(), *get_args(BaseProblem)} - {"resolved"}
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
