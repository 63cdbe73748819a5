"""report.html: the results of one drive as a self-contained page that fetches nothing.

Headlines and tables are made here; map and charts are components of the live page on rows embedded in the page. Every
untrusted text passes through `html.escape` or `embedded_json`.
"""

from __future__ import annotations

import html
import json
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.validation.evaluation import Evaluation
from camber.validation.fix_statistics import CAUTIOUS_GAP_S, EPISODE_GAP_S, RIGHT_M
from camber.validation.judged_fixes import JudgedFix
from camber.validation.report.bundle import HERE, filled, page
from camber.validation.report.chart_data import ChartData
from camber.validation.report.headlines import (
    LEAST_TRIALS,
    NBSP,
    NOT_KNOWN,
    Headline,
    count_headline,
    interval_text,
    metres,
    percent,
    pieces_of,
    quantile_headline,
    rate_claim,
    share_headline,
)
from camber.validation.statistics import rate_interval

_NOT_KNOWN = f'<span class="absent">{NOT_KNOWN}</span>'
_JUDGES = {
    "ratio_test_only": "Ratio test only",
    "height_only": "Height only",
    "always_unknown": "Always <i>unknown</i>",
}


def render(evaluation: Evaluation, charts: ChartData) -> str:
    """The page as text."""
    summary = evaluation.summary
    parts = {
        "drive": _text(summary["drive"]),
        "subtitle": _subtitle(summary),
        "banners": _banners(summary),
        "tiles": "".join(map(_tile, headlines(evaluation))),
        "tiles_note": _TILES_NOTE,
        "left_out": charts.left_out,
        "baselines": _baselines(summary),
        "baselines_note": _BASELINES_NOTE.format(summary["controls"]["height_only"]["tolerance_m"]),
        "stanford_note": _STANFORD_NOTE if summary["truth"] else _NO_TRUTH,
        "stanford": _stanford(summary),
        "reasons": _reasons(summary),
        "coverage": _coverage(evaluation),
        "localizer": _localizer(summary),
        "episodes_note": _episodes_note(summary),
        "episodes": _episodes(evaluation),
        "definitions": _DEFINITIONS,
        "summary_json": _text(json.dumps(summary, indent=2, ensure_ascii=False)),
    }
    content = filled((HERE / "report.html").read_text("utf-8"), parts)
    title = f"{_text(summary['drive'])} · Camber"
    return page(title, content, script="report.js", facts=charts.facts, rows=charts.rows)


