"""`docs/evidence.md` from the results that are there: what was not run says so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from camber.schemas.base import Float64
from camber.validation.evidence.faults import AFTER_S
from camber.validation.evidence.nagoya import BASELINES, REQUIREMENTS, Requirement, total
from camber.validation.evidence.simulated_drives import (
    BLOCK_S,
    LIMITS_M,
    MODES,
    MORE_CONFIRMED,
    PUBLISHED_BELOW,
    PUBLISHED_INSIDE_99,
    REQUIRED_BELOW,
    WITHOUT,
    stacked_blocks,
)
from camber.validation.markdown import columns, percent, table
from camber.validation.statistics import share_interval, share_of

Results = Sequence[dict[str, Any]]
NOT_RUN = "Not run."

_JUDGES = {
    "camber": "Camber",
    "ratio_test_only": "ratio test only",
    "height_only": "height only, fixed tolerance",
    "always_unknown": "always *unknown*",
}
_HEAD = """\
# Evidence

Made by `make evidence`; every table names its command, its seeds and its n. What is missing was not run. Definitions
are those of `camber replay`'s summary: *wrong* is more than 0.5 m off in 3D, *right* is within 0.2 m. Zero events in n
trials bound a rate by 3/n (95 %), no better, and epochs of one episode are one trial.
"""


def page(
    nagoya: Results, drives: Results, faults: Results, *, lab: str | None = None, notes: Sequence[str] = ()
) -> str:
    """The whole page; `lab` is the part that the lab makes itself, `notes` are lines on what was left out and why."""
    parts = [_HEAD]
    parts += [f"{note}\n" for note in notes]
    parts += ["## A recorded drive\n", nagoya_part(nagoya)]
    parts += ["## Simulated drives\n", drives_part(drives)]
    parts += ["## Faults\n", faults_part(faults)]
    parts += [lab or f"## The lab\n\n{NOT_RUN}"]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def nagoya_part(results: Results) -> str:
    """The recording: a table for each σ of the map, and each wrong epoch that was confirmed."""
    if not results:
        return NOT_RUN
    text = [
        "Nagoya, 11 July 2023, 20.5 min at 5 Hz: a receiver's own fixes and a reference of 2 cm. The recording has no "
        "map and no vehicle sensors: they are made from the reference, for each seed anew, and so is nothing of the "
        "satellites. The episodes of wrong fixes are therefore the same for all seeds, and n is theirs.\n"
    ]
    for required in REQUIREMENTS:
        chosen = [r for r in results if r["map_sigma_m"] == required.map_sigma_m]
        text.append(
            _nagoya_table(chosen, required) if chosen else f"σ {required.map_sigma_m:.2f} m: not run.\n"
        )
    return "\n".join(text)


def _nagoya_table(results: Results, required: Requirement) -> str:
    seeds = sorted(r["seed"] for r in results)
    totals = {judge: total(results, judge) for judge in ("camber", *BASELINES)}
    ours = totals["camber"]
    met = ours["confirmed_wrong"] <= required.wrong_confirmed and (
        (ours["right_kept"] or 0.0) >= required.right_confirmed
    )
    enough = len(results) / 50.0 >= 1.0
    judges = columns(
        totals.items(),
        {
            "judge": lambda item: _JUDGES[item[0]],
            "wrong epochs confirmed": lambda item: f"{item[1]['confirmed_wrong']} of {item[1]['wrong']}",
            "right confirmed": lambda item: percent(item[1]["right_kept"]),
            "right called erroneous": lambda item: item[1]["right_erroneous"],
            "episodes missed": lambda item: f"{item[1]['missed']} of {item[1]['episodes']} × {len(results)}",
            "3/n": lambda item: _bound(item[1]),
        },
    )
    heading = (
        f"### σ of the map {required.map_sigma_m:.2f} m\n\n"
        f"`camber evidence --only nagoya`, seeds {seeds[0]} to {seeds[-1]} ({len(seeds)} drives). "
        f"Asked for over 50 seeds: at most {required.wrong_confirmed} wrong epochs confirmed, at least "
        f"{percent(required.right_confirmed, 1)} of the right ones: "
        + ("**met**." if met and enough else "met so far, with fewer seeds." if met else "**not met**.")
        + "\n"
    )
    return "\n".join([heading, judges, _held_back(results), _wrong_confirmed(results)])


def _bound(t: dict[str, Any]) -> str:
    return percent(3.0 / t["episodes"], 0) if t["episodes"] and not t["missed"] else "—"


def _held_back(results: Results) -> str:
    reasons: Counter[str] = Counter()
    for result in results:
        reasons.update(result["held_back"])
    listed = ", ".join(f"{reason} {count}" for reason, count in reasons.most_common()) or "none"
    return f"Right epochs that were not confirmed: {listed}.\n"


def _wrong_confirmed(results: Results) -> str:
    rows = [{"seed": r["seed"], **w} for r in results for w in r["wrong_confirmed"]]
    if not rows:
        return "No wrong epoch was confirmed.\n"
    return "Wrong epochs that were confirmed:\n\n" + columns(
        rows,
        {
            "seed": lambda w: w["seed"],
            "s": lambda w: f"{w['at_s']:.1f}",
            "error E, N, U [m]": lambda w: ", ".join(f"{e:+.2f}" for e in w["fix_error_enu_m"]),
            "height difference [m]": lambda w: _metres(w["height_difference_m"]),
            "from the pose E, N [m]": lambda w: (
                ", ".join(f"{d:+.2f}" for d in w["position_difference_m"] or ()) or "—"
            ),
            "d²": lambda w: "—" if w["joint_distance2"] is None else f"{w['joint_distance2']:.1f}",
            "h_e [m]": lambda w: f"{w['correction_m']:+.3f}",
            "verdict": lambda w: w["word"] + (f" ({', '.join(w['evidence'])})" if w["evidence"] else ""),
        },
    )


def _metres(value: float | None, decimals: int = 2) -> str:
    return "—" if value is None else f"{value:+.{decimals}f}"


def drives_part(results: Results) -> str:
    """Kikuchi's table and ours, then coverage by mode."""
    if not results:
        return NOT_RUN
    text = []
    without = [r for r in results if r.get("re_estimation") == WITHOUT]
    usual = [r for r in results if r not in without]
    for scenario in dict.fromkeys(_name(r) for r in usual):
        chosen = [r for r in usual if _name(r) == scenario]
        heading = f"### {scenario}\n"
        text += [heading, _drives_heading(chosen), _errors(chosen), _coverage(chosen), _levels(chosen)]
    return "\n".join([*text, "### Re-estimation\n", _re_estimation(usual, without)])


