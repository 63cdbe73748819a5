"""The matcher on `street-lidar`: each rule of choice and three layer settings, as it is and with objects moved."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camber.localizer.matching.coarse_search import search, seems_mirrored
from camber.localizer.matching.layer_selection import LayerEstimate, Rule, choose
from camber.localizer.matching.layered_matching import (
    DOCUMENT_BOUNDS_M,
    Bounds,
    LayeredMatch,
    MatchOptions,
    match_layers,
)
from camber.localizer.matching.point_to_plane import moved
from camber.localizer.matching.registration import Method
from support.moved_objects import Change
from support.street_lidar import Query, queries, targets

Floats = NDArray[np.float64]

SETTINGS: dict[str, Bounds] = {
    "0-1-2-3 m (document)": DOCUMENT_BOUNDS_M,
    "0.3-1-2-3 m (default)": MatchOptions().layer_bounds_m,
    "0.3-0.8-1.5-3-6 m": ((0.3, 0.8), (0.8, 1.5), (1.5, 3.0), (3.0, 6.0)),
}
RULES: tuple[Rule, ...] = ("best", "mean", "weighted", "voted")
METHODS: dict[Method, tuple[str, ...]] = {
    "point_to_plane": tuple(SETTINGS),
    "point_to_point": tuple(SETTINGS),
    "plane_to_plane": ("0.3-1-2-3 m (default)",),
    "vgicp": ("0.3-1-2-3 m (default)",),
}
CHANGES: tuple[Change | None, ...] = (None, "shifted", "shifted_together", "replaced")
WRONG_M = 0.2


@dataclass(frozen=True, eq=False)
class Outcome:
    """Of a set of queries: errors (n, 3) east, north, yaw, normalised errors squared (n,), and the statuses."""

    error: Floats
    square: Floats
    status: Counter[str]

    @property
    def distance_m(self) -> Floats:
        """(n,) horizontal."""
        distance: Floats = np.hypot(self.error[:, 0], self.error[:, 1])
        return distance

    def centimetres(self, percentile: float) -> float:
        """Of the horizontal error."""
        return float(100.0 * np.percentile(self.distance_m, percentile))


def run(asked: Sequence[Query], options: MatchOptions) -> Outcome:
    """Match all."""
    if options.choice == "whole":
        layers = len(options.layer_bounds_m)
        options = replace(
            options,
            points_per_layer=layers * options.points_per_layer,
            points_at_start=layers * options.points_at_start,
        )
    return outcome(asked, [matched(query, options) for query in asked])


def matched(query: Query, options: MatchOptions) -> LayeredMatch:
    """One of them."""
    return match_layers(query.points_m, query.heights_m, targets(options.bounds_m), query.guess, options)


def outcome(asked: Sequence[Query], matches: Sequence[LayeredMatch]) -> Outcome:
    """How far off they are."""
    error = np.array([q.error(m.map_from_local) for q, m in zip(asked, matches, strict=True)])
    square = [float(e @ np.linalg.solve(m.covariance, e)) for e, m in zip(error, matches, strict=True)]
    return Outcome(error, np.array(square), Counter(m.status for m in matches))


def chosen(query: Query, match: LayeredMatch, rule: Rule) -> LayeredMatch:
    """The answer that another rule makes of the same layers."""
    layers = [row for row in match.layers if row.outcome in ("used", "voted_out")]
    if not layers:
        return match
    choice = choose([LayerEstimate(r.offset, r.covariance, r.fit.mean_distance_m) for r in layers], rule)
    return replace(
        match, map_from_local=moved(query.guess, choice.offset, "planar"), covariance=choice.covariance
    )


def print_tables() -> None:
    """All of them, in about five minutes."""
    print("Horizontal error to the pseudo truth, cm, p50 / p95 / greatest; ours is 'voted'.\n")
    _print_starts()
    _print_choices()
    _print_search()


def _print_starts() -> None:
    print("Default options")
    for off_m, off_deg, each in ((0.5, 2.0, 10), (1.0, 5.0, 10)):
        asked = queries(off_m, off_deg, each)
        found = run(asked, MatchOptions())
        right = int(np.count_nonzero(found.distance_m < WRONG_M))
        print(
            f"  from {off_m} m, {off_deg}°: {_three(found)}, right {right} of {len(asked)}, yaw p95"
            f" {np.degrees(np.percentile(np.abs(found.error[:, 2]), 95)):.3f}°, mean normalised error squared"
            f" {found.square.mean():.2f} of 3, {dict(found.status)}"
        )
    print()


def _print_choices() -> None:
    for change in CHANGES:
        asked = queries(0.5, 2.0, 2, change)
        print(
            f"From 0.5 m, 2°, objects {'as they were' if change is None else f'40 % {change}'}, {len(asked)} queries"
        )
        for method, settings in METHODS.items():
            for name in settings:
                options = MatchOptions(SETTINGS[name], method=method)
                layered = [matched(query, options) for query in asked]
                pairs = list(zip(asked, layered, strict=True))
                by_rule = {rule: outcome(asked, [chosen(q, m, rule) for q, m in pairs]) for rule in RULES}
                cells = [f"{rule} {_three(found)}" for rule, found in by_rule.items()]
                whole = run(asked, replace(options, choice="whole"))
                said = ", ".join(f"{n} {status}" for status, n in outcome(asked, layered).status.items())
                print(
                    f"  {method:14} {name:22} {'  '.join(cells)}  whole {_three(whole)}  ({said})", flush=True
                )
        print()


def _print_search() -> None:
    random = np.random.default_rng(6)
    right, unique, asked = 0, 0, 0
    for off_m, off_deg in zip(random.uniform(0.0, 5.0, 5), random.uniform(0.0, 15.0, 5), strict=True):
        for query in queries(float(off_m), float(off_deg), 1):
            found = search(query.points_m, query.heights_m, targets(MatchOptions().bounds_m), query.guess)
            error = query.error(found.match.map_from_local)
            asked += 1
            right += bool(np.hypot(error[0], error[1]) < WRONG_M)
            unique += found.unique
    print(f"Coarse search, 5 m and 15°: right {right} of {asked}, the only place {unique}")
    layers = targets(MatchOptions().bounds_m)
    accused, noticed = 0, 0
    straight = queries(0.5, 2.0, 1)
    for query in straight:
        mirrored_m = query.points_m * np.array([1.0, -1.0, 1.0])
        accused += seems_mirrored(query.points_m, query.heights_m, layers, query.guess)
        noticed += seems_mirrored(mirrored_m, query.heights_m, layers, query.guess)
    print(f"Mirrored sensor: noticed {noticed} of {len(straight)}, a right one accused {accused} times")


def _three(found: Outcome) -> str:
    return " / ".join(f"{found.centimetres(p):.1f}" for p in (50, 95, 100))
