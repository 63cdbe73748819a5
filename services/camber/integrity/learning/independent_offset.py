"""Are fixes off by one horizontal vector, or led away? Judged by an independent position, of whatever precision.

The differences d(t) of fix and independent position are tested along the two principal axes of its covariance. If the
fixes are right, d has mean zero and the covariance K of the independent position's errors. A fault adds s(t) · a with
an unknown size a: one vector since a time, s = 1 from then on (base station, datum), or a growing one, s the time since
then (fixes that are led away). The statistic of one template is that of the generalised likelihood ratio for a Gaussian
of known covariance (S. M. Kay, "Fundamentals of statistical signal processing", II, 6.4), summed over both axes,

    T = (sᵀ K⁻¹ d)² / (sᵀ K⁻¹ s)   ~ χ² with two degrees of freedom without a fault,

at its largest over the times at which it may have begun.

K is known in part only: a position has its σ at each time, but not how its errors go on. So T is the least over three
covariances that bound what dead reckoning and its evidence do, each times e^(−u) and with a common part of
`common_sigma_m` (survey, lever arm):

- what was driven adds independent errors, and evidence removes a part of them: cov = min(σᵢ², σⱼ²), twice, with a slow
  and a fast renewal u;
- one scale or heading error grows with the way: cov = σᵢ σⱼ, with the slow renewal.

u is the way driven in lengths L = max(σ² / q, least), over which a steady error is renewed: with q, by which the
variance grows in a metre, new errors of σ² replace the old after L. The slow renewal bounds how far an error may
be averaged: a way counts once there is evidence at its end, until then the error is the old one and more. The fast one
bounds how far it may change: each way counts, for links and turns move the position without being evidence.

numpy only. Arrays (n,) by sample, metres and seconds.
"""

from __future__ import annotations

import itertools
import statistics
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.integrity.learning.common_offset import Floats
from camber.integrity.learning.residuals import FixResidual, distance_m

_SAMPLE_NS = 2_000_000_000  # chosen: no fault has to be named within less than 20 s
_MOST_SAMPLES = (
    128  # chosen: 4 min; beyond, every other one of the older half is dropped, so that it reaches farther
)
_SLOW, _FAST = (1e-3, 300.0), (2e-2, 10.0)
"""q [m²/m] and least L [m]. σ of 0.6 and 2.4 m after 300 m, the second an error of 1.5 % of the way at 95 %; relief
needs some 300 m of road for a position of decimetres, a scan match some 10 m."""
_MODELS = ((False, _SLOW), (False, _FAST), (True, _SLOW))
"""Whether all errors grow from one cause, and the renewal."""
_LEAST_SHOWN_CHI2 = (
    2.0  # of the newest sample, to look further; chosen: of what is within σ now nothing is named
)
_LEAST_FIX_SIGMA_M = 0.02  # of two seconds of fixes; chosen: whatever a receiver claims
_WAVERING = 3  # samples without the offset that end it; chosen: one wrong fix is two at most
FaultKind = Literal["base", "drift"]


@dataclass(frozen=True, slots=True, kw_only=True)
class IndependentOffsetRules:
    """When a difference from the independent position is a fault.

    `least_chi2` has two degrees of freedom: by chance exp(−T / 2) = 2e-8, for each of 200 templates. A vector counts
    after `least_s`, longer than a wrong fix lasts whose integers hold, or after `least_far_s` beyond `far_m`, where no
    wrong integers reach; a growing one after `least_drift_s`, from `least_drift_m`, where one wrong fix is no slope.
    `margin` is the difference in T that distinguishes the two: 3 σ. `coherent` is the share of the samples that must
    lie within half of what is named.
    """

    least_chi2: float = 36.0
    margin: float = 9.0
    common_sigma_m: float = 0.15
    far_m: float = 5.0
    least_s: float = 120.0
    least_far_s: float = 8.0
    least_drift_s: float = 14.0
    least_drift_m: float = 1.0
    coherent: float = 0.75


