"""Height errors of right fixes of a recording beside what the receiver claims: `python -m support.height_claims`.

The reference's own error, some 2 cm, is in the figures.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from support.wrong_fix_shapes import FixesAgainstTruth, is_wrong, nagoya_fixes

CLAIMS_M = (0.008, 0.012, 0.02, 0.05)
LEAST_SPEED_M_S = 2.0
"""At a standstill one error counts hundreds of times."""


def shares(fixes: FixesAgainstTruth) -> list[tuple[int, float, float]]:
    """By class of claimed σ: number of right fixes while driving, median claim (m), and by how many times that what
    changes slowly has a larger σ, if the white noise is as claimed."""
    right = ~is_wrong(fixes.error_m) & (fixes.speed_m_s > LEAST_SPEED_M_S)
    result = []
    for least_m, most_m in itertools.pairwise(CLAIMS_M):
        rows = right & (fixes.up_sigma_m >= least_m) & (fixes.up_sigma_m < most_m)
        claim_m = float(np.median(fixes.up_sigma_m[rows]))
        slow_m2 = float(fixes.error_m[rows, 2].var()) - claim_m**2
        result.append((int(rows.sum()), claim_m, math.sqrt(max(slow_m2, 0.0)) / claim_m))
    return result


def main() -> None:
    """Print one line for each class."""
    fixes = nagoya_fixes()
    if fixes is None:
        raise SystemExit("CAMBER_DATA is not set")
    for count, claim_m, share in shares(fixes):
        print(f"{count} fixes claim {100 * claim_m:.1f} cm: slow errors of {share:.1f} times that")


if __name__ == "__main__":
    main()
