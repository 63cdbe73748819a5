"""What fusion makes of a fleet's uploads: heights, changes seen and missed, lies withstood, beside a mean of records.

PYTHONPATH=tests python -m support.fleet_statistics --seeds 1 2 3

The scenario `fleet` with the seeds named: 400 vehicles, three drives each over three weeks, a fifth of the roads
changed by 3 to 30 cm, 3 % of the drives wrong throughout and wrong episodes in the others, nothing left out for its
verdict. The survey itself is 3 cm off (correlated over 20 m), so that some of the unchanged roads are wrong by more
than 3 cm too, and to publish these is right. True is, for each surface, the mean of road − reference along the ways.

Lies concern one unchanged street, by a share of the vehicles seen there. *Theirs* is what comes to be published with
them and is not without, though the road is within 3 cm of the reference, or worse off than before.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.publication_decision import REASONS, Decisions
from camber.map_update.fusion.votes import SAMPLES, Votes, merge_votes, session_of, vote_values
from camber.road_map.height_interpolation import SurfaceHeights
from support.fleet_votes import DAY_NS, FleetWorld, Record, fusion_of, record_of, votes_of, world_of

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Generator = np.random.Generator
NOBODY = np.zeros(0, np.int64)
THRESHOLD_M, WRONG_M, LARGE_M = 0.03, 0.015, 0.06
FLEETS = (10, 20, 50, 100, 400)
SHARES = (0.05, 0.10, 0.20)
Lie = Callable[["Street", Votes, Flags, Generator], Votes]


@dataclass(frozen=True, eq=False)
class Run:
    """One seed: its world, all that was uploaded, its votes, and how far each record is from the reference."""

    world: FleetWorld
    fusion: Fusion
    record: Record
    deviation_m: Floats
    votes: Votes
    true_m: Floats
    """(surfaces,) in the order of the fusion's neighbourhood, as all that follows."""
    changed: Flags

    @property
    def now_ns(self) -> int:
        assert self.world.scenario.fleet is not None
        return self.world.start_ns + self.world.scenario.fleet.days * DAY_NS

    def decide(self, votes: Votes, now_ns: int | None = None) -> Decisions:
        return self.fusion.decide(votes, NOBODY, np.zeros(0), now_ns or self.now_ns)


@dataclass(frozen=True, eq=False)
class Street:
    """The street that lies concern."""

    run: Run
    surface_id: NDArray[np.int64]
    today: int


def run_of(seed: int, *overrides: str) -> Run:
    world = world_of(seed, *overrides)
    fusion = fusion_of(world)
    record = record_of(world)
    heights = SurfaceHeights(world.surfaces)
    map_m, _ = heights.heights_m(
        heights.rows_of(record.observations["surface_id"]),
        np.ascontiguousarray(record.observations["latitude_rad"]),
        np.ascontiguousarray(record.observations["longitude_rad"]),
    )
    order = np.argsort(world.surfaces.surface_id)
    changed = np.isin(fusion.neighbourhood.link_id, list(world.changed_roads))
    return Run(
        world,
        fusion,
        record,
        record.observations["road_height_m"] - map_m,
        votes_of(fusion, record),
        world.true_offset_m[order],
        changed,
    )


def honest(run: Run, vehicles: int) -> dict[str, Any]:
    """The first vehicles of the fleet, beside the mean of their records."""
    voters = [run.fusion.voter_of(f"car{n:05d}") for n in range(vehicles)]
    votes = run.votes[np.isin(run.votes["voter"], voters)]
    decisions = run.decide(votes)
    result = decisions.surfaces
    row = run.fusion.neighbourhood.rows_of(result["surface_id"])
    true_m, changed = run.true_m[row], run.changed[row]
    error_m = result["offset_m"] - true_m
    enough = result["vehicles"] >= 5
    published = np.isin(result["surface_id"], decisions.of("publish")["surface_id"])
    ready = changed & (np.abs(true_m) >= LARGE_M) & enough & _ready(votes, result, true_m)
    missed = ready & ~published
    mean_m, mean_error_m, cars = _means(run, run.record.vehicle < vehicles)
    mean_m, mean_error_m, cars = mean_m[row], mean_error_m[row], cars[row]
    mean_published = (np.abs(mean_m) - 3.3 * mean_error_m > THRESHOLD_M) & (cars >= 5)
    unchanged = ~changed & enough
    return {
        "vehicles": vehicles,
        "surfaces": int(enough.sum()),
        "rmse_unchanged_mm": _rms_mm(error_m[unchanged]),
        "rmse_changed_mm": _rms_mm(error_m[changed & enough]),
        "error_p99_mm": _quantile_mm(np.abs(error_m[enough]), 0.99),
        "floor_median_mm": 3.3 * _quantile_mm(result["standard_error_m"][enough], 0.5),
        "floor_p95_mm": 3.3 * _quantile_mm(result["standard_error_m"][enough], 0.95),
        "error_over_se": float(np.std(error_m[enough] / result["standard_error_m"][enough])) if enough.any() else 0.0,
        "large_changes": int((changed & (np.abs(true_m) >= LARGE_M)).sum()),
        "ready": int(ready.sum()),
        "missed": int(missed.sum()),
        "missed_why": dict(Counter(REASONS[k] for k in result["reason"][missed])),
        "published": int(published.sum()),
        "false": int((published & (np.abs(true_m) < THRESHOLD_M)).sum()),
        "published_off": int((published & (np.abs(error_m) > np.maximum(WRONG_M, 3.3 * result["sigma_m"]))).sum()),
        "held": len(decisions.of("hold")),
        "alarms": len(decisions.alarms),
        "mean_rmse_unchanged_mm": _rms_mm(mean_m[unchanged] - true_m[unchanged]),
        "mean_published": int(mean_published.sum()),
        "mean_false": int((mean_published & (np.abs(true_m) < THRESHOLD_M)).sum()),
        "mean_missed": int((ready & ~mean_published).sum()),
    }  # fmt: skip


