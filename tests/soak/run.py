"""All services on a drive without end, in real time: `PYTHONPATH=tests python -m soak.run --minutes 120` (`make soak`).

Every ten seconds it reads what each process holds, and it receives every fix and every verdict as a consumer does. Exit
code 1 where, after the warm-up,
  - memory (USS) grows by more than 2 %, and by half a megabyte: all the time, in a step that stays, or late;
  - file descriptors or threads grow and stay;
  - verdicts come later than 20 ms after their fix, the 99th percentile of any five minutes, or a hundredth never;
  - a wrong fix is confirmed, a service ends, or no right fix is confirmed in any five minutes.

A run below half an hour cannot see a slow leak, and says so: it judges growth beyond 4 MB, and not the latency, which
is then the machine's load; `--judge-latency` judges it all the same.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camber.schemas.channels import SERVICES
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from soak.readings import Reading, busy_s, growth, lasting_growth, read
from support.live_drive import TRUSTED
from support.live_vehicle import LiveVehicle, Witness, driving
from support.running import free_endpoint

GROWTH_SHARE = 0.02
LEAST_MB, LEAST_OF_SHORT_MB = 0.5, 4.0
"""The judge compares over windows of up to 300 s, which fill during a short run: its memory grew by 2.6 MB from the
second to the fifth minute and by 0.7 MB from the sixth to the thirtieth (`make soak SOAK_MINUTES=50`)."""
POOL_OF_SHORT = 2
"""Threads that a pool of the uploader, which makes them when it first needs them, may still add in a short run."""
LATENCY_MS = 20.0
UNJUDGED_SHARE = 0.05
"""Of the fixes, in a short run too; where latency is judged, a hundredth without a verdict is too many."""
WINDOW_S = 300.0
EVERY_S = 10.0
LONG_MINUTES = 30.0


@dataclass(frozen=True)
class Window:
    """Five minutes: latency of the verdicts, what was confirmed, and how busy the machine was in all.

    A fix without a verdict counts as one that is late for ever.
    """

    from_s: float
    until_s: float
    fixes: int
    unjudged: int
    p50_ms: float
    p99_ms: float
    largest_ms: float
    confirmed_right: int
    confirmed_wrong: int
    busy_processors: float


def windows(
    witness: Witness, began_s: float, until_s: float, busy: list[tuple[float, float]]
) -> list[Window]:
    """All of the time, the last one with what remains beyond it; of fixes up to a second before the end."""
    judged_s: dict[int, float] = {}
    for item in witness.since(began_s):
        if isinstance(item.message, Verdict) and item.message.fix_id is not None:
            judged_s.setdefault(item.message.fix_id, item.at_s)
    result: list[Window] = []
    at_s = began_s
    while at_s < until_s:
        end_s = at_s + WINDOW_S if until_s - at_s >= 2.0 * WINDOW_S else until_s
        fixes = [i for i in witness.since(at_s, min(end_s, until_s - 1.0)) if isinstance(i.message, Fix)]
        ms = [1e3 * (judged_s.get(item.message.fix_id, np.inf) - item.at_s) for item in fixes]
        p50, p99, largest = np.percentile(ms, [50, 99, 100], method="higher") if ms else (np.inf,) * 3
        verdict_counts = witness.verdict_counts(at_s, end_s)
        right = sum(verdict_counts["right", trusted] for trusted in TRUSTED)
        spent = [busy_of for at, busy_of in busy if at_s <= at < end_s]
        load = (spent[-1] - spent[0]) / (EVERY_S * (len(spent) - 1)) if len(spent) > 1 else float("nan")
        result.append(
            Window(
                round(at_s - began_s, 1),
                round(end_s - began_s, 1),
                len(ms),
                int(np.isinf(ms).sum()),
                round(float(p50), 2),
                round(float(p99), 2),
                round(float(largest), 2),
                right,
                witness.wrong_but_trusted(at_s, end_s).total(),
                round(load, 2),
            )
        )
        at_s = end_s
    return result


def drift(readings: list[Reading]) -> dict[str, float]:
    """Growth of one process over the readings that are judged."""
    at_s, uss = [r.at_s for r in readings], [r.uss_mb for r in readings]
    return {
        "uss_mb": round(float(np.median(uss)), 2),
        "pss_mb": round(float(np.median([r.pss_mb for r in readings])), 2),
        "growth_mb": round(growth(at_s, uss), 3),
        "growth_percent": round(100.0 * growth(at_s, uss) / float(np.median(uss)), 3),
        "descriptors": readings[-1].descriptors,
        "more_descriptors": lasting_growth([r.descriptors for r in readings]),
        "threads": readings[-1].threads,
        "more_threads": lasting_growth([r.threads for r in readings]),
        "cpu_percent": round(
            100.0 * (readings[-1].cpu_s - readings[0].cpu_s) / max(at_s[-1] - at_s[0], 1e-9), 2
        ),
    }


def complaints(
    drifts: dict[str, dict[str, float]],
    seen: list[Window],
    *,
    least_mb: float,
    latency: bool,
    more_threads: int = 0,
) -> list[str]:
    """What of it must not be."""
    problems = []
    for name, of in drifts.items():
        if of["growth_mb"] > max(GROWTH_SHARE * of["uss_mb"], least_mb):
            problems.append(f"{name}: memory grew by {of['growth_mb']:.2f} MB ({of['growth_percent']:.1f} %)")
        for what, most in (("descriptors", 0), ("threads", more_threads)):
            if of[f"more_{what}"] > most:
                problems.append(f"{name}: {of[f'more_{what}']:.0f} more {what} than at the begin")
    for window in seen:
        where = f"{window.from_s:.0f} to {window.until_s:.0f} s"
        if window.confirmed_wrong:
            problems.append(f"{where}: {window.confirmed_wrong} wrong fixes confirmed")
        if window.unjudged > UNJUDGED_SHARE * window.fixes:
            problems.append(f"{where}: {window.unjudged} of {window.fixes} fixes without a verdict")
        if not window.confirmed_right:
            problems.append(f"{where}: nothing confirmed")
        if latency and not window.p99_ms <= LATENCY_MS:
            problems.append(
                f"{where}: p99 of verdicts {window.p99_ms:.1f} ms, {window.busy_processors:.1f} processors busy"
            )
    return problems


def table(drifts: dict[str, dict[str, float]], seen: list[Window]) -> str:
    """As text."""
    lines = [f"{'process':16}{'USS MB':>9}{'PSS MB':>9}{'growth MB':>11}{'%':>8}{'fds':>6}{'+':>4}{'threads':>9}{'+':>4}{'CPU %':>8}"]  # fmt: skip  # noqa: E501
    lines += [
        f"{name:16}{of['uss_mb']:9.1f}{of['pss_mb']:9.1f}{of['growth_mb']:11.2f}{of['growth_percent']:8.2f}"
        f"{of['descriptors']:6.0f}{of['more_descriptors']:4.0f}{of['threads']:9.0f}{of['more_threads']:4.0f}"
        f"{of['cpu_percent']:8.1f}"
        for name, of in drifts.items()
    ]
    lines.append(
        f"{'seconds':16}{'fixes':>9}{'p50 ms':>9}{'p99 ms':>9}{'most ms':>9}{'right':>8}{'wrong':>7}{'busy':>7}"
    )
    lines += [
        f"{f'{w.from_s:.0f} to {w.until_s:.0f}':16}{w.fixes:9}{w.p50_ms:9.1f}{w.p99_ms:9.1f}{w.largest_ms:9.1f}"
        f"{w.confirmed_right:8}{w.confirmed_wrong:7}{w.busy_processors:7.2f}"
        for w in seen
    ]
    return "\n".join(lines)


def soak(folder: Path, minutes: float, warm_up_minutes: float) -> dict[str, Any]:
    """Readings of all processes and the windows of a run."""
    vehicle = LiveVehicle(folder, free_endpoint(), services=SERVICES)
    readings: dict[str, list[Reading]] = defaultdict(list)
    busy: list[tuple[float, float]] = []
    with driving(vehicle) as witness:
        began_s = time.monotonic()
        next_s, reported_s = began_s, began_s
        while (now_s := time.monotonic()) - began_s < 60.0 * minutes and not vehicle.ended():
            for name, process in vehicle.running.items():
                readings[name].append(read(process.pid, now_s - began_s))
            busy.append((now_s, busy_s()))
            if now_s - reported_s >= WINDOW_S:
                reported_s = now_s
                print(
                    f"{(now_s - began_s) / 60.0:.0f} min: {dict(witness.verdict_counts(now_s - WINDOW_S))}",
                    flush=True,
                )
            next_s += EVERY_S
            time.sleep(max(next_s - time.monotonic(), 0.0))
        until_s, ended = time.monotonic(), vehicle.ended()
        judged_from_s = 60.0 * warm_up_minutes
        late = {name: [r for r in of if r.at_s >= judged_from_s] for name, of in readings.items()}
        return {
            "minutes": minutes,
            "warm_up_minutes": warm_up_minutes,
            "ended": ended,
            "drifts": {name: drift(of) for name, of in late.items() if len(of) > 2},
            "windows": [asdict(w) for w in windows(witness, began_s, until_s, busy)],
            "readings": {name: [asdict(r) for r in of] for name, of in readings.items()},
        }


def main() -> int:
    """0: it stands, 1: something must not be."""
    parser = argparse.ArgumentParser(
        prog="python -m soak.run", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=120.0, help="default 120")
    parser.add_argument("--warm-up", type=float, metavar="MINUTES", help="default: a third, at most 15")
    parser.add_argument("--judge-latency", action="store_true", help="in a short run too")
    parser.add_argument(
        "--out", type=Path, default=Path("out/soak"), help="for soak.json and the services' logs"
    )
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # and with it what it has started
    warm_up = min(args.minutes / 3.0, 15.0) if args.warm_up is None else args.warm_up
    args.out.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="run-", dir=args.out))
    came = soak(folder, args.minutes, warm_up)
    long = args.minutes >= LONG_MINUTES
    least_mb = LEAST_MB if long else LEAST_OF_SHORT_MB
    seen = [Window(**window) for window in came["windows"]]
    wrong = [f"{name} has ended: {text[-300:]}" for name, text in came["ended"].items()]
    wrong += complaints(
        came["drifts"],
        seen,
        least_mb=least_mb,
        latency=long or args.judge_latency,
        more_threads=0 if long else POOL_OF_SHORT,
    )
    (args.out / "soak.json").write_text(json.dumps({**came, "complaints": wrong}, indent=1))
    print(table(came["drifts"], seen))
    judged_h = (args.minutes - warm_up) / 60.0
    print(f"soak: {args.minutes:g} minutes, judged after {warm_up:g}; services' logs in {folder}")
    if not long:
        print(
            f"soak: too short for a slow leak (sees {least_mb / judged_h:.0f} MB/h) and not judging latency"
        )
    print("soak: " + ("; ".join(wrong) or "stands"))
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
