"""The lab's section of the page of evidence, from `lab.json` alone: tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from camber.validation.lab.baselines import BASELINES
from camber.validation.lab.error_model import HEADLINE, scene_of
from camber.validation.markdown import columns, table

_KINDS = {
    "search": "Integers found by LAMBDA from biased floats:",
    "cycles": "Integers off by one to three cycles:",
}


def page(figures: dict[str, Any]) -> str:
    """Markdown, headings of level two and three."""
    sections = (_head, _requirements, _baselines, _curves, _alarms, _faults, _levels, _assumptions)
    return "\n".join("\n\n".join(section(figures)).rstrip("\n") + "\n" for section in sections)


def _head(figures: dict[str, Any]) -> Iterator[str]:
    yield "## The lab"
    yield f"    camber lab --seed {figures['seed']} --trials {figures['trials']} --out lab"
    yield (
        f"Wrong fixes, right fixes and faults of random skies through the judge's own determination, with its "
        f"default limits. Seed {figures['seed']}, {figures['trials']:,} episodes of each kind in each of the two "
        "headline scenes; the figures depend on the seed alone, not on how many processes made them. Bounds are of "
        "95 %, one-sided (Clopper and Pearson); episodes of one sky count as one as far as they are missed together."
    )


def _requirements(figures: dict[str, Any]) -> Iterator[str]:
    yield "### What is asked"
    rows = [(*row, "yes" if met else "**no**") for *row, met in requirements(figures)]
    yield table(("figure", "asked", "found", "met"), rows)


def requirements(figures: dict[str, Any]) -> Iterator[tuple[str, str, str, bool]]:
    """What, what is asked, what was measured, and whether that is met."""
    for kind in ("search", "cycles"):
        for pose_sigma_m, beyond_m in ((0.05, 0.5), (0.10, 1.0)):
            threshold = _threshold(figures, kind, pose_sigma_m, beyond_m)
            control = threshold["controls"]["all, with residuals"]
            what = f"missed episodes beyond {beyond_m} m, LiDAR σ {pose_sigma_m:.2f} m ({kind})"
            measured = (
                f"{control['missed']} of {threshold['harmful_episodes']:,}, ≤ {control['upper_95']:.1e}"
            )
            yield what, "≤ 1e-4", measured, control["upper_95"] <= 1e-4
            alert = threshold["time_to_alert"]
            if alert["episodes"]:
                within = alert["p99_s"] <= 0.2 and alert["max_s"] <= 1.0
                measured = (
                    f"{alert['p99_s']:.1f} s; {alert['max_s']:.1f} s ({alert['beyond_1_s']} beyond 1 s)"
                )
                yield f"time to alert there, p99; most ({kind})", "≤ 0.2 s; ≤ 1 s", measured, within
    for row in figures["alarms"][:2]:
        rate = row["false_alarm"]
        measured = (
            f"{rate['rate']:.1e}, ≤ {rate['upper_95']:.1e} ({rate['effective_events']:.0f} effective events)"
        )
        what = f"false alarms of right epochs, LiDAR σ {row['pose_sigma_m']:.2f} m"
        yield what, "≤ 1e-5", measured, rate["upper_95"] <= 1e-5
    hazard = figures["hazard"]
    measured = f"{hazard['rate']:.1e}, ≤ {hazard['upper_95']:.1e}"
    yield "hazardously misleading epochs, alert limit 1.5 m", "≤ 1e-7", measured, hazard["upper_95"] <= 1e-7
    for mode, counts in figures["levels"]["modes"].items():
        inside, more = counts["inside_99"]["share"], counts["inside_999"]["share"]
        within = 0.990 <= inside <= 0.995 and 0.9990 <= more <= 0.9997
        yield f"inside 99 %; 99.9 %: {mode}", "99.0–99.5; 99.90–99.97", f"{inside:.2%}; {more:.3%}", within
        level, error = counts["median_level_m"], counts["median_error_m"]
        if mode == "rtk":
            measured = f"{level:.2f} m; {counts['p99_level_m']:.2f} m for 99 %"
            yield "level at 1e-7, median: rtk with LiDAR", "≤ 1 m", measured, level <= 1.0
        else:
            yield (
                f"level at 1e-7 by median error: {mode}",
                "≤ 8",
                f"{level / error:.1f}",
                level / error <= 8.0,
            )


def _threshold(figures: dict[str, Any], kind: str, pose_sigma_m: float, beyond_m: float) -> dict[str, Any]:
    for row in figures["missed"]:
        if (row["kind"], row["pose_sigma_m"], row["map_sigma_m"]) == (kind, pose_sigma_m, 0.05):
            return next(t for t in row["thresholds"] if t["beyond_m"] == beyond_m)
    raise KeyError(f"no scene {kind}, {pose_sigma_m}")


def _baselines(figures: dict[str, Any]) -> Iterator[str]:
    yield "### Harmful episodes that are missed"
    yield (
        "Share of the episodes with a horizontal error beyond the threshold of which a harmful epoch is confirmed, and "
        "its upper bound; in brackets those late, confirmed for a second on end or at all their harmful epochs."
    )
    for kind, heading in _KINDS.items():
        rows = []
        for row in figures["missed"]:
            if row["kind"] != kind or scene_of(row) not in HEADLINE:
                continue
            for t in row["thresholds"]:
                cells = [_share(t["controls"][name]) for name in BASELINES]
                rows.append((*_scene(row), f"{t['beyond_m']}", f"{t['harmful_episodes']:,}", *cells))
        yield heading
        yield table(("LiDAR σ [m]", "map σ [m]", "beyond [m]", "episodes", *BASELINES), rows)


def _scene(row: dict[str, Any]) -> tuple[str, str]:
    return f"{row['pose_sigma_m']:.2f}", f"{row['map_sigma_m']:.2f}"


def _share(control: dict[str, Any]) -> str:
    if control["rate"] is None:
        return "none"
    if control["rate"] == 1.0:
        return "all"
    if control["rate"] >= 0.01:
        return f"{control['rate']:.1%} ≤ {control['upper_95']:.1%} ({control['late']})"
    return f"{control['rate']:.1e} ≤ {control['upper_95']:.1e} ({control['late']})"


def _curves(figures: dict[str, Any]) -> Iterator[str]:
    yield "### Over the size of the error"
    yield "Share of the episodes of which any epoch is confirmed: height only / height and LiDAR / all, with residuals."
    for kind in _KINDS:
        scenes = [row for row in figures["missed"] if row["kind"] == kind]
        names = [f"LiDAR {row['pose_sigma_m']:.2f}, map {row['map_sigma_m']:.2f}" for row in scenes]
        rows = []
        for bins in zip(*(row["curve"] for row in scenes), strict=True):
            low_m, high_m = bins[0]["from_m"], bins[0]["to_m"]
            size = f"{low_m:g}–{high_m:g}" if high_m else f"over {low_m:g}"
            rows.append((f"{size} m", *map(_three, bins)))
        yield table((kind, *names), rows)


def _three(b: dict[str, Any]) -> str:
    if not b["episodes"]:
        return "–"
    shown = ("height only", "height and LiDAR", "all, with residuals")
    return " / ".join(_short(b["confirmed"][name] / b["episodes"]) for name in shown)


def _short(share: float) -> str:
    return "0" if share == 0.0 else f"{share:.0e}" if share < 0.001 else f"{share:.3f}"


def _alarms(figures: dict[str, Any]) -> Iterator[str]:
    yield "### Right fixes"
    yield "By importance sampling; a right fix is *contradicted* by mistake, or *held back* as unknown."
    yield columns(
        figures["alarms"],
        {
            "LiDAR σ [m]": lambda row: _scene(row)[0],
            "map σ [m]": lambda row: _scene(row)[1],
            "contradicted": lambda row: _rate(row["false_alarm"]),
            "effective events of draws": lambda row: (
                f"{row['false_alarm']['effective_events']:.0f} of {row['false_alarm']['draws']:,}"
            ),
            "held back": lambda row: f"{row['held_back']['rate']:.2%}",
        },
    )


def _rate(rate: dict[str, Any]) -> str:
    return f"{rate['rate']:.1e} ≤ {rate['upper_95']:.1e}"


def _faults(figures: dict[str, Any]) -> Iterator[str]:
    faults = figures["faults"]
    yield "### Faults"
    yield (
        f"LiDAR σ {faults['pose_sigma_m']:.2f} m, map σ {faults['map_sigma_m']:.2f} m; nothing claims the fault. Right "
        "integers by epoch, wrong ones by episode of ten seconds, harmful beyond 0.5 m."
    )
    yield columns(
        faults["rows"],
        {
            "fault": lambda row: row["fault"],
            "right integers confirmed": lambda row: f"{row['confirmed'] / max(row['right'], 1):.1%}",
            "contradicted": lambda row: f"{row['contradicted'] / max(row['right'], 1):.1%}",
            "harmful and confirmed": lambda row: (
                f"{row['harmful_confirmed']:,} of {row['harmful']:,}" if row["harmful"] else "–"
            ),
            "wrong integers missed": lambda row: (
                f"{row['missed']} of {row['episodes']:,} ≤ {row['missed_upper_95']:.1e}"
            ),
        },
    )


def _levels(figures: dict[str, Any]) -> Iterator[str]:
    levels, hazard = figures["levels"], figures["hazard"]
    yield "### Bounds"
    rows = []
    for mode, c in levels["modes"].items():
        shares = [
            f"{c[k]['share']:.3%} ({c[k]['lower_95']:.3%}–{c[k]['upper_95']:.3%})"
            for k in ("inside_99", "inside_999")
        ]
        beyond = f"{c['beyond_level']['count']} ≤ {c['beyond_level']['upper_95']:.0e}"
        sizes = f"{c['median_error_m']:.3f}", f"{c['median_level_m']:.3f}", f"{c['level_by_error']:.1f}"
        available = [f"{share:.2%}" for share in c["available"]]
        rows.append((mode, f"{c['draws']:,}", *shares, beyond, *sizes, *available))
    head = (
        "mode", "draws", "inside 99 %", "inside 99.9 %", "beyond the level", "median error [m]",
        f"level at {levels['risk']:g} [m]", "of error", *(f"< {limit:g} m" for limit in levels["alert_limits_m"]),
    )  # fmt: skip
    yield table(head, rows)
    yield (
        f"Hazardously misleading (error beyond the level and beyond {hazard['alert_limit_m']} m while usable): "
        f"{hazard['rate']:.1e} per epoch, at most {hazard['upper_95']:.1e}, as the sum of"
    )
    yield columns(
        hazard["parts"],
        {
            "part": lambda part: part["part"],
            "share of epochs (assumed)": lambda part: f"{part['share']:.1e}",
            "hazardous in it": _rate,
            "effective events of draws": lambda part: f"{part['effective']:.0f} of {part['draws']:,}",
        },
    )
    at_fault = [part for part in hazard["parts"] if "pose at fault" in part["part"]]
    often = 1e-3 / hazard["pose_fault_prior"] * sum(part["share"] * part["upper_95"] for part in at_fault)
    yield (
        f"Were poses at fault and unseen in one epoch of a thousand, not in {hazard['pose_fault_prior']:g} of them, "
        f"the parts with such a pose would be {often:.0e} per epoch."
    )


def _assumptions(figures: dict[str, Any]) -> Iterator[str]:
    yield "### Assumptions"
    parts = (
        ("", figures["assumptions"]),
        ("judge: ", figures["rules"]),
        ("true σ: ", figures["true_sigma"]),
        ("wrong fixes: ", figures["level_rules"]["wrong_fix"]),
    )
    rows = [(f"{prefix}{name}", _text(value)) for prefix, part in parts for name, value in part.items()]
    yield table(("what", "value"), rows)
    yield (
        "Not modelled: a pose that a wrong fix has pulled along, spoofing, and verification by other evidence than "
        "height, position and residuals. Every episode is judged once; the chance of k trials is at most k times that."
    )


def _text(value: Any) -> str:
    if not isinstance(value, (list, tuple)):
        return str(value)
    nested = any(isinstance(item, (list, tuple)) for item in value)
    return ("; " if nested else ", ").join(_text(item) for item in value)