def _re_estimation(usual: Results, without: Results) -> str:
    """The same drives with and without: right fixes that are confirmed, and wrong ones."""
    rows = []
    for one in without:
        for other in (r for r in usual if (_name(r), r["seed"]) == (_name(one), one["seed"])):
            right, before = (r["confirmed"] - (r["confirmed_wrong"] or 0) for r in (other, one))
            wrong, wrong_before = other["confirmed_wrong"] or 0, one["confirmed_wrong"] or 0
            met = right >= MORE_CONFIRMED * before > 0 and wrong <= wrong_before
            more = percent(right / before - 1.0, 1) if before else "none"
            drive, answer = (_name(one), one["seed"]), "yes" if met else "**no**"
            rows.append((*drive, before, right, more, wrong_before, wrong, answer))
    if not rows:
        return NOT_RUN
    head = ("drive", "seed", "confirmed without it", "with it", "more", "wrong without it", "with it", "met")
    asked = f"{percent(MORE_CONFIRMED - 1.0, 0)} more confirmed within 0.5 m, and no more wrong ones"
    return f"Asked for: {asked}.\n\n" + table(head, rows)


def _name(result: dict[str, Any]) -> str:
    more = " ".join(result["overrides"])
    return f"{result['scenario']}, {more}" if more else str(result["scenario"])


def _drives_heading(results: Results) -> str:
    seeds = ", ".join(str(r["seed"]) for r in results)
    kept = [r["right_kept"] for r in results if r["right_kept"] is not None]
    return (
        f"`camber evidence --only drives`: `camber simulate {results[0]['scenario']}` with seeds {seeds}, "
        f"{sum(r['duration_s'] for r in results) / 60:.0f} min, positions of the {results[0]['positions']}. "
        f"Fixes {sum(r['fixed'] for r in results)}, wrong {sum(r['wrong'] for r in results)}, "
        f"wrong confirmed {sum(r['confirmed_wrong'] or 0 for r in results)}, right confirmed "
        f"{percent(sum(kept) / len(kept)) if kept else 'none'}; usable at the alert limit in "
        f"{percent(sum(r['usable'] * r['epochs'] for r in results) / sum(r['epochs'] for r in results))} of the "
        "epochs. A simulation is no evidence of performance on a road.\n"
    )


