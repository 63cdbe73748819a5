"""Panels know where their values stand, and draw nothing outside."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from camber.validation.plot_frame import Panel, document, heading, limits, square_panel

PANEL = Panel(100.0, 50.0, (0.0, 10.0), (-1.0, 1.0), "a < b", left=20.0, width=200.0)


def parsed(*parts: str) -> ElementTree.Element:
    return ElementTree.fromstring(document(parts, 300.0))


def paths(root: ElementTree.Element) -> list[ElementTree.Element]:
    return [element for element in root.iter() if element.tag.endswith("path")]


def test_values_stand_between_the_edges() -> None:
    assert PANEL.across(np.array([0.0, 10.0])).tolist() == [20.0, 220.0]
    assert PANEL.down(np.array([-1.0, 1.0])).tolist() == [150.0, 100.0]


def test_all_points_are_inside_a_square_panel_and_both_directions_have_one_scale() -> None:
    points = np.random.default_rng(2).normal(size=(50, 2)) * (3.0, 40.0)
    panel = square_panel(points, 10.0, 300.0, "track", width=700.0)
    low, high = np.array([panel.x[0], panel.y[0]]), np.array([panel.x[1], panel.y[1]])
    assert ((points > low) & (points < high)).all()
    assert (panel.x[1] - panel.x[0]) / 700.0 == pytest.approx((panel.y[1] - panel.y[0]) / 300.0)


def test_nothing_and_one_point_have_a_panel_too() -> None:
    for points in (np.zeros((0, 2)), np.ones((1, 2))):
        panel = square_panel(points, 0.0, 100.0, "")
        assert panel.x[0] < panel.x[1]
        assert parsed(*panel.frame(str, str)) is not None


def test_a_line_ends_at_a_point_that_is_not_known() -> None:
    line = np.array(
        [[0.0, 0.0], [5.0, 0.0], [np.nan, 0.0], [6.0, 0.0], [7.0, 1.0], [8.0, np.nan], [9.0, 0.0]]
    )
    (path,) = paths(parsed(*PANEL.lines([line], "#000")))
    assert path.attrib["d"] == "M20.0 125.0L120.0 125.0M140.0 125.0L160.0 100.0"
    assert path.attrib["clip-path"].startswith("url(#")
    assert list(PANEL.lines([line[2:3], line[6:]], "#000")) == []


def test_dots_outside_the_frame_or_of_another_word_are_left_out() -> None:
    x = np.array([0.0, 5.0, 11.0, 5.0, np.nan])
    words = np.array(["good", "bad", "good", "other", "good"])
    (path,) = paths(parsed(*PANEL.dots(x, np.zeros(5), words, {"good": "#1", "worse": "#2"})))
    assert path.attrib["d"] == "M20 125h0"


def test_text_from_outside_is_text() -> None:
    root = parsed(*heading("<b>&", [("1 <x>", None)]), *PANEL.frame(None, str))
    texts = {element.text for element in root.iter() if element.tag.endswith("text")}
    assert {"<b>&", "1 <x>", "a < b"} <= texts


def test_a_picture_fills_its_frame() -> None:
    (image,) = (e for e in parsed(PANEL.image(b"png")).iter() if e.tag.endswith("image"))
    assert [image.attrib[name] for name in ("x", "y", "width", "height")] == [
        "20.0",
        "100.0",
        "200.0",
        "50.0",
    ]
    assert image.attrib["href"] == "data:image/png;base64,cG5n"


def test_limits_reach_beyond_the_values_and_have_a_least_range() -> None:
    assert limits(np.array([1.0, 3.0]), 0.5) == pytest.approx((0.92, 3.08))
    assert limits(np.array([2.0]), 0.5) == pytest.approx((1.73, 2.27))
