"""report.html: the results of one drive as a self-contained page that fetches nothing.

Tables are made here, charts by the script of the template from the data embedded as JSON. Every untrusted text passes
through `html.escape` or `embedded_json`.
"""

from __future__ import annotations

import html
import json
import math
import re
from importlib.resources import files
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M
from camber.validation.evaluation import Evaluation
from camber.validation.fix_statistics import EPISODE_GAP_S, RIGHT_M
from camber.validation.judged_fixes import JudgedFix
from camber.validation.report.chart_data import chart_data, embedded_json, start_ns_of

_NBSP = "\u00a0"
_NONE = '<span class="absent">–</span>'
_NOT_KNOWN = '<span class="absent">not known</span>'
_JUDGES = {
    "ratio_test_only": "Ratio test only",
    "height_only": "Height only",
    "always_unknown": "Always <i>unknown</i>",
}


def render(evaluation: Evaluation) -> str:
    """The page as text."""
    summary = evaluation.summary
    parts = {
        "title": f"{_text(summary['drive'])} · Camber",
        "drive": _text(summary["drive"]),
        "subtitle": _subtitle(summary),
        "banners": _banners(summary),
        "tiles": _tiles(summary),
        "baselines": _baselines(summary),
        "baselines_note": _BASELINES_NOTE.format(summary["controls"]["height_only"]["tolerance_m"]),
        "error_note": _ERROR_NOTE if summary["truth"] else _NO_TRUTH,
        "stanford_note": _STANFORD_NOTE if summary["truth"] else _NO_TRUTH,
        "stanford": _stanford(summary),
        "reasons": _reasons(summary),
        "coverage": _coverage(summary),
        "localizer": _localizer(summary),
        "episodes_note": _episodes_note(summary),
        "episodes": _episodes(evaluation),
        "definitions": _DEFINITIONS,
        "summary_json": _text(json.dumps(summary, indent=2, ensure_ascii=False)),
        "data": embedded_json(chart_data(evaluation)),
    }
    template = files("camber.validation.report").joinpath("template.html").read_text("utf-8")
    # In one pass, so that untrusted text cannot contain a placeholder.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


_NO_TRUTH = "This drive has no truth: figures that need it are not known."
_ERROR_NOTE = (
    "Distance in 3D from the truth at the antenna, after the constant offset of the drive. "
    "Rings: candidate fixes (ratio test passed). Dots: confirmed positions."
)
_STANFORD_NOTE = (
    "Error of each epoch's position and its protection level. Below the diagonal the error exceeds the level: "
    "misleading information, hazardous where the error exceeds the alert limit too."
)
_BASELINES_NOTE = "<i>Height only</i> uses a fixed tolerance of {:g} m and Camber's elevations."
_DEFINITIONS = f"""<dl>
<dt>candidate fix</dt><dd>a fix that passed the ratio test and has not been judged; <i>tentative</i> in messages</dd>
<dt>wrong, right</dt><dd>more than {WRONG_M} m, up to {RIGHT_M} m from the truth in 3D at the antenna, after
the constant offset; between them neither</dd>
<dt>episode</dt><dd>wrong fixes without a right one between them, at most {EPISODE_GAP_S:g} s apart; missed
where a wrong position was confirmed in it</dd>
<dt>3/n</dt><dd>upper 95 % bound of the rate of missed episodes, with none of n missed</dd>
<dt>ratio test only</dt><dd>every fix that passed the ratio test is confirmed</dd>
<dt>height only</dt><dd>fix height against recorded road elevation + antenna height, one fixed tolerance: no
start-up rule, no uncertainties, no horizontal check, no verification, no learning</dd>
<dt>always <i>unknown</i></dt><dd>nothing is confirmed: trivially safe</dd>
<dt>available</dt><dd>the epoch's 99.9 % horizontal radius is below the alert limit</dd>
</dl>"""


def _subtitle(summary: dict[str, Any]) -> str:
    parts = [f"{summary['epochs']:,} epochs"]
    if summary["duration_s"] is not None:
        minutes, seconds = divmod(round(summary["duration_s"]), 60)
        parts.append(f"{minutes} min {seconds} s")
    if summary["speed_factor"] is not None:
        parts.append(f"replayed at {summary['speed_factor']:.3g} times real time")
    parts.append("with truth" if summary["truth"] else "without truth")
    return " · ".join(parts)


