"""Attack all decoders, or some, for a time: `PYTHONPATH=tests python -m fuzz.run --minutes 10` (`make fuzz`).

Each in a process of its own, as many at once as there are processors. What breaks one is written to a file beside the
seed that made it.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import secrets
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fuzz.decoders import DECODERS
from fuzz.target import Broken, attack

_NAMES = [target.name for target in DECODERS]
_PATIENCE_S = 120.0


def main() -> int:
    """Exit code 1 where a decoder did not hold."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.run", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="for all together; default 10")
    parser.add_argument("--seed", type=int, help="default: another one each time, printed")
    parser.add_argument("--only", action="append", choices=_NAMES, help="repeatable; default: all")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="for input that breaks something")
    args = parser.parse_args()
    names = args.only or _NAMES
    at_once = min(len(names), os.cpu_count() or 1)
    seconds = 60.0 * args.minutes * at_once / len(names)
    seed = secrets.randbits(32) if args.seed is None else args.seed
    if len(names) == 1:
        return _attack(names[0], seconds, seed, args.out)

    def attacked(name: str) -> int:
        command = [sys.executable, "-m", "fuzz.run", "--only", name, "--minutes", str(seconds / 60.0)]
        command += ["--seed", str(seed), "--out", str(args.out)]
        return subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode

    with ThreadPoolExecutor(at_once) as processes:
        codes = dict(zip(names, processes.map(attacked, names), strict=True))
    broken = [f"{name} (exit code {code})" for name, code in codes.items() if code != 0]
    result = f"broken: {', '.join(broken)}" if broken else "all hold"
    print(f"fuzz: {len(names)} decoders, seed {seed}: {result}")
    return 1 if broken else 0


def _attack(name: str, seconds: float, seed: int, out: Path) -> int:
    (target,) = (target for target in DECODERS if target.name == name)
    print(f"fuzz: {name}, {seconds:.0f} s, seed {seed}", flush=True)
    warnings.simplefilter("error")
    # One that hangs says where.
    faulthandler.dump_traceback_later(seconds + _PATIENCE_S, exit=True)
    try:
        count = attack(target, seconds, seed)
    except Broken as broken:
        out.mkdir(parents=True, exist_ok=True)
        file = out / f"{name}-{seed}.bin"
        file.write_bytes(broken.data)
        print(f"fuzz: {name}: {broken}\n    {len(broken.data)} bytes in {file}", flush=True)
        return 1
    print(f"fuzz: {name}: {count} inputs, all held", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
