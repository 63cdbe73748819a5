"""The shared look of figures: scales, classes, keys, and files that are the same for the same data."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from camber import cli
from camber.replay.short_drive import write_short_drive
from camber.validation.plots import (
    draw_dots,
    draw_key,
    draw_scale_and_north,
    equal_limits,
    plot_style,
    range_limits,
    svg_text,
    track_and_strips,
    use_log_scale,
)


def track() -> tuple[Figure, np.ndarray]:
    with plot_style():
        figure, axes, _ = track_and_strips("a <b> & $c$", 2)
        points = np.random.default_rng(2).normal(size=(50, 2)) * (3.0, 40.0)
        equal_limits(axes, points)
        draw_dots(axes, points[:, 0], points[:, 1], classes=np.full(50, "good"), colours={"good": "#112233"})
        draw_key(axes, {"scan_match": "#112233"})
    return figure, points


def test_all_points_are_inside_and_both_axes_have_one_scale() -> None:
    figure, points = track()
    axes = figure.axes[0]
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    assert ((points > low) & (points < high)).all()
    box = axes.get_window_extent()
    assert (high - low)[0] / box.width == pytest.approx((high - low)[1] / box.height)


@pytest.mark.parametrize(
    ("width_m", "length_m", "text"), [(9.0, 1.0, "1 m"), (2600.0, 500.0, "500 m"), (13e3, 2e3, "2 km")]
)
def test_a_map_has_a_bar_of_a_round_length_and_the_north(width_m: float, length_m: float, text: str) -> None:
    with plot_style():
        _, axes, _ = track_and_strips("", 1)
        axes.set(xlim=(100.0, 100.0 + width_m), ylim=(0.0, 1.0))
        draw_scale_and_north(axes)
    (bar,) = axes.lines
    assert np.ptp(bar.get_xdata()) * width_m == pytest.approx(length_m)
    assert [drawn.get_text() for drawn in axes.texts] == [text, "N"]
    assert axes.get_xlim() == (100.0, 100.0 + width_m)


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.ones((1, 2)), np.array([[np.nan, 1.0]])])
def test_limits_are_a_range_without_points_and_with_one(points: np.ndarray) -> None:
    with plot_style():
        _, axes, _ = track_and_strips("", 1)
        equal_limits(axes, points)
    assert axes.get_xlim()[0] < axes.get_xlim()[1]


def test_range_limits_have_a_margin_and_a_least_range() -> None:
    assert range_limits(np.array([1.0, 3.0]), 0.5) == pytest.approx((0.92, 3.08))
    assert range_limits(np.array([2.0]), 0.5) == pytest.approx((1.73, 2.27))
    assert range_limits(np.zeros(0), 0.5) == (0.0, 1.0)


def test_dots_are_drawn_by_class_and_unknown_points_left_out() -> None:
    axes = track()[0].axes[1]
    x = np.array([0.0, 5.0, 11.0, 5.0, np.nan])
    classes = np.array(["good", "bad", "good", "other", "good"])
    draw_dots(axes, x, np.zeros(5), classes=classes, colours={"good": "#111111", "absent": "#222222"})
    (line,) = axes.lines
    assert line.get_xdata().tolist() == [0.0, 11.0]  # type: ignore[union-attr]


def test_svg_keeps_text_as_text_and_is_the_same_each_time() -> None:
    svg = svg_text(track()[0])
    texts = {element.text for element in ElementTree.fromstring(svg).iter()}
    assert {"a <b> & $c$", "scan match"} <= texts
    assert svg_text(track()[0]) == svg


def test_logarithmic_axes_have_plain_numbers() -> None:
    figure, axes, _ = track_and_strips("", 1)
    use_log_scale(axes.yaxis, 0.001, 100.0)
    figure.canvas.draw()
    assert {"0.001", "1", "100"} <= {label.get_text() for label in axes.get_yticklabels()}


def test_commands_start_without_matplotlib() -> None:
    code = (
        "import sys\nimport camber.tools.localize.command, camber.tools.gnss.solve, camber.tools.maps.picture\n"
        "import camber.validation.lab.command\nassert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_where_matplotlib_is_missing_one_line_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    manifest = write_short_drive(tmp_path / "drive")
    assert cli.main(["localize", str(manifest), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err == "camber localize: matplotlib is not installed; it comes with camber[plots]\n"