def _banners(summary: dict[str, Any]) -> str:
    banners = (
        ("bad", "Only part of the recording could be read", summary["damage"]),
        ("", "Surrogates: synthesised for this run, not measured", summary["surrogates"]),
        ("", "Notes on this run", summary["notes"]),
    )
    return "".join(
        f'<div class="banner {kind}"><strong>{title}</strong><ul>'
        + "".join(f"<li>{_text(line)}</li>" for line in lines)
        + "</ul></div>"
        for kind, title, lines in banners
        if lines
    )


def _tiles(summary: dict[str, Any]) -> str:
    confirmed, right, episodes = summary["confirmed"], summary["right"], summary["episodes"]
    position, error_m, latency = summary["position"], summary["position"]["error_m"], summary["latency_ms"]
    limit_m = position["alert_limit_m"]
    reference = " and ".join(position["horizontal_reference"]) or "not known"
    fixes = f"{_count(summary['tentative']['wrong'])} of {summary['tentative']['fixed']:,} fixes were wrong"
    without_truth = confirmed["truth_unknown"]
    fixes += f"; {without_truth:,} confirmed where the truth is not known" if without_truth else ""
    limit = f"{limit_m:g}{_NBSP}m" if limit_m else "its alert limit"
    tiles = [
        _tile("Wrong positions confirmed", confirmed["wrong"], confirmed["count"] - without_truth, fixes),
        _tile("Wrong episodes missed", episodes["missed"], episodes["n"], _bound(episodes)),
        _plain_tile("Right fixes kept", _percent(right["kept"]), f"of {_count(right['count'])} right fixes"),
        _plain_tile(
            "Position available",
            _percent(position["availability"]),
            f"of epochs: 99.9 % radius below {limit}",
        ),
        _plain_tile(
            "Position usable",
            _percent(position["usable"]),
            f"of epochs: both protection levels below their limits; horizontal reference {reference}",
        ),
        _plain_tile(
            "Horizontal error, 95 %",
            _metres(error_m["p95"]),
            f"median {_metres(error_m['p50'])}, 99.9 % {_metres(error_m['p999'])}",
        ),
        _plain_tile("Fix to verdict", _milliseconds(latency["p50"]), f"99 % {_milliseconds(latency['p99'])}"),
    ]
    return "".join(tiles)


def _tile(name: str, bad: int | None, of: int | None, more: str) -> str:
    """A tile that is good at zero, bad above, and neutral where nothing could fail."""
    if bad is None:
        return _plain_tile(name, _NOT_KNOWN, "no truth")
    kind = "bad" if bad else "good" if of else ""
    return _plain_tile(name, f"{bad:,} <small>of {_count(of)}</small>", more, kind)


def _plain_tile(name: str, value: str, more: str, kind: str = "") -> str:
    if value == _NOT_KNOWN and _NOT_KNOWN in more:
        more = ""
    return (
        f'<div class="tile {kind}"><div class="name">{name}</div><div class="value">{value}</div>'
        f'<div class="more">{more}</div></div>'
    )


def _bound(episodes: dict[str, Any]) -> str:
    if episodes["n"] is None or episodes["missed"]:
        return "" if episodes["n"] is None else "no bound: some were missed"
    if episodes["bound"] is None:
        return "no wrong episode: no bound"
    cautious = episodes["cautious"]
    return (
        f"rate below {_upper(episodes['bound'])} (3/n); counted with gaps of {cautious['gap_s']:g} s, "
        f"n = {cautious['n']}: below {_upper(cautious['bound'])}"
    )


def _baselines(summary: dict[str, Any]) -> str:
    head = [
        "Judge", "Confirmed", "wrong among them", "Right fixes kept", "right fixes called erroneous",
        "Fixes called erroneous", "Fixes left unknown", "Episodes missed", "3/n",
    ]  # fmt: skip
    judges = {"Camber": summary, **{_JUDGES[name]: value for name, value in summary["controls"].items()}}
    rows = []
    for name, f in judges.items():
        wrong, missed, n = f["confirmed"]["wrong"], f["episodes"]["missed"], f["episodes"]["n"]
        bound = f["episodes"]["bound"]
        cells = [
            f"<td>{name}</td>",
            f"<td>{f['confirmed']['count']:,}</td>",
            f"<td{_flag(wrong)}>{_count(wrong)}</td>",
            f"<td>{_percent(f['right']['kept'])}</td>",
            f"<td>{_count(f['right']['erroneous'])}</td>",
            f"<td>{f['erroneous']['count']:,}</td>",
            f"<td>{f['unknown']['of_fixed']:,}</td>",
            f"<td{_flag(missed)}>{_NOT_KNOWN if n is None else f'{missed} of {n}'}</td>",
            f"<td>{_NONE if bound is None else _upper(bound)}</td>",
        ]
        rows.append(f"<tr{' class=camber' if name == 'Camber' else ''}>{''.join(cells)}</tr>")
    return _table(head, rows)