@dataclass(frozen=True, slots=True, kw_only=True)
class IndependentOffset:
    """The fault: since when, the vector now, east and north, and how much it grows in a second."""

    kind: FaultKind
    onset_ns: int
    east_north_m: tuple[float, float]
    growth_m_s: tuple[float, float] = (0.0, 0.0)

    def describe(self) -> str:
        """What it is, for an operator."""
        if self.kind == "base":
            return "fixes are off by one vector"
        return "fixes are led away by {:+.2f} m/s east, {:+.2f} m/s north".format(*self.growth_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sample:
    time_ns: int
    driven_m: float
    evidence_ns: int | None
    east_north_m: tuple[float, float]
    covariance_m2: tuple[float, float, float]
    fix_sigma_m: float


class IndependentOffsets:
    """Takes residuals in the order of time and names the fault that their horizontal part shows."""

    def __init__(self, rules: IndependentOffsetRules) -> None:
        self.rules = rules
        self._forget()

    def _forget(self) -> None:
        self.fault: IndependentOffset | None = None
        self._residuals: list[FixResidual] = []
        self._samples: list[_Sample] = []
        self._place: FixResidual | None = None
        self._driven_m = 0.0
        self._wavering = 0

    def update(self, residual: FixResidual) -> bool:
        """Take a residual; returns whether it ended a sample, after which `fault` is that of now."""
        if residual.known_independent is None:
            return False
        if self._residuals and residual.key.base != self._residuals[0].key.base:
            self._forget()  # another base is off by another vector
        ended = bool(self._residuals) and not (
            0 <= residual.time_ns - self._residuals[0].time_ns < _SAMPLE_NS
        )
        if ended:
            self._add(self._sample())
        self._residuals.append(residual)
        return ended

    def _sample(self) -> _Sample:
        """Medians of what was collected, which a wrong fix does not move."""
        residuals, self._residuals = self._residuals, []
        if self._place is not None:
            self._driven_m += distance_m(self._place, residuals[0])
        self._place = residuals[0]
        known = [of for each in residuals if (of := each.known_independent) is not None]
        east, north, ee, en, nn, fix = (statistics.median(column) for column in zip(*known, strict=True))
        return _Sample(
            time_ns=residuals[0].time_ns,
            driven_m=self._driven_m,
            evidence_ns=residuals[-1].evidence_ns,
            east_north_m=(east, north),
            covariance_m2=(ee, en, nn),
            fix_sigma_m=max(fix, _LEAST_FIX_SIGMA_M),
        )

    def _add(self, sample: _Sample) -> None:
        if self._samples and sample.time_ns <= self._samples[-1].time_ns:
            self._samples, self.fault, self._wavering = [], None, 0  # the clock was set back
        self._samples.append(sample)
        if len(self._samples) > _MOST_SAMPLES:
            half = _MOST_SAMPLES // 2
            self._samples = self._samples[:half:2] + self._samples[half:]
        new = _fault_of(self._samples, self.rules)
        if self.fault is None or (new is not None and (self.fault.kind, new.kind) != ("drift", "base")):
            self.fault, self._wavering = (new if new is not None else self.fault), 0
        if self.fault is not None:
            self._hold(self.fault, sample)

    def _hold(self, fault: IndependentOffset, sample: _Sample) -> None:
        """It lasts until fixes are nearer to the independent position than to it; that σ has grown is no end."""
        east_m, north_m = fault.east_north_m
        along = east_m * sample.east_north_m[0] + north_m * sample.east_north_m[1]
        self._wavering = self._wavering + 1 if along < 0.5 * (east_m**2 + north_m**2) else 0
        if self._wavering >= _WAVERING:
            self._samples, self.fault, self._wavering = self._samples[-_WAVERING:], None, 0


def _fault_of(samples: list[_Sample], rules: IndependentOffsetRules) -> IndependentOffset | None:
    """Of the newest samples, if there is one and it is known which."""
    n = len(samples)
    if n < 3 or not _shows(samples[-1], rules):
        return None
    time_s = np.array([(each.time_ns - samples[0].time_ns) / 1e9 for each in samples])
    since_s = time_s[:, None] - time_s[None, :]  # (n, onset)
    templates = np.hstack((np.where(since_s >= 0.0, 1.0, 0.0), np.maximum(since_s[:, :-1], 0.0)))
    statistic, size = _statistics(samples, templates, rules)
    constant, growing = int(np.argmax(statistic[:n])), n + int(np.argmax(statistic[n:]))
    apart = statistic[growing] - statistic[constant]
    if max(statistic[constant], statistic[growing]) < rules.least_chi2 or abs(apart) < rules.margin:
        return None
    best = growing if apart > 0.0 else constant
    onset = best if best < n else best - n
    lasted_s = float(time_s[-1] - time_s[onset])
    path_m = templates[onset:, best, None] * size[:, best]  # (samples since, 2)
    now_m = float(np.hypot(*path_m[-1]))
    if best < n:
        long_enough = lasted_s >= (rules.least_far_s if now_m > rules.far_m else rules.least_s)
    else:
        long_enough = lasted_s >= rules.least_drift_s and now_m >= rules.least_drift_m
    seen_m = np.array([each.east_north_m for each in samples[onset:]])
    near = np.hypot(*(seen_m - path_m).T) <= np.maximum(0.5 * np.hypot(*path_m.T), 0.25 * now_m)
    if not long_enough or not near[-1] or float(near.mean()) < rules.coherent:
        return None
    east_m, north_m = path_m[-1].tolist()
    growth = size[:, best].tolist() if best >= n else (0.0, 0.0)
    return IndependentOffset(
        kind="drift" if best >= n else "base",
        onset_ns=samples[onset].time_ns,
        east_north_m=(east_m, north_m),
        growth_m_s=(growth[0], growth[1]),
    )


def _shows(sample: _Sample, rules: IndependentOffsetRules) -> bool:
    """Whether the newest difference is larger than its σ."""
    (east_m, north_m), (ee, en, nn) = sample.east_north_m, sample.covariance_m2
    more_m2 = sample.fix_sigma_m**2 + rules.common_sigma_m**2
    ee, nn = ee + more_m2, nn + more_m2
    chi2 = (nn * east_m**2 - 2.0 * en * east_m * north_m + ee * north_m**2) / (ee * nn - en * en)
    return chi2 > _LEAST_SHOWN_CHI2


def _statistics(
    samples: list[_Sample], templates: Floats, rules: IndependentOffsetRules
) -> tuple[Floats, Floats]:
    """T (m,) of each template (n, m), the least over the covariances, and its size (2, m), east and north."""
    seen_m = np.array([each.east_north_m for each in samples])
    covariances = np.array([((ee, en), (en, nn)) for ee, en, nn in (s.covariance_m2 for s in samples)])
    _, axes = np.linalg.eigh(covariances[-1])
    driven_m = np.diff([each.driven_m for each in samples])
    with_evidence_m = _distances_with_evidence(samples)
    fix_m2 = np.array([each.fix_sigma_m**2 for each in samples])
    total: list[Floats] = []
    sizes: list[Floats] = []
    variances = [np.maximum(np.einsum("i,nij,j->n", a, covariances, a), 1e-6) for a in axes.T]
    for coherent, renewal in _MODELS:
        step_m = driven_m if renewal is _FAST else with_evidence_m
        chi2, size = np.zeros(templates.shape[1]), np.zeros((2, templates.shape[1]))
        for axis, variance_m2 in zip(axes.T, variances, strict=True):
            covariance_m2 = _error_covariance(variance_m2, step_m, renewal, coherent=coherent)
            covariance_m2 += rules.common_sigma_m**2
            root = np.linalg.cholesky(covariance_m2 + np.diag(fix_m2))
            white = np.linalg.solve(root, np.column_stack((seen_m @ axis, templates)))
            score, information = white[:, 1:].T @ white[:, 0], (white[:, 1:] ** 2).sum(axis=0)
            chi2 += score**2 / information
            size += axis[:, None] * (score / information)
        total.append(chi2)
        sizes.append(size)
    least = np.argmin(total, axis=0)
    columns = np.arange(templates.shape[1])
    return np.array(total)[least, columns], np.array(sizes)[least, :, columns].T


def _distances_with_evidence(samples: list[_Sample]) -> Floats:
    """Way (n - 1,) since the evidence before, where a sample has new evidence; else 0."""
    distances_m, last_m = np.zeros(len(samples) - 1), samples[0].driven_m
    for k, (before, sample) in enumerate(itertools.pairwise(samples)):
        if sample.evidence_ns is not None and sample.evidence_ns != before.evidence_ns:
            distances_m[k], last_m = sample.driven_m - last_m, sample.driven_m
    return distances_m


def _error_covariance(
    variance_m2: Floats, step_m: Floats, renewal: tuple[float, float], *, coherent: bool
) -> Floats:
    """(n, n) of an independent position's errors along one axis; `step_m` (n - 1,) driven that count."""
    growth_m2_m, least_m = renewal
    length_m = np.maximum(0.5 * (variance_m2[1:] + variance_m2[:-1]) / growth_m2_m, least_m)
    renewed = np.concatenate(((0.0,), np.cumsum(step_m / length_m)))
    if coherent:
        sigma_m = np.sqrt(variance_m2)
        covariance: Floats = np.outer(sigma_m, sigma_m)
    else:
        covariance = np.minimum(variance_m2[:, None], variance_m2[None, :])
    covariance *= np.exp(-np.abs(renewed[:, None] - renewed[None, :]))
    return covariance