def _levels(results: Results) -> str:
    """By mode: how often the error was beyond the protection level, and how much wider the level is than the error."""
    by_mode = {
        f"{mode}, {text}": [
            r["levels"][mode][name] for r in results if r["levels"].get(mode, _NO_LEVELS)[name]["epochs"]
        ]
        for mode in MODES
        for name, text in (("hpl", "horizontal"), ("vpl", "vertical"))
    }
    rows = [(name, levels) for name, levels in by_mode.items() if levels]
    if not rows:
        return "No protection levels were given.\n"
    intro = "Protection levels at the integrity risk; medians are the largest of any drive.\n\n"
    return intro + columns(
        rows,
        {
            "level": lambda row: row[0],
            "epochs": lambda row: sum(item["epochs"] for item in row[1]),
            "error beyond it": lambda row: sum(
                item["misleading"] + item["unavailable_misleading"] for item in row[1]
            ),
            "and beyond the alert limit": lambda row: sum(item["hazardous"] for item in row[1]),
            "median": lambda row: f"{max(item['median_level_m'] for item in row[1]):.2f} m",
            "by the median error": lambda row: _largest(item["ratio"] for item in row[1]),
        },
    )


_NO_LEVELS: dict[str, dict[str, int]] = {"hpl": {"epochs": 0}, "vpl": {"epochs": 0}}


def _largest(ratios: Iterable[float | None]) -> str:
    known = [ratio for ratio in ratios if ratio is not None]
    return f"{max(known):.1f}" if known else "none"


def _errors(results: Results) -> str:
    blocks = stacked_blocks(results, None)
    epochs, known = blocks[:, 0], blocks[:, 1]
    rows = [("availability", "100 %", "100 %", percent(share_of(known, epochs)), "")]
    for k, (limit_m, theirs, asked) in enumerate(zip(LIMITS_M, PUBLISHED_BELOW, REQUIRED_BELOW, strict=True)):
        limits = f"error < {limit_m:.1f} m", percent(theirs, 1), percent(asked, 1)
        rows.append((*limits, *_share_and_interval(blocks[:, 2 + k], known)))
    return table(("", "R (Nagoya 2014)", "asked for", "Camber", "95 %, blocks redrawn"), rows)


def _share_and_interval(hits: Float64, trials: Float64) -> tuple[str, str]:
    return percent(share_of(hits, trials)), _interval(share_interval(hits, trials, seed=0))


def _coverage(results: Results) -> str:
    by_mode = {mode: stacked_blocks(results, mode) for mode in MODES}
    by_mode["all"] = np.sum(list(by_mode.values()), axis=0)
    rows: list[tuple[object, ...]] = []
    for mode, blocks in by_mode.items():
        n, inside_99, inside_999 = blocks.T
        if not n.sum():
            rows.append((mode, 0, "—", "none", "", "none", ""))
            continue
        published = percent(PUBLISHED_INSIDE_99[mode], 1) if mode in PUBLISHED_INSIDE_99 else "—"
        shares = *_share_and_interval(inside_99, n), *_share_and_interval(inside_999, n)
        rows.append((mode, int(n.sum()), published, *shares))
    head = ("truth inside", "epochs", "R, 99 %", "99 % ellipse", "95 %", "99.9 % ellipse", "95 %")
    return f"Intervals are of a bootstrap over blocks of {BLOCK_S:g} s.\n\n" + table(head, rows)


def _interval(interval: tuple[float, float] | None) -> str:
    return "—" if interval is None else f"{percent(interval[0])} – {percent(interval[1])}"


def faults_part(results: Results) -> str:
    """A row for each fault: named by what and when, how many were confirmed, and what learning made of it."""
    return "\n".join(map(_faults_table, results)) or NOT_RUN


def _faults_table(result: dict[str, Any]) -> str:
    sweeps = f"{result['sweeps']} sweeps" if result["sweeps"] else "without LiDAR"
    return (
        f"`camber evidence --only faults`: `camber simulate {_name(result)}`, seed {result['seed']}, {sweeps}, "
        f"positions of the {result['positions']}. Wrong fixes {result['wrong']}, "
        f"confirmed {result['confirmed_wrong']}; right fixes confirmed {percent(result['right_kept'])}. "
        "h_e before, at the end, before the next fault.\n\n"
    ) + columns(
        result["faults"],
        {
            "fault": lambda f: f"{f['kind']} {f['begin_s']:.0f}–{f['end_s']:.0f} s",
            f"named, up to {AFTER_S:g} s after it": lambda f: (
                "**not named**"
                if f["named_by"] is None
                else f"{f['named_by']} after {f['named_after_s']:.1f} s"
            ),
            "wrong of fixes": lambda f: f"{f['wrong']} of {f['fixed']}",
            "confirmed": lambda f: f["wrong_confirmed"],
            "and after": lambda f: f["wrong_confirmed_after"],
            "h_e [m]": lambda f: " → ".join(_metres(f[key], 3) for key in _CORRECTIONS),
        },
    )


_CORRECTIONS = ("correction_before_m", "correction_at_end_m", "correction_after_m")
