"""Resolves three float ambiguities to integers by LAMBDA and tests the result with the ratio test.

    python examples/resolve_ambiguities.py
    python examples/resolve_ambiguities.py --least-ratio 1.4

The floats and their covariance are the example of de Jonge and Tiberius (LGR series 12, 1996). The two best integer
vectors are (5, 3, 4) and (6, 4, 4). Their squared norms differ by the factor 1.41 only, so that the usual threshold of
3 rejects them and the ambiguities stay floats.
"""

import argparse

import numpy as np

from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED, FixCriteria, resolve
from camber.gnss.ambiguity.lambda_decorrelation import decorrelated
from camber.gnss.ambiguity.lambda_search import nearest_integers

FLOATS = np.array([5.450, 3.100, 2.970])  # cycles
COVARIANCE = np.array([[6.290, 5.978, 0.544], [5.978, 6.292, 2.340], [0.544, 2.340, 6.288]])  # cycles²


def main() -> None:
    """Print the two best integer vectors with their squared norms, and the outcome of the ratio test."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--least-ratio", type=float, default=3.0, help="threshold of the ratio test")
    least_ratio: float = parser.parse_args().least_ratio

    # Step by step: decorrelation z = Z a, integer search, and back to ambiguities by a = Z⁻¹ z.
    definite, z = decorrelated(COVARIANCE)
    assert definite
    _, vectors, norms, _ = nearest_integers(
        z.upper, z.variances, z.transform @ FLOATS, wanted=2, most_nodes=1000
    )
    for vector, norm in zip(np.linalg.solve(z.transform, vectors.T).T, norms, strict=True):
        integers = tuple(round(ambiguity) for ambiguity in vector.tolist())
        print(f"{integers} squared norm {norm:.5f}")

    # In one call, with the ratio test.
    criteria = FixCriteria(
        least_ratio=least_ratio, least_success_rate=0.0, least_fixed=3, partial=False, failure_rate=0.0
    )
    resolution = resolve(FLOATS, COVARIANCE, criteria)
    print(f"ratio {resolution.ratio:.3f}, threshold {resolution.ratio_needed:.3f}")
    print(f"success rate of bootstrapping {resolution.success_rate:.3f}")
    outcome = "resolved" if resolution.status == RESOLVED else "not resolved"
    print(f"{outcome}: {', '.join(f'{ambiguity:g}' for ambiguity in resolution.ambiguities.tolist())}")


if __name__ == "__main__":
    main()
