"""A picture of a match shows what is far from the map, and says what the layers gave."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import map_from_vehicle
from camber.localizer.matching.layered_matching import LayeredMatch, LayerMatch
from camber.localizer.matching.match_view import MatchView
from camber.localizer.matching.registration import LayerFit
from camber.tools.localize.match_picture import FULL_SCALE_M, match_figure, residual_colours
from camber.validation.plots import svg_text

START_NS = 1_300_000_000 * 1_000_000_000


def row(low_m: float, high_m: float, outcome: str, mean_distance_m: float) -> LayerMatch:
    distance = {"mean_distance_m": mean_distance_m}
    fit = LayerFit(transform=np.eye(4), converged=True, points=1234, overlap=0.81, **distance)
    values = {"offset": np.zeros(3), "covariance": np.eye(3), "residual": 0.97, "inliers": 0.64} | distance
    return LayerMatch(bounds_m=(low_m, high_m), fit=fit, outcome=outcome, **values)  # type: ignore[arg-type]


def view(status: str = "ambiguous", reason: str = "layers_disagree") -> MatchView:
    rng = np.random.default_rng(3)
    local_m = rng.uniform((-30.0, -30.0, 0.0), (30.0, 30.0, 4.0), (500, 3))
    rows = (row(0.3, 1.0, "used", 0.123), row(1.0, 2.0, "voted_out", math.inf))
    match = LayeredMatch(
        status=status,
        reason=reason,  # type: ignore[arg-type]
        map_from_local=map_from_vehicle(5.0, 7.0, 0.0, 0.0, 0.0, 0.4),
        covariance=np.eye(3),
        layers=rows,
    )
    residual_m = np.where(np.arange(500) % 7 == 0, np.nan, rng.uniform(0.0, 0.5, 500))
    return MatchView(
        time_ns=START_NS + 2_500_000_000,
        match=match,
        frame=LocalFrame(0.6, 2.4, 0.0),
        base_height_m=40.0,
        points_m=local_m,
        heights_m=local_m[:, 2],
        layer=np.where(local_m[:, 2] < 2.0, 0, -1),
        residual_m=residual_m,
        map_m=local_m + 0.3,
        map_heights_m=local_m[:, 2],
    )


def texts(figure: Figure) -> set[str | None]:
    return {element.text for element in ElementTree.fromstring(svg_text(figure)).iter()}


def test_colours_go_from_the_first_to_the_last_and_no_partner_differs() -> None:
    colours = residual_colours(np.array([0.0, FULL_SCALE_M, 10.0 * FULL_SCALE_M, np.nan, 0.5 * FULL_SCALE_M]))
    assert [to_hex(colour) for colour in colours[:3]] == ["#1f6fb2", "#c2185b", "#c2185b"]
    assert colours[4] == pytest.approx(to_rgba("#f2c14e"), abs=0.01)
    assert len({to_hex(colour) for colour in colours}) == 4


def test_a_picture_says_when_how_and_what_each_layer_gave() -> None:
    shown = texts(match_figure("a <drive>", view(), start_ns=START_NS))
    assert {"a <drive>: scan match at 2.5 s", "ambiguous: layers disagree"} <= shown
    assert {"0.3 to 1 m", "1,234", "0.123 m", "81%", "64%", "0.97", "voted out", "–"} <= shown
    assert "converged" in texts(match_figure("a", view("converged", "agreed"), start_ns=START_NS))


def test_points_are_images_in_the_file_so_that_it_stays_small() -> None:
    svg = svg_text(match_figure("a", view(), start_ns=START_NS))
    images = [element for element in ElementTree.fromstring(svg).iter() if element.tag.endswith("image")]
    above, side, colour_bar = (float(image.attrib["width"]) for image in images)
    assert min(above, side) > 2.0 * colour_bar
    assert len(svg) < 300_000


def test_a_match_without_points_has_a_picture() -> None:
    names = ("points_m", "heights_m", "layer", "residual_m", "map_m", "map_heights_m")
    empty = replace(view(), **{name: getattr(view(), name)[:0] for name in names})
    assert "a: scan match at 2.5 s" in texts(match_figure("a", empty, start_ns=START_NS))


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, -2.5])
def test_the_arrow_points_along_the_yaw(yaw_rad: float) -> None:
    drawn = view()
    drawn.match.map_from_local[:3, :3] = map_from_vehicle(0.0, 0.0, 0.0, 0.0, 0.0, yaw_rad)[:3, :3]
    above = match_figure("a", drawn, start_ns=START_NS).axes[0]
    (arrow,) = (text for text in above.texts if not text.get_text())
    assert isinstance(arrow, Annotation)
    along_m = np.subtract(arrow.xy, arrow.xyann)
    assert math.atan2(along_m[1], along_m[0]) == pytest.approx(yaw_rad)