def _ready(votes: Votes, result: NDArray[np.void], true_m: Floats) -> Flags:
    """Where n votes of spread σ reach 3.3 σ / √n < change − 3 cm; σ by the median absolute deviation."""
    value_m, _, _ = vote_values(votes)
    ready = np.zeros(len(result), bool)
    begins = np.searchsorted(votes["surface_id"], result["surface_id"])
    ends = np.searchsorted(votes["surface_id"], result["surface_id"], side="right")
    for k, (a, b) in enumerate(zip(begins, ends, strict=True)):
        spread_m = 1.4826 * float(np.median(np.abs(value_m[a:b] - np.median(value_m[a:b]))))
        ready[k] = 3.3 * spread_m / np.sqrt(b - a) < abs(true_m[k]) - THRESHOLD_M
    return ready


def _means(run: Run, of: Flags, lie_m: Floats | None = None) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """The mean of records, its standard error and how many vehicles: what a plain server would do."""
    row = run.fusion.neighbourhood.rows_of(run.record.observations["surface_id"])
    size = len(run.true_m)
    value_m = run.deviation_m if lie_m is None else run.deviation_m + lie_m
    of = of & (row >= 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        count = np.bincount(row[of], minlength=size)
        mean_m = np.bincount(row[of], value_m[of], size) / count
        variance_m2 = np.bincount(row[of], value_m[of] ** 2, size) / count - mean_m**2
        error_m = np.sqrt(np.maximum(variance_m2, 0.0) / count)
    pairs = np.unique(row[of] * 1_000_000 + run.record.vehicle[of])
    return mean_m, error_m, np.bincount(pairs // 1_000_000, minlength=size)


def street_of(run: Run) -> Street:
    """The unchanged link with most votes, its surfaces that at least twenty vehicles have seen."""
    neighbourhood = run.fusion.neighbourhood
    seen = run.decide(run.votes).surfaces
    row = neighbourhood.rows_of(seen["surface_id"])
    good = ~run.changed[row] & (seen["vehicles"] >= 20)
    links, votes = np.unique(neighbourhood.link_id[row[good]], return_inverse=True)
    best = links[np.argmax(np.bincount(votes, seen["votes"][good]))]
    today = int(session_of(np.array([run.now_ns]), run.world.surfaces.longitude_rad[:1])[0])
    return Street(run, seen["surface_id"][good & (neighbourhood.link_id[row] == best)], today)


def _lied(votes: Votes, lie_m: Floats | float) -> Votes:
    votes = votes.copy()
    for k in range(SAMPLES):
        there = votes[f"rank_{k}"] != 2**31 - 1
        votes[f"deviation_{k}_m"][there] += np.broadcast_to(lie_m, there.shape)[there]
    return votes


def _steady(street: Street, votes: Votes, theirs: Flags, rng: Generator, *, size_m: float) -> Votes:
    lied = votes.copy()
    lied[theirs] = _lied(votes[theirs], size_m)
    return lied


def _against_the_map(street: Street, votes: Votes, theirs: Flags, rng: Generator, *, size_m: float) -> Votes:
    """They know the truth, and lie where the map is off already, in its direction."""
    lied = votes.copy()
    row = street.run.fusion.neighbourhood.rows_of(votes["surface_id"][theirs])
    lied[theirs] = _lied(votes[theirs], np.sign(street.run.true_m[row]) * size_m)
    return lied


def _daily(street: Street, votes: Votes, theirs: Flags, rng: Generator, *, size_m: float) -> Votes:
    """Every day, all day: as many sessions as there are days."""
    lied = _lied(votes[theirs], size_m)
    _, first = np.unique(lied[["surface_id", "voter"]], return_index=True)
    days = []
    for day in range(21):
        one = lied[first].copy()
        one["session"] = street.today - 1 - day
        days.append(one)
    return merge_votes(votes[~theirs], *days)


def _sybils(street: Street, votes: Votes, theirs: Flags, rng: Generator, *, size_m: float) -> Votes:
    """As many new names instead, which nobody has seen elsewhere."""
    lied = _lied(votes[theirs], size_m)
    lied["voter"] = lied["voter"] ^ 0x5A5A5A5A5A5A
    return merge_votes(votes, lied)


def _lately(
    street: Street, votes: Votes, theirs: Flags, rng: Generator, *, size_m: float, days: int
) -> Votes:
    """Each of them once, in the last few days, when the others are few too."""
    lied = _lied(votes[theirs], size_m)
    _, first = np.unique(lied[["surface_id", "voter"]], return_index=True)
    lied = lied[first]
    lied["session"] = street.today - 1 - rng.integers(0, days, len(lied))
    return merge_votes(votes[~theirs], lied)


LIES: dict[str, Lie] = {
    "25 cm": partial(_steady, size_m=0.25),
    "10 cm": partial(_steady, size_m=0.10),
    "6 cm": partial(_steady, size_m=0.06),
    "4 cm": partial(_steady, size_m=0.04),
    "5 cm where the map is off": partial(_against_the_map, size_m=0.05),
    "5 cm, every day": partial(_daily, size_m=0.05),
    "5 cm, new names": partial(_sybils, size_m=0.05),
    "5 cm, in the last three days": partial(_lately, size_m=0.05, days=3),
    "5 cm, in the last two days": partial(_lately, size_m=0.05, days=2),
    "10 cm, in the last two days": partial(_lately, size_m=0.10, days=2),
}


def attacked(run: Run, seed: int, shares: tuple[float, ...] = SHARES) -> list[dict[str, Any]]:
    """Each lie by each share of the street's vehicles."""
    rng = np.random.default_rng(seed)
    street = street_of(run)
    on_street = np.isin(run.votes["surface_id"], street.surface_id)
    row = run.fusion.neighbourhood.rows_of(street.surface_id)
    true_m = run.true_m[row]
    before = _of_street(run.decide(run.votes), street)
    voters = np.unique(run.votes["voter"][on_street])
    names = np.array([run.fusion.voter_of(f"car{n:05d}") for n in range(int(run.record.vehicle.max()) + 1)])
    everyone = np.ones(len(run.deviation_m), bool)
    mean_m, mean_se_m, _ = _means(run, everyone)
    mean_before = np.abs(mean_m[row]) - 3.3 * mean_se_m[row] > THRESHOLD_M
    rows = []
    for share in shares:
        liars = rng.permutation(voters)[: round(share * len(voters))]
        theirs = on_street & np.isin(run.votes["voter"], liars)
        for name, lie in LIES.items():
            votes = lie(street, run.votes, theirs, rng)
            decisions = run.decide(votes)
            after = _of_street(decisions, street)
            new = after["publish"] & ~before["publish"]
            error_m = np.abs(after["offset_m"] - true_m)
            bad = new & ((np.abs(true_m) < THRESHOLD_M) | (error_m > np.abs(true_m)))
            mean = {"mean_theirs": 0}
            if name in ("25 cm", "10 cm", "6 cm", "4 cm"):
                size_m = 0.01 * float(name.split()[0])
                by_record = np.isin(names[run.record.vehicle], liars)
                by_record &= np.isin(run.record.observations["surface_id"], street.surface_id)
                mean_m, mean_se_m, _ = _means(run, everyone, size_m * by_record)
                mean_new = (np.abs(mean_m[row]) - 3.3 * mean_se_m[row] > THRESHOLD_M) & ~mean_before
                mean_off_m = np.abs(mean_m[row] - true_m)
                mean["mean_theirs"] = int(
                    (mean_new & ((np.abs(true_m) < THRESHOLD_M) | (mean_off_m > np.abs(true_m)))).sum()
                )
            rows.append(
                {
                    "share": share,
                    "lie": name,
                    "surfaces": len(street.surface_id),
                    "theirs": int(bad.sum()),
                    "lost": int((before["publish"] & ~after["publish"]).sum()),
                    "held": int((after["hold"] & ~before["hold"]).sum()),
                    "moved_mm": _rms_mm(after["offset_m"] - before["offset_m"]),
                    **mean,
                }
            )
    return rows


def _of_street(decisions: Decisions, street: Street) -> dict[str, Any]:
    rows = decisions.surfaces[np.searchsorted(decisions.surfaces["surface_id"], street.surface_id)]
    return {
        "publish": np.isin(rows["surface_id"], decisions.of("publish")["surface_id"]),
        "hold": np.isin(rows["surface_id"], decisions.of("hold")["surface_id"]),
        "offset_m": rows["offset_m"],
    }


def changes_under_way(run: Run, by_m: float = 0.08, on_day: int = 11) -> dict[str, Any]:
    """A street that is resurfaced on a day: how many days later its surfaces are published, with all votes before."""
    street = street_of(run)
    begin = street.today - 21 + on_day
    on_street = np.isin(run.votes["surface_id"], street.surface_id)
    row = run.fusion.neighbourhood.rows_of(street.surface_id)
    upward = np.where(run.true_m[row] >= 0.0, by_m, -by_m)
    later = on_street & (run.votes["session"] >= begin)
    votes = run.votes.copy()
    votes[later] = _lied(votes[later], upward[np.searchsorted(street.surface_id, votes["surface_id"][later])])
    seen: NDArray[np.int64] = np.full(len(street.surface_id), -1)
    between = np.zeros(len(seen), bool)
    for day in range(on_day, 22):
        so_far = votes[votes["session"] < street.today - 21 + day]
        if len(so_far) == 0:
            continue
        decisions = run.decide(so_far, run.world.start_ns + day * DAY_NS)
        new = np.isin(street.surface_id, decisions.of("publish")["surface_id"])
        known = np.searchsorted(decisions.surfaces["surface_id"], street.surface_id)
        rows = decisions.surfaces[np.minimum(known, len(decisions.surfaces) - 1)]
        right = np.abs(rows["offset_m"] - run.true_m[row] - upward) < WRONG_M
        neither = new & ~right & (np.abs(rows["offset_m"] - run.true_m[row]) > WRONG_M)
        between |= neither
        seen[new & right & (seen < 0)] = day - on_day
    return {
        "surfaces": len(seen),
        "seen": int((seen >= 0).sum()),
        "between": int(between.sum()),
        "days": sorted(seen.tolist()),
    }


def _rms_mm(x: Floats) -> float:
    return 1e3 * float(np.sqrt(np.mean(x**2))) if len(x) else 0.0


def _quantile_mm(x: Floats, q: float) -> float:
    return 1e3 * float(np.quantile(x, q)) if len(x) else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--json")
    arguments = parser.parse_args()
    every = []
    for seed in tqdm(arguments.seeds, disable=None):
        run = run_of(seed)
        every.append(
            {
                "seed": seed,
                "honest": [honest(run, n) for n in FLEETS],
                "attacked": attacked(run, seed),
                "under_way": changes_under_way(run),
            }
        )
        _print(every[-1:])
    if len(every) > 1:
        print(f"\nall {len(every)} seeds")
        _print(every)
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(every, file, indent=1)


def _print(every: list[dict[str, Any]]) -> None:
    """Counts are sums, sizes root mean squares over the seeds, floors the worst."""
    print("seeds", " ".join(str(one["seed"]) for one in every))
    counts = ("surfaces", "large_changes", "ready", "missed", "published", "false", "published_off", "held", "alarms",
              "mean_published", "mean_false", "mean_missed")  # fmt: skip
    for k, size in enumerate(FLEETS):
        rows = [one["honest"][k] for one in every]
        line = {name: sum(row[name] for row in rows) for name in counts}
        for name in ("rmse_unchanged_mm", "mean_rmse_unchanged_mm", "rmse_changed_mm", "error_over_se"):
            line[name] = round(float(np.sqrt(np.mean([row[name] ** 2 for row in rows]))), 2)
        for name in ("rmse_unchanged_mm", "floor_median_mm", "floor_p95_mm", "error_p99_mm"):
            line[f"worst_{name}"] = round(max(row[name] for row in rows), 2)
        why: Counter[str] = Counter()
        for row in rows:
            why.update(row["missed_why"])
        print(f"{size} vehicles:", " ".join(f"{name}={value}" for name, value in line.items()), dict(why))
    for k, one in enumerate(every[0]["attacked"]):
        rows = [each["attacked"][k] for each in every]
        line = {
            name: sum(row[name] for row in rows)
            for name in ("surfaces", "theirs", "lost", "held", "mean_theirs")
        }
        moved = max(row["moved_mm"] for row in rows)
        words = " ".join(f"{name}={value}" for name, value in line.items())
        print(f"{one['share']:.0%} lie {one['lie']}: {words} moved_mm={moved:.1f}")
    for each in every:
        print("resurfaced on a day:", each["under_way"])


if __name__ == "__main__":
    main()