def _reasons(summary: dict[str, Any]) -> str:
    by_reason = summary["verdicts"]["by_reason"]
    if not by_reason:
        return '<p class="absent">No verdict was recorded.</p>'
    most = by_reason[0]["count"]
    rows = [
        f"<tr><td>{_dot(entry['verdict'])}{_spaced(entry['verdict'])}</td>"
        f'<td class="left">{_spaced(entry["reason"])}</td><td>{entry["count"]:,}</td>'
        f'<td class="left"><span class="bar" style="width:{max(1, round(80 * entry["count"] / most))}px;'
        f'background:{_colour(entry["verdict"])}"></span></td></tr>'
        for entry in by_reason
    ]
    silent = summary["verdicts"]["fixes_without_verdict"]
    if silent:
        rows.append(
            f'<tr><td>{_dot("no_verdict")}no verdict</td><td class="left">none published</td>'
            f"<td>{silent:,}</td><td></td></tr>"
        )
    return _table(["Verdict", "<Reason", "Verdicts", "<"], rows)


def _coverage(summary: dict[str, Any]) -> str:
    if summary["coverage"] is None:
        return f'<p class="absent">{_NO_TRUTH}</p>'
    rows = [
        f"<tr><td>{_spaced(source)}</td><td>{c['epochs']:,}</td>"
        f"<td{_flag(c['inside_99'] is not None and c['inside_99'] < 0.99)}>{_percent(c['inside_99'])}</td>"
        f"<td{_flag(c['inside_999'] is not None and c['inside_999'] < 0.999)}>"
        f"{_percent(c['inside_999'], 2)}</td></tr>"
        for source, c in summary["coverage"].items()
    ]
    return _table(["Source", "Epochs", "99 % ellipse", "99.9 % ellipse"], rows)


def _stanford(summary: dict[str, Any]) -> str:
    if summary["stanford"] is None:
        return ""
    names = {
        "radius_999": "99.9 % radius",
        "hpl": "Horizontal protection level",
        "vpl": "Vertical protection level",
    }
    columns = ("epochs", "nominal", "misleading", "hazardous", "unavailable", "unavailable_misleading")
    rows = []
    for key, name in names.items():
        counts = summary["stanford"][key]
        cells = (
            f"<td{_flag(counts[c] and c in ('misleading', 'hazardous'))}>{counts[c]:,}</td>" for c in columns
        )
        rows.append(f"<tr><td>{name}</td>{''.join(cells)}</tr>")
    head = ["Level", "Epochs", "Nominal", "Misleading", "of these hazardous", "Unavailable"]
    return _table([*head, "Unavailable, misleading"], rows) + _levels(summary)


def _levels(summary: dict[str, Any]) -> str:
    """By source: the regions of HPL and VPL, and their tightness."""
    rows = [
        f"<tr><td>{_spaced(source)}, {name.upper()}</td><td>{c['epochs']:,}</td>"
        f"<td{_flag(c['misleading'])}>{c['misleading']:,}</td><td{_flag(c['hazardous'])}>{c['hazardous']:,}</td>"
        f"<td>{c['unavailable']:,}</td><td>{c['median_level_m']:.2f} m</td><td>{c['median_error_m']:.2f} m</td></tr>"
        for source, levels in summary["levels"].items()
        for name, c in levels.items()
        if c["epochs"]
    ]
    head = ["Source", "Epochs", "Misleading", "of these hazardous", "Unavailable", "Median level"]
    return _table([*head, "Median error"], rows) if rows else ""


def _localizer(summary: dict[str, Any]) -> str:
    localizer = summary["localizer"]
    rows = [
        f'<tr><td class="left">{what}</td><td class="left">{_spaced(name)}</td><td>{count:,}</td>'
        f"<td>{_percent(count / sum(counts.values()))}</td></tr>"
        for what, counts in (("pose", localizer["modes"]), ("scan match", localizer["matches"]))
        for name, count in counts.items()
    ]
    if not rows:
        return '<p class="note">The localizer published nothing.</p>'
    heights = {
        "sensor, by matches": localizer["sensor_height_m"],
        "sensor, by the ground in its sweeps": localizer["ground_height_m"],
        **{f"antenna, by {method}": height for method, height in localizer["antenna_height_m"].items()},
    }
    known = [
        f"{_spaced(name)} {height:.3f}{_NBSP}m" for name, height in heights.items() if height is not None
    ]
    note = f'<p class="note">Median height above the road: {"; ".join(known)}.</p>' if known else ""
    return _table(["<Of what", "<Mode or status", "Count", "Share"], rows) + note


