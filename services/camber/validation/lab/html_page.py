"""lab.html: the lab's tables and its charts as one self-contained page that fetches nothing."""

from __future__ import annotations

import math
from typing import Any

from camber.validation.lab.error_model import HEADLINE, scene_of
from camber.validation.lab.misleading_information import ALERT_LIMIT_M
from camber.validation.lab.page import page as markdown_page
from camber.validation.markdown import sections_as_html
from camber.validation.report.bundle import HERE, filled
from camber.validation.report.bundle import page as html_page

_ENOUGH_TRIALS = 30_000
"""The requirement is at most 1e-4 missed episodes; by the rule of three, 3/n, fewer cannot show that."""


def lab_html(figures: dict[str, Any]) -> str:
    """The page as text."""
    trials = figures["trials"]
    few = f"{trials:,} episodes of each kind cannot show a rate of 1e-4: {_ENOUGH_TRIALS:,} are needed (3/n)."
    parts = {
        "subtitle": f"seed {figures['seed']}, {trials:,} episodes of each kind in each headline scene",
        "banner": f'<div class="banner">{few}</div>' if trials < _ENOUGH_TRIALS else "",
        "sections": sections_as_html(markdown_page(figures)),
    }
    content = filled((HERE / "lab.html").read_text("utf-8"), parts)
    return html_page("Camber lab", content, script="lab.js", facts=_chart_facts(figures))


def _chart_facts(figures: dict[str, Any]) -> dict[str, Any]:
    levels = figures["levels"]
    return {
        "scenes": [_scene(rows) for rows in figures["missed"] if scene_of(rows) in HEADLINE],
        "alert_limit_m": ALERT_LIMIT_M,
        "risk": levels["risk"],
        "edges_m": levels["chart_edges_m"],
        "modes": [
            {
                "name": name,
                "draws": counts["draws"],
                "inside_999": counts["inside_999"],
                "beyond": counts["beyond_level"],
                "counts": counts["chart"],
                "circle": counts["circle"],
            }
            for name, counts in levels["modes"].items()
        ],
    }


def _scene(rows: dict[str, Any]) -> dict[str, Any]:
    """Episodes and those confirmed at any epoch by size of error, for one kind of wrong fix and one scene."""
    bins = rows["curve"]
    return {
        "title": f"{rows['kind']}, LiDAR σ {rows['pose_sigma_m']:.2f} m",
        "size_m": [math.sqrt(row["from_m"] * (row["to_m"] or 2.0 * row["from_m"])) for row in bins],
        "range": [
            f"{row['from_m']:g}–{row['to_m']:g} m" if row["to_m"] else f"over {row['from_m']:g} m"
            for row in bins
        ],
        "episodes": [row["episodes"] for row in bins],
        "confirmed": {name: [row["confirmed"][name] for row in bins] for name in bins[0]["confirmed"]},
    }
