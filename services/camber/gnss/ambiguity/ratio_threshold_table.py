"""How much better the best integers must be than the second-best, for a failure rate that is asked for.

Sources: Teunissen and Verhagen, The GNSS ambiguity ratio-test revisited: a better way of using it, Survey Review 41
(2009); Verhagen and Teunissen, The ratio test for future GNSS ambiguity resolution, GPS Solutions 17 (2013): a fixed
threshold is too strict for strong models and too loose for weak ones; with one that depends on the number of
ambiguities and on the model's strength the chance of *taking wrong integers* is at most the failure rate. It is the
share of all epochs, not of those that are fixed, and it holds where the covariance is true.

The table was made by `benchmarks/ratio_threshold_table.py` (seed 1): float ambiguities of 64 random geometries for each
number, on one to three bands, whole or the most precise part, scaled to each bootstrapped failure rate, 30,000 samples
each (25 ambiguities: 6 and 20,000). The highest ratio of all geometries stands here, and of all greater numbers.
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled

_COUNTS = np.array([1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25])
_BOOTSTRAPPED_FAILURE = np.array([0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5])
_FAILURE_RATES = np.array([0.001, 0.01])
_INF = np.inf
# By failure rate, number of ambiguities, bootstrapped failure rate.
# fmt: off
_RATIOS = np.array(
    [
        [
            (1.53, 2.32, 4.02, 7.87, 42.40, 1775.53, 56978.20, 376907.00, 1919457.11),  # 1
            (1.39, 2.13, 2.95, 4.93, 14.67, 52.45, 239.36, 533.16, 1327.85),  # 2
            (1.37, 1.82, 2.57, 3.99, 8.30, 20.77, 39.38, 59.40, 118.22),  # 3
            (1.30, 1.82, 2.47, 3.91, 6.66, 12.16, 17.59, 26.30, 35.27),  # 4
            (1.28, 1.67, 2.15, 2.92, 5.20, 7.60, 8.99, 11.71, 16.02),  # 5
            (1.28, 1.59, 2.15, 2.72, 4.74, 6.50, 7.76, 7.90, 9.58),  # 6
            (1.20, 1.45, 1.89, 2.25, 3.08, 3.67, 4.27, 4.55, 5.47),  # 8
            (1.17, 1.43, 1.71, 1.94, 2.72, 2.86, 3.27, 3.27, 3.77),  # 10
            (1.12, 1.23, 1.40, 1.56, 1.89, 2.13, 2.33, 2.62, 2.70),  # 13
            (1.07, 1.17, 1.33, 1.42, 1.68, 1.85, 1.98, 2.08, 2.21),  # 16
            (1.07, 1.16, 1.30, 1.42, 1.52, 1.67, 1.79, 1.79, 1.84),  # 20
            (1.07, 1.16, 1.30, 1.42, _INF, _INF, _INF, _INF, _INF),  # 25
        ],
        [
            (1.00, 1.00, 1.00, 1.67, 4.05, 15.20, 286.21, 1840.41, 11909.44),  # 1
            (1.00, 1.00, 1.00, 1.47, 3.11, 6.50, 22.76, 42.05, 114.13),  # 2
            (1.00, 1.00, 1.00, 1.40, 2.60, 4.68, 8.44, 11.55, 20.11),  # 3
            (1.00, 1.00, 1.00, 1.36, 2.24, 3.36, 5.50, 6.21, 9.17),  # 4
            (1.00, 1.00, 1.00, 1.30, 1.92, 2.73, 3.55, 4.13, 5.68),  # 5
            (1.00, 1.00, 1.00, 1.28, 1.85, 2.45, 3.11, 3.46, 4.08),  # 6
            (1.00, 1.00, 1.00, 1.22, 1.61, 2.00, 2.25, 2.46, 2.77),  # 8
            (1.00, 1.00, 1.00, 1.19, 1.48, 1.72, 1.94, 2.03, 2.22),  # 10
            (1.00, 1.00, 1.00, 1.06, 1.28, 1.44, 1.60, 1.71, 1.82),  # 13
            (1.00, 1.00, 1.00, 1.04, 1.17, 1.31, 1.46, 1.55, 1.62),  # 16
            (1.00, 1.00, 1.00, 1.04, 1.16, 1.27, 1.36, 1.42, 1.45),  # 20
            (1.00, 1.00, 1.00, 1.04, _INF, _INF, _INF, _INF, _INF),  # 25
        ],
    ]
)
# fmt: on


@compiled
def ratio_for_failure_rate(count: int, bootstrapped_failure: float, failure_rate: float) -> float:
    """What the ratio of `count` ambiguities must exceed so that wrong ones are taken at most at `failure_rate`.

    Of the table's neighbours the strictest counts: a failure rate below the one asked for, and bootstrapping that fails
    more often. 1 where bootstrapping itself fails rarely enough, of any number: it bounds least squares. Infinite
    outside the table: failure rates below 0.001, more than 25 ambiguities, bootstrapping that fails more often than
    every second time (from 21 on: than one in fifty).
    """
    rate = _FAILURE_RATES.size - 1
    while rate >= 0 and _FAILURE_RATES[rate] > failure_rate:
        rate -= 1
    if rate < 0 or count < 1 or not bootstrapped_failure <= 1.0:
        return np.inf
    if bootstrapped_failure <= _FAILURE_RATES[rate]:
        return 1.0
    if count > _COUNTS[-1]:
        return np.inf
    column = 0
    while column < _BOOTSTRAPPED_FAILURE.size and _BOOTSTRAPPED_FAILURE[column] < bootstrapped_failure:
        column += 1
    if column == _BOOTSTRAPPED_FAILURE.size:
        return np.inf
    row = 0
    while _COUNTS[row] < count:
        row += 1
    ratio = _RATIOS[rate, row, column]
    if _COUNTS[row] > count:
        ratio = max(ratio, _RATIOS[rate, row - 1, column])
    return float(ratio)
