"""Makes the table of `ratio_threshold_table` by Monte Carlo: `python benchmarks/ratio_threshold_table.py`.

For each number of ambiguities and each bootstrapped failure rate: float ambiguities of random geometries, or the most
precise of more decorrelated ones, their covariance scaled until bootstrapping fails just so often; then the ratio that
the wrong among the nearest integers exceed as often as the failure rate allows. Of all geometries the highest ratio
stands in the table. Prints Python. A quarter of an hour on one core.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from camber.compiled.decorator import compiled
from camber.gnss.ambiguity.ambiguity_resolution import bootstrapped_log_success
from camber.gnss.ambiguity.lambda_decorrelation import decorrelated
from camber.gnss.ambiguity.lambda_search import nearest_integers
from support.ambiguity_models import float_covariance

Floats = NDArray[np.float64]

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25)
BOOTSTRAPPED_FAILURE = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
FAILURE_RATES = (0.001, 0.01)
_MOST_NODES = 200_000
_MANY, _FAILURE_OF_MANY, _GEOMETRIES_OF_MANY, _SAMPLES_OF_MANY = 20, 0.02, 6, 20_000
"""Beyond so many ambiguities models that fail so often take 10,000 nodes a search: fewer are made, of the better."""


def geometry(random: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """U (count, count) and D (count,) of a random model; every second one is a part of a larger one."""
    bands = int(random.choice([bands for bands in (1, 2, 3) if count <= 24 * bands]))
    exact = count % bands == 0 and count // bands >= 4
    least = max(4, math.ceil(count / bands))
    differences = (
        count // bands if exact and random.random() < 0.5 else int(random.integers(least, least + 8))
    )
    covariance = float_covariance(
        random,
        differences + 1,
        bands,
        code_sigma_m=float(np.exp(random.uniform(np.log(0.2), np.log(3.0)))),
        phase_sigma_m=float(random.uniform(0.002, 0.006)),
    )
    definite, (upper, variances, _) = decorrelated(covariance)
    assert definite
    return upper[-count:, -count:].copy(), variances[-count:].copy()


def scaled(variances: Floats, failure: float) -> Floats:
    """The variances times what makes bootstrapping of all of them fail so often."""
    low, high = 1e-9, 1e9
    for _ in range(200):
        middle = math.sqrt(low * high)
        if -math.expm1(bootstrapped_log_success(middle * variances, variances.size)) < failure:
            low = middle
        else:
            high = middle
    return low * variances


@compiled
def wrong_ratios(upper: Floats, variances: Floats, normal: Floats) -> Floats:
    """Ratios of second-best and best squared norm where the best is wrong, 0 where it is right; samples (count, n)."""
    samples, count = normal.shape
    ratios = np.zeros(samples)
    floats = np.empty(count)
    for sample in range(samples):
        for row in range(count):
            floats[row] = 0.0
            for column in range(row, count):
                floats[row] += upper[row, column] * np.sqrt(variances[column]) * normal[sample, column]
        known, vectors, norms, _ = nearest_integers(upper, variances, floats, 2, _MOST_NODES)
        if known < 2:
            # Not known to be right: counted as wrong and sure of itself.
            ratios[sample] = np.inf
            continue
        for place in range(count):
            if vectors[0, place] != 0.0:
                ratios[sample] = norms[1] / norms[0]
    return ratios


def ratio_needed(ratios: Floats, failure_rate: float) -> float:
    """The least ratio that no more than that share of all samples exceeds wrongly."""
    allowed = math.floor(failure_rate * ratios.size)
    return max(1.0, float(np.sort(ratios)[-1 - allowed]))


def sampled(random: np.random.Generator, upper: Floats, variances: Floats, samples: int) -> Floats:
    """`wrong_ratios` of so many samples, a tenth at a time."""
    count = variances.size
    parts = [
        wrong_ratios(upper, variances, random.standard_normal((samples // 10, count))) for _ in range(10)
    ]
    return np.concatenate(parts)


def table(seed: int, geometries: int, samples: int) -> Floats:
    """Ratios (failure rates, counts, bootstrapped failure rates), infinite where none were made."""
    random = np.random.default_rng(seed)
    needed = np.ones((len(FAILURE_RATES), len(COUNTS), len(BOOTSTRAPPED_FAILURE)))
    for row, count in enumerate(COUNTS):
        many = count > _MANY
        for _ in range(_GEOMETRIES_OF_MANY if many else geometries):
            upper, variances = geometry(random, count)
            for column, failure in enumerate(BOOTSTRAPPED_FAILURE):
                if many and failure > _FAILURE_OF_MANY:
                    needed[:, row, column] = np.inf
                    continue
                fitted = scaled(variances, failure)
                ratios = sampled(random, upper, fitted, _SAMPLES_OF_MANY if many else samples)
                for place, failure_rate in enumerate(FAILURE_RATES):
                    if failure > failure_rate:
                        least = ratio_needed(ratios, failure_rate)
                        needed[place, row, column] = max(needed[place, row, column], least)
        print(f"{count} ambiguities done", file=sys.stderr, flush=True)
    return in_order(needed)


def in_order(needed: Floats) -> Floats:
    """More failures never ask for less, nor do fewer ambiguities: what contradicts it is the luck of the geometries."""
    missing = np.isinf(needed)
    ratios = np.where(missing, 1.0, needed)
    ratios = np.maximum.accumulate(ratios[:, ::-1], axis=1)[:, ::-1]
    ratios = np.maximum.accumulate(ratios, axis=2)
    # Of the few geometries of many ambiguities the worst may be missing: they are asked for what fewer are.
    few = max(row for row, count in enumerate(COUNTS) if count <= _MANY)
    ratios[:, few + 1 :] = np.maximum(ratios[:, few + 1 :], ratios[:, few, np.newaxis])
    return np.where(missing, np.inf, ratios)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--geometries", type=int, default=64)
    parser.add_argument("--samples", type=int, default=30_000)
    options = parser.parse_args()
    for failure_rate, ratios in zip(
        FAILURE_RATES, table(options.seed, options.geometries, options.samples), strict=True
    ):
        print(f"# failure rate {failure_rate}")
        for count, row in zip(COUNTS, ratios, strict=True):
            cells = (
                "inf" if math.isinf(ratio) else f"{math.ceil(100.0 * ratio) / 100.0:.2f}" for ratio in row
            )
            print(f"({', '.join(cells)}),  # {count}")


if __name__ == "__main__":
    main()
