"""The matcher on `street-lidar`: each rule of choice and three layer settings, as it is and with objects moved.

`PYTHONPATH=tests python -m support.street_lidar_tables` prints it in about five minutes (with CAMBER_DATA).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camber.localizer.matching.coarse_search import search, seems_mirrored
from camber.localizer.matching.icp import moved
from camber.localizer.matching.layer_selection import SelectionRule, select
from camber.localizer.matching.layered_matching import (
    LayeredMatch,
    MatchInput,
    MatchOptions,
    match_layers,
)
from camber.localizer.matching.registration import LayerBounds, Method
from support.moved_objects import Change
from support.street_lidar import Query, queries, targets

Floats = NDArray[np.float64]

SETTINGS: dict[str, LayerBounds] = {
    "0-1-2-3 m (document)": ((0.0, 1.0), (1.0, 2.0), (2.0, 3.0)),
    "0.3-1-2-3 m (default)": MatchOptions().layer_bounds_m,
    "0.3-0.8-1.5-3-6 m": ((0.3, 0.8), (0.8, 1.5), (1.5, 3.0), (3.0, 6.0)),
}
RULES: tuple[SelectionRule, ...] = ("best", "mean", "weighted", "voted")
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
    return match_layers(scan_of(query, options), options)


def scan_of(query: Query, options: MatchOptions) -> MatchInput:
    """Return the input of a match."""
    return MatchInput(
        points_m=query.points_m,
        heights_m=query.heights_m,
        targets=targets(options.bounds_m),
        guess=query.guess,
    )


def outcome(asked: Sequence[Query], matches: Sequence[LayeredMatch]) -> Outcome:
    """How far off they are."""
    error = np.array([q.error(m.map_from_local) for q, m in zip(asked, matches, strict=True)])
    square = [float(e @ np.linalg.solve(m.covariance, e)) for e, m in zip(error, matches, strict=True)]
    return Outcome(error, np.array(square), Counter(m.status for m in matches))


def chosen(query: Query, match: LayeredMatch, rule: SelectionRule) -> LayeredMatch:
    """The answer that another rule makes of the same layers."""
    layers = [row for row in match.layers if row.outcome in ("used", "voted_out")]
    if not layers:
        return match
    choice = select(layers, rule)
    return replace(
        match, map_from_local=moved(query.guess, choice.offset, "planar"), covariance=choice.covariance
    )


def main() -> None:
    print("Horizontal error to the pseudo truth, cm, p50 / p95 / greatest; ours is 'voted'.\n")
    _print_starts()
    _print_choices()
    _print_search()


def _print_starts() -> None:
    print("Default options")
    for off_m, off_deg, each in ((0.5, 2.0, 10), (1.0, 5.0, 10)):
        asked = queries(off_m, off_deg, each)
        result = run(asked, MatchOptions())
        right = int(np.count_nonzero(result.distance_m < WRONG_M))
        print(
            f"  from {off_m} m, {off_deg}°: {_three(result)}, right {right} of {len(asked)}, yaw p95"
            f" {np.degrees(np.percentile(np.abs(result.error[:, 2]), 95)):.3f}°, mean normalised error squared"
            f" {result.square.mean():.2f} of 3, {dict(result.status)}"
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
                options = MatchOptions(layer_bounds_m=SETTINGS[name], method=method)
                layered = [matched(query, options) for query in asked]
                pairs = list(zip(asked, layered, strict=True))
                by_rule = {rule: outcome(asked, [chosen(q, m, rule) for q, m in pairs]) for rule in RULES}
                cells = [f"{rule} {_three(result)}" for rule, result in by_rule.items()]
                whole = run(asked, replace(options, choice="whole"))
                statuses = ", ".join(f"{n} {status}" for status, n in outcome(asked, layered).status.items())
                print(
                    f"  {method:14} {name:22} {'  '.join(cells)}  whole {_three(whole)}  ({statuses})",
                    flush=True,
                )
        print()


def _print_search() -> None:
    random = np.random.default_rng(6)
    right, unique, asked = 0, 0, 0
    for off_m, off_deg in zip(random.uniform(0.0, 5.0, 5), random.uniform(0.0, 15.0, 5), strict=True):
        for query in queries(float(off_m), float(off_deg), 1):
            result = search(scan_of(query, MatchOptions()), MatchOptions())
            error = query.error(result.match.map_from_local)
            asked += 1
            right += bool(np.hypot(error[0], error[1]) < WRONG_M)
            unique += result.unique
    print(f"Coarse search, 5 m and 15°: right {right} of {asked}, the only place {unique}")
    accused, noticed = 0, 0
    straight = queries(0.5, 2.0, 1)
    for query in straight:
        scan = scan_of(query, MatchOptions())
        mirrored = replace(scan, points_m=query.points_m * np.array([1.0, -1.0, 1.0]))
        accused += seems_mirrored(scan, MatchOptions())
        noticed += seems_mirrored(mirrored, MatchOptions())
    print(f"Mirrored sensor: noticed {noticed} of {len(straight)}, a right one accused {accused} times")


def _three(result: Outcome) -> str:
    return " / ".join(f"{result.centimetres(p):.1f}" for p in (50, 95, 100))


if __name__ == "__main__":
    main()