def _episodes_note(summary: dict[str, Any]) -> str:
    if not summary["truth"]:
        return _NO_TRUTH
    cautious = summary["episodes"]["cautious"]
    if cautious is None:
        return "The truth is not known at any fix."
    return (
        f"{summary['episodes']['n']} episodes with gaps of up to {EPISODE_GAP_S:g} s, "
        f"{cautious['n']} with gaps of up to {cautious['gap_s']:g} s: the conservative count of independent "
        "trials. Click on one to show it in the charts."
    )


def _episodes(evaluation: Evaluation) -> str:
    if not evaluation.episodes:
        return ""
    start_ns = start_ns_of(evaluation)
    rows = []
    for number, episode in enumerate(evaluation.episodes, 1):
        at = evaluation.fix_rows[list(episode.fixes)]
        enu_m = evaluation.tentative_error_enu_m[at]
        begin_s, end_s = (episode.start_ns - start_ns) / 1e9, (episode.end_ns - start_ns) / 1e9
        size = [np.linalg.norm(enu_m, axis=1), np.hypot(enu_m[:, 0], enu_m[:, 1]), np.abs(enu_m[:, 2])]
        cells = [
            f"<td>{number}</td>",
            f"<td>{_clock(begin_s)}</td>",
            f"<td>{end_s - begin_s:.1f} s</td>",
            f"<td>{len(at)}</td>",
            *(f"<td>{_metres(max(values.tolist(), default=None))}</td>" for values in size),
            f'<td class="left">{_verdict_counts([evaluation.rows[i] for i in at.tolist()])}</td>',
            '<td class="left bad">missed</td>' if episode.missed else '<td class="left">caught</td>',
        ]
        rows.append(
            f'<tr class="go" tabindex="0" data-start="{begin_s:.3f}" data-end="{end_s:.3f}">'
            f"{''.join(cells)}</tr>"
        )
    head = ["Episode", "Start", "Length", "Fixes", "Largest 3D", "horizontal", "vertical", "<Verdicts"]
    return _table([*head, "<Outcome"], rows)


def _verdict_counts(rows: list[JudgedFix]) -> str:
    counts: dict[str, int] = {}
    for row in rows:
        counts[row.verdict_name] = counts.get(row.verdict_name, 0) + 1
    return ", ".join(f"{_dot(name)}{count} {_spaced(name)}" for name, count in counts.items()) or "–"


def _table(head: list[str], rows: list[str]) -> str:
    """A table; a heading that begins with < is aligned to the left."""
    cells = "".join(f'<th class="left">{h[1:]}</th>' if h.startswith("<") else f"<th>{h}</th>" for h in head)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _text(value: str) -> str:
    return html.escape(value, quote=True)


def _spaced(name: str) -> str:
    return _text(name.replace("_", " "))


def _flag(bad: object) -> str:
    return ' class="bad"' if bad else ""


def _count(value: int | None) -> str:
    return _NOT_KNOWN if value is None else f"{value:,}"


def _percent(share: float | None, decimals: int = 1) -> str:
    """A share in percent; only 1 is written as 100 %."""
    if share is None:
        return _NOT_KNOWN
    step = 10.0**-decimals
    return f"{100 * share if share == 1.0 else min(100 * share, 100 - step):.{decimals}f}{_NBSP}%"


def _upper(bound: float) -> str:
    """A bound in whole percent, rounded up so that it still holds."""
    return f"{math.ceil(100 * bound - 1e-9)}{_NBSP}%"


def _metres(value: float | None) -> str:
    return _NOT_KNOWN if value is None else f"{value:.2f}{_NBSP}m"


def _milliseconds(value: float | None) -> str:
    return _NOT_KNOWN if value is None else f"{value:.3g}{_NBSP}ms"


def _clock(time_s: float) -> str:
    minutes, seconds = divmod(time_s, 60)
    return f"{int(minutes):02d}:{seconds:04.1f}"


def _colour(verdict: str) -> str:
    names = {"confirmed_after_verification": "verified", "no_verdict": "silent"}
    return f"var(--{names.get(verdict, verdict)})"


def _dot(verdict: str) -> str:
    return f'<span class="dot" style="background:{_colour(verdict)}"></span>'