_NO_TRUTH = "This drive has no truth: figures that need it are not known."
_TILES_NOTE = (
    f"A rate has its 95{NBSP}% interval and n, the number of independent trials; below n = {LEAST_TRIALS} counts stand "
    "without a rate."
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
<dt>n</dt><dd>independent trials: episodes counted with gaps of up to {CAUTIOUS_GAP_S:g} s; of epochs, the pieces of
{CAUTIOUS_GAP_S:g} s that contain any</dd>
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


def headlines(evaluation: Evaluation) -> list[Headline]:
    """The tiles, in their order."""
    summary, positions, fixes = evaluation.summary, evaluation.positions, evaluation.fixes
    confirmed, episodes, position = summary["confirmed"], summary["episodes"], summary["position"]
    cautious, epochs_ns = (
        episodes["cautious"] or {"n": None, "missed": None, "gap_s": 0.0},
        evaluation.epochs_ns,
    )
    unknown, wrong, limit_m = (
        confirmed["truth_unknown"],
        summary["tentative"]["wrong"],
        position["alert_limit_m"],
    )
    fixed = f"{NOT_KNOWN if wrong is None else f'{wrong:,}'} of {summary['tentative']['fixed']:,} fixes were wrong"
    fixed += f"; {unknown:,} confirmed where the truth is not known" if unknown else ""
    claim = rate_claim(cautious["missed"], cautious["n"], f"episodes {cautious['gap_s']:g} s apart")
    limit = f"{limit_m:g}{NBSP}m" if limit_m else "its alert limit"
    reference = " and ".join(position["horizontal_reference"]) or NOT_KNOWN
    usable = f"epochs: both protection levels below their limits; horizontal reference {reference}"
    return [
        count_headline(
            "Wrong positions confirmed",
            confirmed["wrong"],
            confirmed["count"] - unknown,
            more=fixed,
            trials=cautious["n"],
        ),
        count_headline(
            "Wrong episodes missed", episodes["missed"], episodes["n"], more=claim, trials=cautious["n"]
        ),
        share_headline(
            "Right fixes kept", summary["right"]["kept"], fixes.time_ns[fixes.right], "right fixes"
        ),
        share_headline(
            "Position available",
            position["availability"],
            epochs_ns,
            f"epochs: 99.9{NBSP}% radius below {limit}",
        ),
        share_headline("Position usable", position["usable"], epochs_ns, usable),
        quantile_headline("Horizontal error", positions.horizontal_error_m, positions.time_ns),
        _latency(summary),
    ]


def _latency(summary: dict[str, Any]) -> Headline:
    """Of the machine that ran the drive; a quantile of 99 % rests on at least 300 verdicts, by the rule of three."""
    latency, count = summary["latency_ms"], summary["verdicts"]["count"]
    most = f"99{NBSP}%: {_milliseconds(latency['p99'])}, " if count >= 300 else ""
    more = f"{most}n = {count:,} verdicts on the machine that ran this"
    return Headline(name="Fix to verdict, median", value=_milliseconds(latency["p50"]), more=more)


def _tile(headline: Headline) -> str:
    return (
        f'<div class="tile {headline.kind}"><div class="name">{_text(headline.name)}</div>'
        f'<div class="value">{_text(headline.value)}</div><div class="more">{_text(headline.more)}</div></div>'
    )


def _baselines(summary: dict[str, Any]) -> str:
    head = [
        "Judge", "Confirmed", "wrong among them", "Right fixes kept", "right fixes called erroneous",
        "Fixes called erroneous", "Fixes left unknown", "Episodes missed", "<Rate of missed episodes",
    ]  # fmt: skip
    judges = {"Camber": summary, **{_JUDGES[name]: value for name, value in summary["controls"].items()}}
    rows = []
    for name, f in judges.items():
        wrong, missed, n = f["confirmed"]["wrong"], f["episodes"]["missed"], f["episodes"]["n"]
        cautious = f["episodes"]["cautious"] or {"n": None, "missed": None}
        cells = [
            f"<td>{name}</td>",
            f"<td>{f['confirmed']['count']:,}</td>",
            f"<td{_flag(wrong)}>{_count(wrong)}</td>",
            f"<td>{_kept(f['right'])}</td>",
            f"<td>{_count(f['right']['erroneous'])}</td>",
            f"<td>{f['erroneous']['count']:,}</td>",
            f"<td>{f['unknown']['of_fixed']:,}</td>",
            f"<td{_flag(missed)}>{_NOT_KNOWN if n is None else f'{missed} of {n}' if n else 'none'}</td>",
            f'<td class="left">{rate_claim(cautious["missed"], cautious["n"], "episodes") if n else "–"}</td>',
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


def _kept(right: dict[str, Any]) -> str:
    if right["kept"] is None:
        return _NOT_KNOWN
    return f"{round(right['kept'] * right['count']):,} of {right['count']:,}"


def _coverage(evaluation: Evaluation) -> str:
    coverage, positions = evaluation.summary["coverage"], evaluation.positions
    if coverage is None:
        return f'<p class="absent">{_NO_TRUTH}</p>'
    known, rows = np.isfinite(positions.square_in_ellipse()), []
    for source, c in coverage.items():
        pieces = pieces_of(positions.time_ns[known & ((positions.source == source) | (source == "all"))])
        inside = _inside(c["inside_99"], 0.99, pieces) + _inside(c["inside_999"], 0.999, pieces)
        rows.append(f"<tr><td>{_spaced(source)}</td><td>{c['epochs']:,}</td><td>{pieces}</td>{inside}</tr>")
    return _table(["Source", "Epochs", "n", f"99{NBSP}% ellipse", f"99.9{NBSP}% ellipse"], rows)


def _inside(share: float | None, target: float, pieces: int) -> str:
    """The share inside an ellipse with its interval; marked where even the interval is below the target."""
    if share is None:
        return f"<td>{_NOT_KNOWN}</td>"
    if pieces < LEAST_TRIALS:
        return f"<td>{percent(share, 2)}, n too small</td>"
    bad = rate_interval(share * pieces, pieces)[1] < target
    return f"<td{_flag(bad)}>{percent(share, 2)} ({interval_text(share * pieces, pieces)})</td>"


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
        f"<td>{percent(count / sum(counts.values()))}</td></tr>"
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
    known = [f"{_spaced(name)} {height:.3f}{NBSP}m" for name, height in heights.items() if height is not None]
    note = f'<p class="note">Median height above the road: {"; ".join(known)}.</p>' if known else ""
    return _table(["<Of what", "<Mode or status", "Count", "Share"], rows) + note


def _episodes_note(summary: dict[str, Any]) -> str:
    if not summary["truth"]:
        return _NO_TRUTH
    cautious = summary["episodes"]["cautious"]
    if cautious is None:
        return "The truth is not known at any fix."
    if not summary["episodes"]["n"]:
        return "No fix was wrong."
    return (
        f"{summary['episodes']['n']} with gaps of up to {EPISODE_GAP_S:g} s; {cautious['n']} with gaps of up to "
        f"{cautious['gap_s']:g} s, the conservative count of independent trials. A click shows one in map and charts."
    )


def _episodes(evaluation: Evaluation) -> str:
    if not evaluation.episodes:
        return ""
    rows = []
    for number, episode in enumerate(evaluation.episodes, 1):
        at = evaluation.fix_rows[list(episode.fixes)]
        enu_m = evaluation.tentative_error_enu_m[at]
        begin_s, end_s = (unix_ns_from_gps_ns(at_ns) / 1e9 for at_ns in (episode.start_ns, episode.end_ns))
        size = [np.linalg.norm(enu_m, axis=1), np.hypot(enu_m[:, 0], enu_m[:, 1]), np.abs(enu_m[:, 2])]
        cells = [
            f"<td>{number}</td>",
            f"<td>{_clock(begin_s)}</td>",
            f"<td>{end_s - begin_s:.1f} s</td>",
            f"<td>{len(at)}</td>",
            *(f"<td>{_text(metres(max(values.tolist(), default=None)))}</td>" for values in size),
            f'<td class="left">{_verdict_counts([evaluation.rows[i] for i in at.tolist()])}</td>',
            '<td class="left bad">missed</td>' if episode.missed else '<td class="left">caught</td>',
        ]
        rows.append(
            f'<tr class="go" tabindex="0" data-begin="{begin_s:.3f}" data-end="{end_s:.3f}">'
            f"{''.join(cells)}</tr>"
        )
    head = ["Episode", "Start, UTC", "Length", "Fixes", "Largest 3D", "horizontal", "vertical", "<Verdicts"]
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


def _milliseconds(value: float | None) -> str:
    return _NOT_KNOWN if value is None else f"{value:.3g}{NBSP}ms"


def _clock(unix_s: float) -> str:
    """Time of day, UTC."""
    minutes, seconds = divmod(unix_s % 86_400.0, 60.0)
    return f"{int(minutes) // 60:02d}:{int(minutes) % 60:02d}:{seconds:04.1f}"


def _colour(verdict: str) -> str:
    names = {"confirmed_after_verification": "verified", "no_verdict": "faint"}
    return f"var(--{names.get(verdict, verdict)})"


def _dot(verdict: str) -> str:
    return f'<span class="dot" style="background:{_colour(verdict)}"></span>'
