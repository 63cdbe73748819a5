"""Agreement of a fix with the fixes of its satellites less one system; each system is left out once.

A fault of one system, of its satellites or of the base's corrections for it, does not affect a fix without that system.
Two positions with the right integers differ by the noise of their phases: they share measurements, so the covariance of
the difference is at most the sum of both, less the atmosphere between base and rover, which moves both alike. Beyond
the χ² threshold of three degrees of freedom, at the false-alarm rate of the residual test, the integers differ. J.
Blanch et al., "Baseline advanced RAIM user algorithm and possible improvements", IEEE Trans. AES 51 (2015), compares
the solutions of all and of a subset likewise. Which of both is wrong is not determined, and the subset has the fewer
measurements. No height is used.
"""

from __future__ import annotations

from camber.gnss.ambiguity.ambiguity_resolution import FixCriteria
from camber.gnss.ambiguity.fixed_solution import chi2_limit
from camber.gnss.candidates.satellite_subsets import IDENTICAL_M, subset_candidates
from camber.gnss.position.float_solution import inverse_3
from camber.gnss.position.rtk_engine import Solution
from camber.gnss.position.small_algebra import form, inner
from camber.schemas.gnss import SubsetAgreement

_MOST_SYSTEMS = 20  # more than there are


def subset_agreement(solution: Solution, criteria: FixCriteria) -> SubsetAgreement:
    """Agreement of the subsets with a fix. *unknown*: none fixed, none with other measurements, or it is no fix.

    A subset that disagrees has to pass all criteria of a fix, `least_success_rate` included; for agreement the criteria
    of any subset candidate suffice.
    """
    position, covariance = solution.position_ecef_m, solution.covariance_ecef_m2
    if solution.quality != "fixed" or position is None or covariance is None or solution.rows is None:
        return "unknown"
    _, subsets = subset_candidates(solution, criteria, "leave_one_system_out", most_trials=_MOST_SYSTEMS)
    threshold = chi2_limit(3, criteria.residual_quantile)
    atmosphere_m2 = solution.rows.atmosphere_m2
    near = False
    for subset in subsets:
        apart_m = subset.position_ecef_m - position
        if inner(apart_m, apart_m) <= IDENTICAL_M**2:
            continue
        information, invertible = inverse_3(covariance + subset.covariance_ecef_m2 - 2.0 * atmosphere_m2)
        if invertible and form(apart_m, information) <= threshold:
            near = True
        elif subset.success_rate >= criteria.least_success_rate:
            return "disagree"
    return "agree" if near else "unknown"
