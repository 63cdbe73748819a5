"""The page of common faults, from the figures that are there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from camber.integrity.learning.offset_causes import ISSUE_CODES
from camber.validation.common_faults.fault_cases import CASES, CommonFault
from camber.validation.markdown import columns, percent

Figures = Sequence[Mapping[str, Any]]
NOT_RUN = "Not run.\n"
_HEAD = """\
# Common faults

Made by `camber common_faults --lidar --page docs/common-faults.md`. What is missing was not run. A fault is one vector
that all fixes have in common, from its onset on; *wrong* is more than 0.5 m off in space, *right* within 0.2 m.
*Beyond* counts usable epochs whose horizontal error exceeds the horizontal protection level. Epochs of one drive are
one trial.

Drives without LiDAR go through 17 km of country roads (`simulator/world/countryside.py`). Hilly: 3 % rms along and 4 %
across; flat: 0.1 % along, crossfall 1.5 to 2 %. 50 km/h, turns, a stop at two crossings of five; fixes at 5 Hz, motion
at 10 Hz, a given pose of 1 m unless a row says otherwise. Faults begin after 240 s (2.5 km), with LiDAR after 20 s.

What the simulator does not make: wheels whose scale changes with speed, load, temperature and curve; ageing of the map
but for resurfacing; tyres that slip sideways; correlation of the receiver's velocity with its fixes; a base's own
single-point position, for which a receiver's raw data are needed.
"""
_CONTROL = {"none", "city-none"}


def page(figures: Figures) -> str:
    """All parts, for each value of `horizontal_reference`."""
    parts = [_HEAD]
    for reference in ("required", "assumed"):
        chosen = [row for row in figures if row["reference"] == reference]
        parts.append(f'## horizontal_reference = "{reference}"\n')
        for title, text in (
            ("Faults", _faults(chosen)),
            ("Drives without fault", _controls(chosen)),
            ("A receiver with 25 % wrong fixes", _episodes(chosen)),
        ):
            parts += [f"### {title}\n", text]
    return "\n".join(parts)


def _faults(figures: Figures) -> str:
    rows = [row for row in figures if row["part"] == "faults" and row["fault"] not in _CONTROL]
    groups: list[tuple[CommonFault, str, Figures]] = []
    for case in CASES:
        for ground in ("hilly", "flat"):
            of = [
                r
                for r in rows
                if r["fault"] == case.name and (case.scene != "country" or r["ground"] == ground)
            ]
            if of and (case.scene == "country" or ground == "hilly"):
                groups.append((case, ground if case.scene == "country" else "–", of))
    if not groups:
        return NOT_RUN
    return columns(
        groups,
        {
            "fault": lambda g: g[0].text,
            "ground": lambda g: g[1],
            "seeds": lambda g: len(g[2]),
            "wrong fixes confirmed": lambda g: f"{_sum(g[2], 'wrong_confirmed')} of {_sum(g[2], 'wrong')}",
            "worst, m": lambda g: f"{_most(g[2], 'worst_m'):.1f}",
            "usable epochs beyond": lambda g: f"{_sum(g[2], 'beyond_level')} of {_sum(g[2], 'usable')}",
            "and 1.5 m": lambda g: _sum(g[2], "beyond_level_and_limit"),
            "named after, s": lambda g: _named(g[2]),
            "required, s": lambda g: "–" if g[0].named_within_s is None else f"{g[0].named_within_s:g}",
            "usable until, s": lambda g: _until(g[2]),
        },
    )


def _controls(figures: Figures) -> str:
    groups = []
    for name, of in {
        "hilly, no LiDAR": [
            r for r in figures if _is_control(r) and r["scene"] == "country" and r["ground"] == "hilly"
        ],
        "flat, no LiDAR": [
            r for r in figures if _is_control(r) and r["scene"] == "country" and r["ground"] == "flat"
        ],
        "city, LiDAR": [r for r in figures if r["fault"] == "city-none"],
    }.items():
        if of:
            groups.append((name, of))
    if not groups:
        return NOT_RUN
    return columns(
        groups,
        {
            "drives": lambda g: g[0],
            "hours": lambda g: f"{sum(r['lasts_s'] for r in g[1]) / 3600.0:.1f}",
            "false alarms": lambda g: sum(_alarms(r) for r in g[1]),
            "usable": lambda g: percent(_mean(g[1], "usable_share"), 1),
            "usable after 2 km": lambda g: percent(_mean(g[1], "usable_share_after_2_km"), 1),
            "usable epochs beyond": lambda g: f"{_sum(g[1], 'beyond_level')} of {_sum(g[1], 'usable')}",
            "HPL, m (median)": lambda g: _number(_mean(g[1], "median_level_m")),
            "error, m (median)": lambda g: _number(_mean(g[1], "median_error_m")),
            "right fixes confirmed": lambda g: percent(
                _sum(g[1], "right_confirmed") / max(_sum(g[1], "right"), 1), 2
            ),
            "independent position, σ and error, m": lambda g: (
                f"{_number(_mean(g[1], 'independent_sigma_m'))}, {_number(_mean(g[1], 'independent_error_m'))}"
            ),
            "in its 99 % ellipse": lambda g: percent(_mean(g[1], "independent_inside_99"), 1),
        },
    )


def _is_control(row: Mapping[str, Any]) -> bool:
    return bool(row["part"] != "episodes" and row["fault"] == "none")


def _alarms(row: Mapping[str, Any]) -> int:
    """Causes that verdicts or issues name where there is no fault: each of a drive once."""
    by_issue = {cause for cause, code in ISSUE_CODES.items() if code in row["issues"]}
    return len(set(row["causes"]) | by_issue)


def _episodes(figures: Figures) -> str:
    rows = [r for r in figures if r["part"] == "episodes"]
    groups = [(g, of) for g in ("hilly", "flat") if (of := [r for r in rows if r["ground"] == g])]
    if not groups:
        return NOT_RUN
    return columns(
        groups,
        {
            "ground": lambda g: g[0],
            "drives": lambda g: len(g[1]),
            "wrong": lambda g: percent(_sum(g[1], "wrong") / _sum(g[1], "fixes"), 1),
            "wrong confirmed": lambda g: f"{_sum(g[1], 'wrong_confirmed')} of {_sum(g[1], 'wrong')}",
            "of the confirmed": lambda g: percent(
                _sum(g[1], "wrong_confirmed")
                / max(_sum(g[1], "wrong_confirmed") + _sum(g[1], "right_confirmed"), 1),
                3,
            ),
            "right kept": lambda g: percent(_sum(g[1], "right_confirmed") / _sum(g[1], "right"), 1),
            "right called erroneous": lambda g: percent(
                _sum(g[1], "right_erroneous") / _sum(g[1], "right"), 2
            ),
            "availability at 1.5 m": lambda g: percent(_mean(g[1], "availability"), 1),
            "usable": lambda g: percent(_mean(g[1], "usable_share"), 1),
            "usable epochs beyond": lambda g: f"{_sum(g[1], 'beyond_level')} of {_sum(g[1], 'usable')}",
            "captured": lambda g: f"{_sum(g[1], 'captured')} of {_sum(g[1], 'episodes')} episodes",
            "to unknown, s": lambda g: _longest(g[1], "to_unknown_s"),
            "to confirmed, s": lambda g: _longest(g[1], "to_confirmed_s"),
        },
    )


def _sum(rows: Figures, name: str) -> int:
    return sum(row[name] for row in rows)


def _most(rows: Figures, name: str) -> float:
    return max(float(row[name]) for row in rows)


def _mean(rows: Figures, name: str) -> float | None:
    values = [row[name] for row in rows if row.get(name) is not None]
    return sum(values) / len(values) if values else None


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _named(rows: Figures) -> str:
    """Of the drives that named it the longest time, and in how many."""
    times = [row["named_after_s"] for row in rows if row["named_after_s"] is not None]
    if not times:
        return "never"
    names = "/".join(sorted({row["named_by"] for row in rows if row["named_by"]}))
    return f"{max(times):.0f} ({names}, {len(times)} of {len(rows)})"


def _until(rows: Figures) -> str:
    """The latest, seconds after the onset, at which a position was usable."""
    times = [row["usable_until_s"] for row in rows]
    known = [t for t in times if t is not None]
    return "never usable" if not known else f"{max(known):.0f}"


def _longest(rows: Figures, name: str) -> str:
    times: list[float | None] = [t for row in rows for t in row[name]]
    return _of_times(times)


def _of_times(times: Iterable[float | None]) -> str:
    known = sorted(t for t in times if t is not None)
    never = sum(t is None for t in times)
    text = f"median {known[len(known) // 2]:.1f}, longest {known[-1]:.1f}" if known else "–"
    return f"{text}, never {never}" if never else text
