"""A million malformed messages at full speed: `PYTHONPATH=tests python -m hostile.run` (`make hostile`).

A live vehicle drives for half a minute alone, then with the peer until it has sent all, then alone again. Exit code
1 where a service ends, a wrong fix is confirmed, fewer right ones are than alone, memory grows beyond what queues may
hold, or a service is busier five seconds after the peer than it was before.
"""

from __future__ import annotations

import argparse
import json
import secrets
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from camber.schemas.channels import SERVICES
from camber.schemas.integrity import Verdict
from soak.readings import Reading, read
from support.live_drive import TRUSTED
from support.live_vehicle import LiveVehicle, Witness, driving
from support.running import free_endpoint, started

ALONE_S = 30.0
RECOVERY_S = 5.0
LEAST_SHARE = 0.95
"""Of the share of right fixes that are confirmed alone; so much differs between two stretches of the way."""
LEAST_RATE = 0.90
"""Of right fixes that are confirmed a second: what is refused because too much came at once is not judged."""
MOST_MB = 60.0
LESS_CALM = 0.10
"""Of a processor: so much busier than before is not yet back to normal."""


@dataclass(frozen=True)
class Stretch:
    """What came of a stretch of the drive."""

    seconds: float
    verdict_counts: dict[str, int]
    right_confirmed: float
    """Of the right fixes that were judged."""
    right_confirmed_hz: float
    wrong_confirmed: int
    verdicts_hz: float
    cpu: dict[str, float]
    uss_mb: dict[str, float]


class Observed:
    """A vehicle, and stretches of its drive."""

    def __init__(self, vehicle: LiveVehicle, witness: Witness) -> None:
        self.vehicle, self.witness = vehicle, witness
        self._begin()

    def _begin(self) -> None:
        self.began_s, self.before = time.monotonic(), self.readings()

    def readings(self) -> dict[str, Reading]:
        now_s = time.monotonic()
        return {name: read(process.pid, now_s) for name, process in self.vehicle.running.items()}

    def stretch(self) -> Stretch:
        """From the last one to now."""
        now_s, after = time.monotonic(), self.readings()
        verdict_counts = self.witness.verdict_counts(self.began_s, now_s)
        verdicts_of_right = sum(n for (fix, _), n in verdict_counts.items() if fix == "right")
        right = sum(verdict_counts["right", trusted] for trusted in TRUSTED)
        seconds = now_s - self.began_s
        summary = Stretch(
            round(seconds, 1),
            {f"{fix}, {verdict}": n for (fix, verdict), n in sorted(verdict_counts.items())},
            round(right / max(verdicts_of_right, 1), 4),
            round(right / seconds, 2),
            self.witness.wrong_but_trusted(self.began_s, now_s).total(),
            round(len(self.witness.messages(Verdict, self.began_s, now_s)) / seconds, 2),
            {name: round((after[name].cpu_s - self.before[name].cpu_s) / seconds, 3) for name in after},
            {name: round(after[name].uss_mb, 1) for name in after},
        )
        self._begin()
        return summary


@dataclass(frozen=True)
class Attack:
    """The drive alone, with the peer and alone again; after how many seconds all services were as calm as before."""

    alone: Stretch
    during: Stretch
    after: Stretch
    calm_after_s: float
    sent: int
    """Messages, as the peer reports; 0 where it has failed."""
    ended: dict[str, str]


def attack(folder: Path, count: int, seed: int, rate_hz: float) -> Attack:
    vehicle = LiveVehicle(folder, free_endpoint(), services=SERVICES)
    with driving(vehicle, live=True) as witness:
        observed = Observed(vehicle, witness)
        time.sleep(ALONE_S)
        alone = observed.stretch()
        with started("-m", "hostile.peer", vehicle.endpoint, "demo", count, seed, rate_hz) as hostile:
            output, _ = hostile.communicate()
            print(f"peer: {output.splitlines()[-1]}")
            sent = 0 if hostile.returncode else json.loads(output.splitlines()[-1])["sent"]
        during = observed.stretch()
        calm_after_s = calm(observed, alone)
        time.sleep(ALONE_S)
        return Attack(alone, during, observed.stretch(), calm_after_s, sent, vehicle.ended())


def as_good(stretch: Stretch, alone: Stretch) -> bool:
    """Of the fixes that are judged so many are passed on as alone, and of all nearly so many."""
    return (
        stretch.right_confirmed >= LEAST_SHARE * alone.right_confirmed
        and stretch.right_confirmed_hz >= LEAST_RATE * alone.right_confirmed_hz
    )


def calm(observed: Observed, alone: Stretch, limit_s: float = 60.0) -> float:
    """Seconds until, for a second, no service is busier than it was alone."""
    began_s = time.monotonic()
    while time.monotonic() - began_s < limit_s:
        time.sleep(1.0)
        now = observed.stretch()
        if all(now.cpu[name] <= alone.cpu[name] + LESS_CALM for name in now.cpu):
            return round(time.monotonic() - began_s - 1.0, 1)
    return limit_s


def main() -> int:
    """0: verdicts and services are as without the peer."""
    parser = argparse.ArgumentParser(
        prog="python -m hostile.run",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=1_000_000, help="default a million")
    parser.add_argument("--rate", type=float, default=0.0, help="messages a second; default: at full speed")
    parser.add_argument("--seed", type=int, help="default: another one each time, printed")
    parser.add_argument("--out", type=Path, default=Path("out/hostile"))
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # and with it what it has started
    seed = secrets.randbits(32) if args.seed is None else args.seed
    print(f"hostile: {args.count} messages, seed {seed}", flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    came = attack(Path(tempfile.mkdtemp(prefix="run-", dir=args.out)), args.count, seed, args.rate)
    (args.out / "hostile.json").write_text(json.dumps(came, default=vars, indent=1))
    for name, stretch in (("alone", came.alone), ("during", came.during), ("after", came.after)):
        print(
            f"{name:7} {stretch.seconds:6.1f} s  {stretch.verdicts_hz:5.2f} verdicts/s  right confirmed"
            f" {100 * stretch.right_confirmed:5.1f} %, {stretch.right_confirmed_hz:.2f} a second"
            f"  wrong confirmed {stretch.wrong_confirmed}"
        )
        print(f"        processors {stretch.cpu}")
        print(f"        USS MB     {stretch.uss_mb}")
    print(f"calm after {came.calm_after_s} s")
    grown = {name: came.after.uss_mb[name] - came.alone.uss_mb[name] for name in came.after.uss_mb}
    checks = {
        f"ended: {came.ended}": not came.ended,
        "a wrong fix was confirmed": not (came.during.wrong_confirmed or came.after.wrong_confirmed),
        "the peer did not say all": came.sent == args.count,
        "fewer right fixes were confirmed": as_good(came.during, came.alone),
        "fewer right fixes are confirmed afterwards": as_good(came.after, came.alone),
        f"busy after {RECOVERY_S:g} s still": came.calm_after_s <= RECOVERY_S,
        f"memory grew: {grown}": max(grown.values()) <= MOST_MB,
    }
    wrong = [text for text, right in checks.items() if not right]
    print("hostile: " + ("; ".join(wrong) or "holds"))
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
