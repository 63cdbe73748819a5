"""Does a fix stand where its satellites less one system do? Each system is left out once.

A fault of one system, of its satellites or of the base's part of it, carries no fix that leaves it out. Two positions
with the right integers differ by what the noise of their phases leaves: they have measurements in common, so the
covariance of the difference is at most the sum of both, less the air between base and rover, which moves both alike.
Beyond the χ² limit of three degrees of freedom, at the rate of false alarms of the residual test, the integers are not
the same. J. Blanch et al., "Baseline advanced RAIM user algorithm and possible improvements", IEEE Trans. AES 51
(2015), compares the positions of all and of a part so. Which of both is wrong is not said, and the subset has the fewer
measurements. No height is known here.
"""

from __future__ import annotations

from camber.gnss.ambiguity.fixed_solution import Limits, chi2_limit
from camber.gnss.candidates.satellite_subsets import IDENTICAL_M, other_estimates
from camber.gnss.position.differenced_epoch import NO_PRIOR
from camber.gnss.position.float_solution import inverse_3
from camber.gnss.position.rtk_engine import Solution
from camber.gnss.position.small_algebra import form, inner
from camber.schemas.gnss import SubsetAgreement

_MOST_SYSTEMS = 20


def subset_agreement(solution: Solution, limits: Limits) -> SubsetAgreement:
    """What the subsets say of a fix. *unknown*: none fixed, none at another measurement's word, or it is no fix.

    To speak against it a subset has to pass all that a fix has to, `least_success` included; to speak for it, what is
    asked of any other estimate is enough.
    """
    position, covariance, rows = solution.position_ecef_m, solution.covariance_ecef_m2, solution.rows
    if solution.quality != "fixed" or position is None or covariance is None or rows is None:
        return "unknown"
    approximate = solution.approximate_ecef_m
    assert approximate is not None
    _, subsets = other_estimates(
        rows, approximate, limits, "leave_one_system_out", (), _MOST_SYSTEMS, solution.prior or NO_PRIOR
    )
    limit = chi2_limit(3, limits.normal_quantile)
    near = False
    for subset in subsets:
        apart_m = subset.position_ecef_m - position
        if inner(apart_m, apart_m) <= IDENTICAL_M**2:
            continue
        information, known = inverse_3(covariance + subset.covariance_ecef_m2 - 2.0 * rows.atmosphere_m2)
        if known and form(apart_m, information) <= limit:
            near = True
        elif subset.success_rate >= limits.least_success:
            return "disagree"
    return "agree" if near else "unknown"
