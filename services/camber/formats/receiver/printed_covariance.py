"""Covariances as files print them: standard deviations and signed square roots with few decimals.

RTKLIB prints σn σe σu and, for the cross terms, `sign(c) √|c|` (`sqvar` in RTKLIB `solution.c`), so c = s
|s|. Printing rounds: σ = 0.0049 stands for anything from 0.00485 to 0.00495. That makes good matrices look
slightly indefinite and small deviations look like zero, and both would mislead whoever inverts or trusts
them.
"""

import math

from camber.geodesy.covariance import EnuCovariance


def covariance_from_printed(
    deviations_enu: tuple[float, float, float],
    cross_roots: tuple[float, float, float],
    rounding: float,
) -> EnuCovariance | None:
    """Covariance (ee, en, eu, nn, nu, uu) of σ (e, n, u) and the signed roots of (en, eu, nu).

    `rounding` is half a unit of the last printed digit, in the unit of the deviations. All deviations zero
    mean *not known*, None: that is what programs print that have none. A single zero is taken as `rounding`.
    A matrix that is indefinite only because of the printing has its correlations shrunk until it is not.
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
    # A correlation is off by at most 4 rounding / σ, an eigenvalue by twice that.
    tolerance = 8.0 * rounding / min(e, n, u) + 1.0e-9
    lowest = _lowest_eigenvalue(en / (e * n), eu / (e * u), nu / (n * u))
    if not lowest >= -1.0 - tolerance:
        raise ValueError("covariance is not positive semidefinite")
    shrink = min(1.0, -(1.0 - 1.0e-9) / lowest) if lowest < 0.0 else 1.0
    return e * e, en * shrink, eu * shrink, n * n, nu * shrink, u * u


def signed_root(covariance: float) -> float:
    """`sign(c) √|c|`, as RTKLIB prints cross terms."""
    return math.copysign(math.sqrt(abs(covariance)), covariance)


def _lowest_eigenvalue(r12: float, r13: float, r23: float) -> float:
    """Lowest eigenvalue of the symmetric 3 × 3 matrix with this off-diagonal and zeros on the diagonal.

    Source: O. K. Smith, "Eigenvalues of a symmetric 3 × 3 matrix", Comm. ACM 4 (1961), with trace zero.
    """
    p = math.sqrt((r12 * r12 + r13 * r13 + r23 * r23) / 3.0)
    if p == 0.0:
        return 0.0
    cosine = (r12 / p) * (r13 / p) * (r23 / p)
    angle = math.acos(max(-1.0, min(1.0, cosine))) / 3.0
    return 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
