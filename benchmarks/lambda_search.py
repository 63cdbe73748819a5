"""LAMBDA beside the C implementation in RTKLIB, on the same float ambiguities.

The peer is `lambda()` of RTKLIB's `src/lambda.c`, compiled here with `gcc -O2` out of Debian's source package (in the
folder that RTKLIB_SOURCE names, or fetched by `apt-get source`), or the one inside the wheel `pyrtklib5`. Nothing of
either is part of Camber. Without both the figures are left out, and a line says so.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from figure import Figure, least_s, lower
from numpy.typing import NDArray

from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED, FixCriteria, resolve
from support.ambiguity_models import drawn, float_covariance

Floats = NDArray[np.float64]
Prepare = Callable[[Floats, Floats], tuple[Callable[[], object], Floats]]
"""Float ambiguities and covariance to what solves them, to be timed, and where the best integers are then."""

SEED = 4
EPOCHS = 60
ROUNDS = 9
# n, satellites, bands: double differences of one epoch, one reference satellite for all.
SIZES = ((10, 11, 1), (10, 6, 2), (20, 21, 1), (20, 11, 2), (30, 16, 2), (30, 11, 3))


def epochs(satellites: int, bands: int) -> list[tuple[Floats, Floats]]:
    """Float ambiguities and covariances of moving receivers under different skies: code of 0.5 m, phase of 3 mm."""
    random = np.random.default_rng((SEED, satellites, bands))
    cases = []
    for _ in range(EPOCHS):
        covariance = float_covariance(random, satellites, bands)
        whole = np.rint(random.uniform(-1e6, 1e6, covariance.shape[0]))
        cases.append((drawn(random, covariance, 1)[0] + whole, covariance))
    return cases


def rtklib(folder: Path) -> tuple[Prepare, str] | None:
    """RTKLIB's `lambda` and where it is from, or None."""
    library, name = _compiled_in(folder), "RTKLIB's lambda.c, gcc -O2"
    if library is None:
        library, name = _of_wheel(), "RTKLIB's lambda.c, of the wheel pyrtklib5"
    if library is None:
        return None
    function = ctypes.CDLL(str(library))["lambda"]
    function.argtypes = [ctypes.c_int, ctypes.c_int, *[ctypes.c_void_p] * 4]

    def prepare(floats: Floats, covariance: Floats) -> tuple[Callable[[], object], Floats]:
        best, norms = np.full((2, floats.size), np.nan), np.empty(2)
        addresses = [array.ctypes.data for array in (floats, covariance, best, norms)]
        return lambda: function(floats.size, 2, *addresses), best[0]

    return prepare, name


def _compiled_in(folder: Path) -> Path | None:
    if not shutil.which("gcc"):
        return None
    source = os.environ.get("RTKLIB_SOURCE")
    if source is None:
        if not shutil.which("apt-get"):
            return None
        fetched = subprocess.run(
            ["apt-get", "source", "rtklib"],
            cwd=folder,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=120,
        )
        unpacked = sorted(folder.glob("rtklib*/src/lambda.c"))
        if fetched.returncode or not unpacked:
            return None
        source = str(unpacked[0].parents[1])
    library = folder / "lambda.so"
    files = [str(Path(source) / "src" / name) for name in ("lambda.c", "rtkcmn.c")]
    options = ["-O2", "-w", "-shared", "-fPIC", "-DTRACE"]
    built = subprocess.run(
        ["gcc", *options, *files, "-o", str(library), "-lm", "-lpthread"],
        stdin=subprocess.DEVNULL,
        timeout=120,
    )
    return None if built.returncode else library


def _of_wheel() -> Path | None:
    spec = importlib.util.find_spec("pyrtklib5")
    if spec is None or spec.origin is None:
        return None
    return next(iter(sorted(Path(spec.origin).parent.glob("*.so"))), None)


_CRITERIA = FixCriteria(
    least_ratio=0.0,
    least_success_rate=0.0,
    least_fixed=1,
    partial=False,
    failure_rate=0.0,
    most_nodes=100_000,
)


def camber(floats: Floats, covariance: Floats) -> tuple[Callable[[], object], Floats]:
    resolved = resolve(floats, covariance, _CRITERIA)
    assert resolved.status == RESOLVED
    return lambda: resolve(floats, covariance, _CRITERIA), resolved.ambiguities


def figures() -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        peer = rtklib(Path(folder))
        if peer is None:
            print("LAMBDA: no RTKLIB source package with gcc, and no pyrtklib5: left out", file=sys.stderr)
            return []
        theirs, peer_name = peer
        figures = []
        for count, satellites, bands in SIZES:
            times = []
            for floats, covariance in epochs(satellites, bands):
                solve, integers = camber(floats, covariance)
                solve_peer, peers = theirs(floats, covariance)
                times.append(
                    [
                        1e6 * least_s(call, rounds=ROUNDS, clock=time.perf_counter)
                        for call in (solve, solve_peer)
                    ]
                )
                # NaN: RTKLIB gave up after 10,000 nodes.
                assert np.isnan(peers).all() or (np.rint(peers) == integers).all()
            ours_us, peer_us = (statistics.median(column) for column in zip(*times, strict=True))
            name = f"LAMBDA, {count} ambiguities on {bands} band{'s' if bands > 1 else ''}, seed {SEED}"
            figures.append(lower(name, "µs", ours_us, peer_us, peer_name))
        return figures
