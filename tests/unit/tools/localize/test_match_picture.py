"""A picture of a match shows what is far from the map, and says what the layers gave."""

from __future__ import annotations

import base64
import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import map_from_vehicle
from camber.localizer.matching.layered_matching import LayeredMatch, LayerMatch
from camber.localizer.matching.match_view import MatchView
from camber.localizer.matching.registration import LayerFit
from camber.tools.localize.match_picture import FULL_M, picture, residual_colours

START_NS = 1_300_000_000 * 1_000_000_000


def row(low_m: float, high_m: float, outcome: str, mean_distance_m: float) -> LayerMatch:
    fit = LayerFit(np.eye(4), True, 5, 1234, 1000, mean_distance_m, 0.81)
    return LayerMatch((low_m, high_m), fit, np.zeros(3), np.eye(3), 0.97, 0.64, outcome)  # type: ignore[arg-type]


def view(status: str = "ambiguous", reason: str = "layers_disagree") -> MatchView:
    rng = np.random.default_rng(3)
    local_m = rng.uniform((-30.0, -30.0, 0.0), (30.0, 30.0, 4.0), (500, 3))
    rows = (row(0.3, 1.0, "used", 0.123), row(1.0, 2.0, "voted_out", math.inf))
    match = LayeredMatch(
        status, reason, map_from_vehicle(5.0, 7.0, 0.0, 0.0, 0.0, 0.4), np.eye(3), rows  # type: ignore[arg-type]
    )  # fmt: skip
    residual_m = np.where(np.arange(500) % 7 == 0, np.nan, rng.uniform(0.0, 0.5, 500))
    return MatchView(
        START_NS + 2_500_000_000, match, LocalFrame(0.6, 2.4, 0.0), 40.0, local_m, local_m[:, 2],
        np.where(local_m[:, 2] < 2.0, 0, -1), residual_m, local_m + 0.3, local_m[:, 2],
    )  # fmt: skip


def parsed(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(text)


def texts(root: ElementTree.Element) -> set[str | None]:
    return {element.text for element in root.iter()}


def test_colours_go_from_the_first_to_the_last_and_no_partner_has_its_own() -> None:
    colours = residual_colours(np.array([0.0, FULL_M, 10.0 * FULL_M, np.nan, 0.5 * FULL_M]))
    assert colours[0].tolist() == [0x1F, 0x6F, 0xB2]
    assert colours[1].tolist() == colours[2].tolist() == [0xC2, 0x18, 0x5B]
    assert colours[4].tolist() == [0xF2, 0xC1, 0x4E]
    assert len({tuple(colour) for colour in colours.tolist()}) == 4


def test_a_picture_says_when_how_and_what_each_layer_gave() -> None:
    said = texts(parsed(picture("a <drive>", view(), START_NS)))
    assert {"a <drive>: scan match at 2.5 s", "ambiguous: layers disagree"} <= said
    assert {"0.3 to 1 m", "1,234", "0.123 m", "81%", "64%", "0.97", "voted out", "–"} <= said
    assert "converged" in texts(parsed(picture("a", view("converged", "agreed"), START_NS)))


def test_its_points_are_two_pictures_and_not_a_circle_each() -> None:
    text = picture("a", view(), START_NS)
    images = [element for element in parsed(text).iter() if element.tag.endswith("image")]
    assert len(images) == 2
    for image in images:
        data = image.attrib["href"].removeprefix("data:image/png;base64,")
        assert base64.b64decode(data, validate=True)[:8] == b"\x89PNG\r\n\x1a\n"
    assert sum(element.tag.endswith("circle") for element in parsed(text).iter()) == 1  # of the status
    assert len(text) < 300_000


def test_a_match_without_points_has_a_picture() -> None:
    full = view()
    empty = MatchView(
        full.time_ns, full.match, full.frame, 40.0, np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64),
        np.zeros(0), np.zeros((0, 3)), np.zeros(0),
    )  # fmt: skip
    assert parsed(picture("a", empty, START_NS)) is not None


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, -2.5])
def test_the_arrow_points_along_the_yaw(yaw_rad: float) -> None:
    seen = view()
    seen.match.map_from_local[:3, :3] = map_from_vehicle(0.0, 0.0, 0.0, 0.0, 0.0, yaw_rad)[:3, :3]
    (arrow,) = (
        e for e in parsed(picture("a", seen, START_NS)).iter() if "rotate" in e.attrib.get("transform", "")
    )
    turned_deg = float(arrow.attrib["transform"].split("rotate(")[1].rstrip(")"))
    assert turned_deg == pytest.approx(-math.degrees(yaw_rad), abs=0.01)  # the page's y points down
