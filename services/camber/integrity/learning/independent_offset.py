"""Are fixes off by one horizontal vector, or led away? Judged by an independent position, of whatever precision.

If the fixes are right, the differences d of fix and independent position have mean zero and the covariance K of the
errors of both. A fault adds s(t) H(t) a with an unknown vector a: one vector since a time, s = 1 from then on and H = 1
(base station, datum), or a growing one, s the time since then (fixes that are led away), with H = 1, or H the rotation
by the vehicle's heading: fixes that are led along roads turn where these do. What turns counts only where no other
template is nearly as good. The statistic of one template is that of the generalised likelihood ratio for a Gaussian of
known covariance (S. M. Kay, "Fundamentals of statistical signal processing", II, 6.4),

    T = bᵀ A⁻¹ b,   A = Σᵢⱼ sᵢ sⱼ Hᵢᵀ (K⁻¹)ᵢⱼ Hⱼ,   b = Σᵢⱼ sᵢ Hᵢᵀ (K⁻¹)ᵢⱼ dⱼ,   a = A⁻¹ b,

T ~ χ² with two degrees of freedom without a fault, at its largest over the times at which it may have begun. K is known
in part only: T is the least over the covariances of `independent_errors`, each with a common part of `common_sigma_m`
(survey, lever arm) and the fixes' own errors.

numpy only. Arrays (n,) by sample, metres and seconds.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.integrity.learning.common_offset import Floats
from camber.integrity.learning.independent_errors import IndependentErrors
from camber.integrity.learning.residuals import FixResidual, distance_m

_SAMPLE_NS = 2_000_000_000  # chosen: no fault has to be named within less than 20 s
_MOST_SAMPLES = (
    128  # chosen: 4 min; beyond, every other one of the older half is dropped, so that it reaches farther
)
_LEAST_SHOWN_CHI2 = (
    2.0  # of the newest sample, to look further; chosen: of what is within σ now nothing is named
)
_LEAST_FIX_SIGMA_M = 0.02  # of two seconds of fixes; chosen: whatever a receiver claims
_NEAR_SIGMAS = 2.0  # chosen: 86 % of two-dimensional errors lie within it
_FIT_SIGMAS = 2.0  # of χ² with 2n degrees of freedom above its mean; chosen: 98 % of right models fit so
_OVER_CHI2 = 4.0  # in favour of no fault: likelihoods of 7 to 1; chosen: an error of 2 σ ends none
_WAVERING = 3  # samples without the offset that end it; chosen: one wrong fix is two at most
FaultKind = Literal["base", "drift"]


@dataclass(frozen=True, slots=True, kw_only=True)
class IndependentOffsetRules:
    """When a difference from the independent position is a fault.

    `least_chi2` has two degrees of freedom: by chance exp(−T / 2) = 2e-8, for each of 200 templates. A vector counts
    after `least_s`, longer than a wrong fix lasts whose integers hold, or after `least_far_s` beyond `far_m`: few wrong
    integers reach there, and until when they may is `CauseRules.wrong_integers_s`. A growing one counts after
    `least_drift_s`, from `least_drift_m`, where one wrong fix is no slope. `margin` is the difference in T that
    distinguishes the two: 3 σ. `coherent` is the share of the samples that must lie within half of what is named, or
    within two σ of it; a drift counts too where errors explain the rest.
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
    heading_rad: float


