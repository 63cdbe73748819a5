"""How far off the localizer is in simulated drives with a LiDAR, and whether it says so.

PYTHONPATH=tests python -m support.localization_statistics city --seeds 1 2 3 --drives 5
PYTHONPATH=tests python -m support.localization_statistics tunnel-950s --seeds 1 2 3 --between 200 1100 --given 0.1
PYTHONPATH=tests python -m support.localization_statistics city --seeds 1 2 3 --drives 10 --alone
PYTHONPATH=tests python -m support.localization_statistics overpass --seeds 1 2 3 --whole [--route ramp] [--no-lidar]

Drives of --seconds at places evenly along the route, each from a pose that is given with σ 1 m and 2°; the first
--settling seconds are judged apart. --alone: the matcher by itself, each match from half a metre and two degrees off.
--keep: drives are simulated once and kept in a folder. Intervals are of a bootstrap that draws whole drives.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from camber.simulator.scene import Floats
from support.lidar_drives import route_duration_s
from support.localization_drives import Errors, Localized, kept_drive, localized, matched_alone

ELLIPSE_99 = 9.21
WRONG_M = 0.5
_RESAMPLED = 4000


class Asked(NamedTuple):
    """One drive of `seconds`, and what is to be done with it."""

    options: argparse.Namespace
    seed: int
    start_s: float
    seconds: float


def one(asked: Asked) -> Localized | Errors:
    """In this process."""
    options = asked.options
    drive = kept_drive(
        options.scenario,
        asked.seed,
        folder=options.keep,
        start_s=asked.start_s,
        duration_s=asked.seconds,
        every=options.every,
        **({} if options.beams == 32 else {"beams": options.beams}),
        **({} if options.route == "default" else {"route": options.route}),
    )
    if options.alone:
        return matched_alone(drive)
    return localized(drive, lidar=not options.no_lidar, given=options.given)


def share_and_interval(inside: Sequence[NDArray[np.bool_]]) -> dict[str, float]:
    """Share over all drives, the interval of 95 % when whole drives are drawn, and the chance of at least 99 %."""
    hits, counts = np.array([x.sum() for x in inside]), np.array([len(x) for x in inside])
    hits, counts = hits[counts > 0], counts[counts > 0]
    if not len(counts):
        return {}
    drawn = np.random.default_rng(1).integers(len(counts), size=(_RESAMPLED, len(counts)))
    shares = hits[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(shares, [0.025, 0.975])
    return {
        "in_ellipse_99": float(hits.sum() / counts.sum()),
        "from": float(low),
        "to": float(high),
        "at_least_99": float(np.mean(shares >= 0.99)),
    }


def figures(errors: Sequence[Errors]) -> dict[str, Any]:
    """Of several drives together."""
    off = np.concatenate([e.off for e in errors])
    covariance = np.concatenate([e.covariance for e in errors])
    if not len(off):
        return {}
    horizontal, sigmas = np.hypot(off[:, 0], off[:, 1]), np.sqrt(np.einsum("nii->ni", covariance))
    parts = {}
    for k, name in enumerate(("along", "left", "yaw")):
        scale = math.degrees(1.0) if k == 2 else 1.0
        good = np.isfinite(sigmas[:, k])
        if good.any():
            parts[name] = {
                "mean": float(scale * off[good, k].mean()),
                "rms": float(scale * np.sqrt((off[good, k] ** 2).mean())),
                "sigma_median": float(scale * np.median(sigmas[good, k])),
                "square_p50_p95_p99": _quantiles((off[good, k] / sigmas[good, k]) ** 2, 0.5, 0.95, 0.99),
            }
    return {
        "rows": len(off),
        "horizontal_p50_p95_max_m": _quantiles(horizontal, 0.5, 0.95, 1.0),
        "heading_p95_deg": math.degrees(float(np.quantile(np.abs(off[:, 2]), 0.95))),
        **share_and_interval([e.squared <= ELLIPSE_99 for e in errors]),
        **parts,
    }


def of_matches(errors: Sequence[Errors]) -> dict[str, Any]:
    """By status; those that say *converged* against what they claim."""
    words = Counter(word for e in errors for word in e.word)
    converged = [e.where(np.array([w == "converged" for w in e.word], bool)) for e in errors]
    vague = [
        e.where(np.array([w.startswith("ambiguous") for w in e.word], bool) & np.isfinite(e.off[:, 0]))
        for e in errors
    ]
    wrong = sum(int((e.horizontal_m > WRONG_M).sum()) for e in converged)
    return {
        "words": dict(words),
        "converged": figures(converged),
        "ambiguous": figures(vague),
        "converged_wrong": wrong,
    }


def of_poses(drives: Sequence[Localized], settling_s: float) -> dict[str, Any]:
    """Poses after the settling, matches, road levels and what a sweep costs."""
    sweeps = np.concatenate([d.sweep_s[2:] for d in drives])
    levels = np.concatenate([d.levels for d in drives])
    known = np.isfinite(levels[:, 0])
    elevation = np.concatenate([d.elevation_m for d in drives])
    elevation = np.abs(elevation[np.isfinite(elevation)])
    settled = [d.poses.since(settling_s) for d in drives]
    return {
        "poses": figures(settled),
        "settling": figures([d.poses.where(d.poses.seconds < settling_s) for d in drives]),
        "modes": dict(Counter(word for d in settled for word in d.word)),
        "level": {
            "wrong": int(sum(d.wrong_level.sum() for d in drives)),
            "other_name_at_a_seam": int((levels[known, 0] != levels[known, 1]).sum()),
            "true_levels": sorted({int(level) for level in levels[:, 1]}),
            "known_share": float(known.mean()),
            "elevation_p50_p95_max_m": _quantiles(elevation, 0.5, 0.95, 1.0) if len(elevation) else [],
        },
        "sweep_ms_p50_p95": _quantiles(1e3 * sweeps, 0.5, 0.95) if len(sweeps) else [],
        "issues": dict(sum((Counter(d.tally.issues) for d in drives), Counter())),
        **({"matches": of_matches([d.matches for d in drives])} if len(sweeps) else {}),
    }


def _quantiles(values: Floats, *shares: float) -> list[float]:
    return [float(x) for x in np.quantile(values, shares)]


def _line(result: Localized | Errors, settling_s: float) -> str:
    if isinstance(result, Errors):
        good = result.where(np.isfinite(result.off[:, 0]))
        return f"matches {len(result.word)} with a pose {len(good.off)} {_short(good)}"
    late = result.poses.since(settling_s)
    wrong = int(result.wrong_level.sum())
    words = Counter(word.split()[0] for word in result.matches.word)
    return f"{result.name}: {_short(late)} levels wrong {wrong} {dict(words)}"


def _short(errors: Errors) -> str:
    if not len(errors.off):
        return "nothing"
    p50, p95, most = _quantiles(errors.horizontal_m, 0.5, 0.95, 1.0)
    yaw = math.degrees(float(np.quantile(np.abs(errors.off[:, 2]), 0.95)))
    inside = float(np.mean(errors.squared <= ELLIPSE_99))
    return f"p50 {p50:.3f} p95 {p95:.3f} max {most:.3f} m, yaw p95 {yaw:.3f}°, inside {inside:.3f}"


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_rounded(v) for v in value]
    return round(value, 4) if isinstance(value, float) else value


def _asked(args: argparse.Namespace) -> list[Asked]:
    measured = []
    for seed in args.seeds:
        first_s, last_s = args.between or (3.0, math.inf)
        last_s = min(last_s, route_duration_s(args.scenario, seed, args.route))
        seconds = math.floor(last_s - 1.0) if args.whole else args.seconds
        starts = [0.0] if args.whole else np.linspace(first_s, last_s - seconds - 0.5, args.drives).tolist()
        measured += [Asked(args, seed, round(start_s, 1), seconds) for start_s in starts]
    return measured


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenario")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--drives", type=int, default=5, help="of each seed")
    parser.add_argument("--seconds", type=float, default=20.0, help="of a drive")
    parser.add_argument("--settling", type=float, default=5.0, help="seconds that are judged apart")
    parser.add_argument("--between", type=float, nargs=2, help="seconds of the route")
    parser.add_argument("--whole", action="store_true", help="the whole route as one drive of each seed")
    parser.add_argument("--beams", type=int, choices=(32, 64), default=32)
    parser.add_argument("--every", type=int, default=1, help="of the sweeps each n-th")
    parser.add_argument(
        "--given", type=float, default=1.0, help="error and σ of the given pose, of 1 m and 2°"
    )
    parser.add_argument("--alone", action="store_true", help="the matcher by itself")
    parser.add_argument("--no-lidar", action="store_true", help="no sweep is used")
    parser.add_argument("--route", default="default", help="one of the scenario's")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder of simulated drives")
    args = parser.parse_args()
    asked, results = _asked(args), []
    with multiprocessing.get_context("spawn").Pool(args.processes, maxtasksperchild=20) as pool:
        for result in tqdm(pool.imap(one, asked), total=len(asked)):
            results.append(result)
            tqdm.write(_line(result, args.settling))
    if args.alone:
        together = of_matches([r for r in results if isinstance(r, Errors)])
    else:
        together = of_poses([r for r in results if isinstance(r, Localized)], args.settling)
    print(
        json.dumps(_rounded({"asked": vars(args) | {"keep": None}, **together}), indent=1, ensure_ascii=False)
    )


if __name__ == "__main__":
    main()
