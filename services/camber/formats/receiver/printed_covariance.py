"""Covariances printed in files as standard deviations and signed square roots with few decimals.

RTKLIB prints σn σe σu and, for the cross terms, `sign(c) √|c|` (`sqvar` in RTKLIB `solution.c`), so c = s |s|. Rounding
(σ = 0.0049 is any value from 0.00485 to 0.00495) makes valid matrices look slightly indefinite and small deviations
look like zero; both would be wrong for a reader that inverts or trusts them.
"""

from __future__ import annotations

import math

from camber.geodesy.covariance import EnuCovariance


def covariance_from_printed(
    deviations_enu: tuple[float, float, float],
    cross_roots: tuple[float, float, float],
    rounding: float,
) -> EnuCovariance | None:
    """Return the covariance (ee, en, eu, nn, nu, uu) of σ (e, n, u) and the signed roots of (en, eu, nu).

    `rounding` is half a unit of the last printed digit, in the unit of the deviations. All deviations zero mean
    *unknown*, None: programs without covariance print that. A single zero is replaced by `rounding`. A matrix that is
    indefinite only because of rounding has its correlations reduced until it is not.
    Raises ValueError if a deviation is negative or the matrix is indefinite beyond rounding.
    """
    if not all(sigma >= 0.0 for sigma in deviations_enu):
        raise ValueError(f"standard deviations {deviations_enu} are not all 0 or more")
    if not any(deviations_enu):
        if any(abs(root) > 2.0 * rounding for root in cross_roots):
            raise ValueError("cross terms without standard deviations")
        return None
    e, n, u = (max(sigma, rounding) for sigma in deviations_enu)
    en, eu, nu = (root * abs(root) for root in cross_roots)
    # The error of a correlation is at most 4 rounding / σ, that of an eigenvalue twice as much.
    tolerance = 8.0 * rounding / min(e, n, u) + 1.0e-9
    lowest = _lowest_eigenvalue(en / (e * n), eu / (e * u), nu / (n * u))
    if not lowest >= -1.0 - tolerance:
        raise ValueError("covariance is not positive semidefinite")
    factor = min(1.0, -(1.0 - 1.0e-9) / lowest) if lowest < 0.0 else 1.0
    return e * e, en * factor, eu * factor, n * n, nu * factor, u * u


def signed_root(covariance: float) -> float:
    """Return `sign(c) √|c|`, as RTKLIB prints cross terms."""
    return math.copysign(math.sqrt(abs(covariance)), covariance)


def _lowest_eigenvalue(r12: float, r13: float, r23: float) -> float:
    """Return the lowest eigenvalue of the symmetric 3 × 3 matrix with these off-diagonals and a zero diagonal.

    Source: O. K. Smith, "Eigenvalues of a symmetric 3 × 3 matrix", Comm. ACM 4 (1961), with trace zero.
    """
    p = math.sqrt((r12 * r12 + r13 * r13 + r23 * r23) / 3.0)
    if p == 0.0:
        return 0.0
    cosine = (r12 / p) * (r13 / p) * (r23 / p)
    angle = math.acos(max(-1.0, min(1.0, cosine))) / 3.0
    return 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