class _Template(NamedTuple):
    """One of those of `_statistics`, the size (2,) of its vector, and χ² of what it leaves unexplained."""

    number: int
    size: Floats
    unexplained: float


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
        self._heading_rad = 0.0
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
        heading_rad = residuals[len(residuals) // 2].heading_rad
        self._heading_rad = self._heading_rad if heading_rad is None else heading_rad
        known = [of for each in residuals if (of := each.known_independent) is not None]
        east, north, ee, en, nn, fix = (statistics.median(column) for column in zip(*known, strict=True))
        return _Sample(
            time_ns=residuals[0].time_ns,
            driven_m=self._driven_m,
            evidence_ns=residuals[-1].evidence_ns,
            east_north_m=(east, north),
            covariance_m2=(ee, en, nn),
            fix_sigma_m=max(fix, _LEAST_FIX_SIGMA_M),
            heading_rad=self._heading_rad,
        )

    def _add(self, sample: _Sample) -> None:
        if self._samples and sample.time_ns <= self._samples[-1].time_ns:
            self._samples, self.fault = [], None  # the clock was set back
        self._samples.append(sample)
        if len(self._samples) > _MOST_SAMPLES:
            half = _MOST_SAMPLES // 2
            self._samples = self._samples[:half:2] + self._samples[half:]
        new = _fault_of(self._samples, self.rules)
        if self.fault is None or (new is not None and (self.fault.kind, new.kind) != ("drift", "base")):
            self.fault, self._wavering = new, 0
        if self.fault is not None:
            self._hold(self.fault, sample)

    def _hold(self, fault: IndependentOffset, sample: _Sample) -> None:
        """It lasts until fixes are nearer to the independent position than to it, beyond what σ explains.

        Fixes that are led along a road turn with it: of a drift only the length counts.
        """
        size_m = math.hypot(*fault.east_north_m)
        toward = sample.east_north_m if fault.kind == "drift" else fault.east_north_m
        length_m = math.hypot(*toward) or 1.0
        u, v = toward[0] / length_m, toward[1] / length_m
        left_m = u * sample.east_north_m[0] + v * sample.east_north_m[1]
        ee, en, nn = sample.covariance_m2
        variance_m2 = u * u * ee + 2.0 * u * v * en + v * v * nn + sample.fix_sigma_m**2
        over = size_m**2 - 2.0 * size_m * left_m > _OVER_CHI2 * variance_m2
        self._wavering = self._wavering + 1 if over else 0
        if self._wavering >= _WAVERING:
            self._samples, self.fault = self._samples[-_WAVERING:], None


def _fault_of(samples: list[_Sample], rules: IndependentOffsetRules) -> IndependentOffset | None:
    """Of the newest samples, if there is one and it is known which."""
    n = len(samples)
    if n < 3 or not _shows(samples[-1], rules):
        return None
    statistic, size, unexplained = _statistics(samples, rules)
    faults = (
        _with_template(samples, _Template(best, size[best], float(unexplained[best])), rules)
        for best in _best_templates(statistic, rules)
    )
    return next((fault for fault in faults if fault is not None), None)


def _best_templates(statistic: Floats, rules: IndependentOffsetRules) -> Iterator[int]:
    """Of T (3n − 2,): what turns, where it is best by far; then a vector or a growing one, if it is known which."""
    n = (len(statistic) + 2) // 3
    families = (0, n), (n, 2 * n - 1), (2 * n - 1, 3 * n - 2)
    constant, growing, turning = (first + int(np.argmax(statistic[first:end])) for first, end in families)
    best = max(constant, growing, key=lambda k: float(statistic[k]))
    if statistic[turning] >= max(rules.least_chi2, statistic[best] + rules.margin):
        yield turning
    if statistic[best] >= rules.least_chi2 and abs(statistic[growing] - statistic[constant]) >= rules.margin:
        yield best


def _with_template(
    samples: list[_Sample], template: _Template, rules: IndependentOffsetRules
) -> IndependentOffset | None:
    """The fault by a template, if it has lasted long enough and the samples agree with it."""
    n, (best, size, unexplained) = len(samples), template
    time_s = _times_s(samples)
    onset = best if best < n else (best - n) % (n - 1)
    lasted_s = -float(time_s[onset])
    grown = np.ones(n - onset) if best < n else time_s[onset:] - time_s[onset]
    sizes: Floats = _turned(samples[onset:]) @ size if best >= 2 * n - 1 else np.tile(size, (n - onset, 1))
    path_m = grown[:, None] * sizes  # (samples since, 2)
    now_m = float(np.hypot(*path_m[-1]))
    if best < n:
        long_enough = lasted_s >= (rules.least_far_s if now_m > rules.far_m else rules.least_s)
    else:
        long_enough = lasted_s >= rules.least_drift_s and now_m >= rules.least_drift_m
    near = _near(samples[onset:], path_m)
    fits = best >= n and unexplained <= 2.0 * n + _FIT_SIGMAS * 2.0 * math.sqrt(n)
    if not long_enough or not near[-1] or not (fits or float(near.mean()) >= rules.coherent):
        return None
    east_m, north_m = path_m[-1].tolist()
    growth = sizes[-1].tolist() if best >= n else (0.0, 0.0)
    return IndependentOffset(
        kind="drift" if best >= n else "base",
        onset_ns=samples[onset].time_ns,
        east_north_m=(east_m, north_m),
        growth_m_s=(growth[0], growth[1]),
    )


def _near(samples: list[_Sample], path_m: Floats) -> NDArray[np.bool_]:
    """Which samples lie as near to a path (n, 2) as what has this cause does: half of it, or what σ explains."""
    apart_m = np.array([each.east_north_m for each in samples]) - path_m
    size_m = np.hypot(*path_m.T)
    ee, en, nn = np.array([each.covariance_m2 for each in samples]).T
    chi2 = (nn * apart_m[:, 0] ** 2 - 2.0 * en * apart_m[:, 0] * apart_m[:, 1] + ee * apart_m[:, 1] ** 2) / (
        ee * nn - en * en
    )
    near: NDArray[np.bool_] = np.hypot(*apart_m.T) <= np.maximum(0.5 * size_m, 0.25 * size_m[-1])
    near |= chi2 <= _NEAR_SIGMAS**2
    return near


def _shows(sample: _Sample, rules: IndependentOffsetRules) -> bool:
    """Whether the newest difference is larger than its σ."""
    (east_m, north_m), (ee, en, nn) = sample.east_north_m, sample.covariance_m2
    more_m2 = sample.fix_sigma_m**2 + rules.common_sigma_m**2
    ee, nn = ee + more_m2, nn + more_m2
    chi2 = (nn * east_m**2 - 2.0 * en * east_m * north_m + ee * north_m**2) / (ee * nn - en * en)
    return chi2 > _LEAST_SHOWN_CHI2


def _statistics(samples: list[_Sample], rules: IndependentOffsetRules) -> tuple[Floats, Floats, Floats]:
    """T (3n − 2,) of a vector since each sample, then of a growing one since each but the newest, then of one that
    turns with the vehicle; sizes (3n − 2, 2); and χ² (3n − 2,) of what each leaves unexplained.

    T is the least over the covariances; a covariance by which there is no fault ends the search.
    """
    seen_m = np.array([each.east_north_m for each in samples])
    errors = IndependentErrors(
        covariance_m2=np.array([((ee, en), (en, nn)) for ee, en, nn in (s.covariance_m2 for s in samples)]),
        driven_m=np.array([each.driven_m for each in samples]),
        renewed_m=_renewed_m(samples),
    )
    time_s = _times_s(samples)
    fix_m2 = np.repeat([each.fix_sigma_m**2 for each in samples], 2)
    turned, count = _turned(samples), 3 * len(samples) - 2
    statistic, size, unexplained = np.full(count, np.inf), np.zeros((count, 2)), np.zeros(count)
    for model in errors.models():
        covariance_m2 = model + rules.common_sigma_m**2 * np.eye(2)[:, None, :]
        n = len(fix_m2)
        joint: Floats = covariance_m2.reshape(n, n) + np.diag(fix_m2)
        inverse: Floats = np.asarray(np.linalg.inv(joint), dtype=np.float64)
        by_model, sizes = _of_templates(inverse.reshape(covariance_m2.shape), seen_m, time_s, turned)
        less = by_model < statistic
        total = float(seen_m.reshape(n) @ inverse @ seen_m.reshape(n))
        statistic[less], size[less], unexplained[less] = by_model[less], sizes[less], total - by_model[less]
        if float(statistic.max()) < rules.least_chi2:
            break
    return statistic, size, unexplained


def _of_templates(inverse: Floats, seen_m: Floats, time_s: Floats, turned: Floats) -> tuple[Floats, Floats]:
    """T and size of all templates, by sums over the samples since each; `inverse` (n, 2, n, 2), `turned` (n, 2, 2)."""
    weighted = np.einsum("iajb,jb->ia", inverse, seen_m)
    standing = _normal_equations(inverse, weighted, time_s)
    inverse = np.einsum("iac,iajb,jbd->icjd", turned, inverse, turned, optimize=True)
    with_vehicle = _normal_equations(inverse, np.einsum("iac,ia->ic", turned, weighted), time_s)
    a, b = (
        np.concatenate((both, other[len(seen_m) :]))
        for both, other in zip(standing, with_vehicle, strict=True)
    )
    size: Floats = np.asarray(np.linalg.solve(a, b[:, :, None])[:, :, 0], np.float64)
    return np.einsum("ka,ka->k", b, size), size


def _normal_equations(inverse: Floats, weighted: Floats, time_s: Floats) -> tuple[Floats, Floats]:
    """A (2n − 1, 2, 2) and b (2n − 1, 2) of a vector since each sample, then of a growing one."""
    by_time = inverse * time_s[:, None, None, None]
    constant, mixed, grown = (_sums_since(each) for each in (inverse, by_time, by_time * time_s[:, None]))
    first, moment = (np.cumsum(each[::-1], axis=0)[::-1] for each in (weighted, weighted * time_s[:, None]))
    t = time_s[:-1, None]
    m = t[:, :, None]
    growing = grown[:-1] - m * (mixed[:-1] + mixed[:-1].transpose(0, 2, 1)) + m * m * constant[:-1]
    a: Floats = np.concatenate((constant, growing))
    b: Floats = np.concatenate((first, moment[:-1] - t * first[:-1]))
    return a, b


def _times_s(samples: list[_Sample]) -> Floats:
    """Times (n,) of the samples after the newest."""
    times_s: Floats = np.array([(each.time_ns - samples[-1].time_ns) / 1e9 for each in samples])
    return times_s


def _turned(samples: list[_Sample]) -> Floats:
    """The rotations (n, 2, 2) from the vehicle's axes, at each sample."""
    heading_rad = np.array([each.heading_rad for each in samples])
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    turned: Floats = np.stack((np.stack((cos, -sin), axis=1), np.stack((sin, cos), axis=1)), axis=1)
    return turned


def _sums_since(terms: Floats) -> Floats:
    """Of terms (n, 2, n, 2) the sums over both samples from k on, (n, 2, 2)."""
    sums = np.cumsum(np.cumsum(terms[::-1, :, ::-1], axis=0), axis=2)[::-1, :, ::-1]
    n = np.arange(len(terms))
    since: Floats = sums[n, :, n, :]
    return since


def _renewed_m(samples: list[_Sample]) -> Floats:
    """Way (n,) at the evidence before each sample."""
    renewed_m = np.zeros(len(samples))
    for k, (before, sample) in enumerate(itertools.pairwise(samples), start=1):
        is_new = sample.evidence_ns is not None and sample.evidence_ns != before.evidence_ns
        renewed_m[k] = sample.driven_m if is_new else renewed_m[k - 1]
    return renewed_m
