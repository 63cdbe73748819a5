"""Wrong fixes of random skies: where other integers would put a receiver, and whether the engine's own tests see it.

Three kinds, each with its integers, from which the shift of the position follows by least squares, now and a minute
later: `cycles`, one to three cycles on one to three satellites, whatever the engine would think of them; `search`,
what LAMBDA finds from floats that reflected codes have biased, as a common receiver takes it, by the ratio test alone;
`right`, the right integers with errors of the phases that passed the residual test. The tests are those of
`ambiguity.fixed_solution`; Camber's own engine, which asks for a success rate too, takes one in a hundred of `search`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np

from camber.compiled.decorator import compiled
from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED, FixCriteria
from camber.gnss.ambiguity.fixed_solution import CONTRADICTORY, chi2_limit, estimate, phase_residuals
from camber.gnss.observations.differenced_observations import SingleDifferences, without_clocks
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.float_solution import PositionPrior, inverse_3
from camber.simulator.satellites.random_skies import LATER_S, RandomSkies
from camber.simulator.scene import Booleans, Floats, Integers

Kind = Literal["cycles", "search", "right"]

_LIMITS = EngineSettings(least_success_rate=0.0, partial=False).fix_criteria()
_WHITE = 0.4  # of the σ that an engine assumes, the rest of which is for reflections
_MOST_ROWS_OF_SEARCH, _MOST_OF_SEARCH = 20, 3


class FixShapes(NamedTuple):
    """n candidate fixes that passed the ratio test (or, of `cycles`, were made without it).

    `shift_m`, `rate_m_s` (n, 3): of the position by wrong integers, now and its change as the satellites move.
    `claimed_m2` (n, 3, 3): covariance that the engine claims. `reflected_m2` (n, 3, 3): of a right fix by the phases'
    errors as they are there. `residuals_agree` (n,): the fixed phases' residuals pass. `sky` (n,) its index;
    `along` (n, 2) the street's direction, east and north; `satellites` (n,) that the sky has.
    """

    sky: Integers
    shift_m: Floats
    rate_m_s: Floats
    claimed_m2: Floats
    reflected_m2: Floats
    residuals_agree: Booleans
    ambiguities: Integers
    street: Booleans
    along: Floats
    satellites: Integers

    def chosen(self, which: Booleans | Integers) -> FixShapes:
        """Some of them."""
        return FixShapes._make(column[which] for column in self)


def fix_shapes(skies: RandomSkies, kind: Kind, tries: int, rng: np.random.Generator) -> FixShapes:
    """So many tries on each sky, but of a `search` at most three that succeed; what is no fix, or not of that kind, is
    left out. A search is tried on skies of at most 20 rows: where there are more it hardly ever errs.
    """
    seeds = rng.integers(0, 2**31 - 1, len(skies.rows) * tries)
    kind_number = get_args(Kind).index(kind)
    shift, rate, claimed, reflected, status, count = _shapes(
        skies, seeds, kind=kind_number, tries=tries, limits=_LIMITS
    )
    sky = np.repeat(np.arange(len(skies.rows)), tries)
    along = np.column_stack((np.cos(skies.street_rad), np.sin(skies.street_rad)))
    seen = np.array([len(np.unique(row[:m])) for row, m in zip(skies.satellite, skies.rows, strict=True)])
    return FixShapes(
        sky=sky,
        shift_m=shift,
        rate_m_s=rate,
        claimed_m2=claimed,
        reflected_m2=reflected,
        residuals_agree=status == 1,
        ambiguities=count,
        street=skies.street[sky],
        along=along[sky],
        satellites=seen[sky],
    ).chosen(status > 0)


@compiled
def _shapes(
    skies: RandomSkies, seeds: Integers, kind: int, tries: int, limits: FixCriteria
) -> tuple[Floats, Floats, Floats, Floats, Integers, Integers]:
    """Of the tries: shifts, rates, covariances claimed and by reflections, status, numbers of ambiguities.

    Status 1: passes all tests, 2: its residuals do not, 0: no fix of this kind.
    """
    rows, direction, later = skies.rows, skies.direction, skies.later_direction
    code_sigma, phase_sigma, reflection = skies.code_sigma_m, skies.phase_sigma_m, skies.reflection_m
    n = seeds.size
    shift, rate = np.zeros((n, 3)), np.zeros((n, 3))
    claimed, reflected = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    status, count = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for k in range(rows.size):
        if kind == 1 and rows[k] > _MOST_ROWS_OF_SEARCH:
            continue
        m, successes = rows[k], 0
        nothing, zeros, air = np.zeros(m, np.int64), np.zeros(m), np.zeros((3, 3))
        sky = SingleDifferences(
            rover=nothing, base=nothing, satellite=skies.satellite[k, :m].copy(), group=skies.group[k, :m].copy(),
            wavelength_m=skies.wavelength_m[k, :m].copy(), direction=direction[k, :m].copy(), code_m=np.zeros(m),
            phase_m=np.zeros(m), code_variance_m2=code_sigma[k, :m] ** 2, phase_variance_m2=phase_sigma[k, :m] ** 2,
            elevation_rad=zeros, cn0_dbhz=zeros, atmosphere_m2=air,
        )  # fmt: skip
        for at in range(k * tries, (k + 1) * tries):
            np.random.seed(seeds[at])
            _disturb(sky, skies, k)
            good, passed, integer = _integers(sky, kind, limits)
            if not good:
                continue
            solved, dx, covariance, mapped = _solved(sky, direction[k, :m], integer)
            again, dx_later, _, _ = _solved(sky, later[k, :m], integer)
            trace = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
            if not (solved and again and trace <= limits.largest_sigma_m**2):
                continue
            shift[at], rate[at], claimed[at] = dx, (dx_later - dx) / LATER_S, covariance
            for i in range(m):
                count[at] += 1 if integer[i] == integer[i] else 0
                variance = (_WHITE * phase_sigma[k, i]) ** 2 + reflection[k, i] ** 2
                for a in range(3):
                    for b in range(3):
                        reflected[at, a, b] += variance * mapped[i, a] * mapped[i, b]
            status[at] = 1 if passed else 2
            successes += 1
            if kind == 1 and successes == _MOST_OF_SEARCH:
                break
    return shift, rate, claimed, reflected, status, count


@compiled
def _disturb(sky: SingleDifferences, skies: RandomSkies, k: int) -> None:
    """Errors of codes and phases, drawn anew; of the codes' reflections a quarter to three times the sky's σ."""
    of_satellite, factor = 0.0, np.exp(np.random.uniform(np.log(0.25), np.log(3.0)))
    for i in range(sky.satellite.size):
        if i == 0 or sky.satellite[i] != sky.satellite[i - 1]:
            of_satellite = np.random.normal()
        sky.phase_m[i] = np.random.normal() * np.hypot(
            _WHITE * skies.phase_sigma_m[k, i], skies.reflection_m[k, i]
        )
        sky.code_m[i] = 0.5 * skies.code_sigma_m[k, i] * np.random.normal() + skies.detour_m[k, i]
        # A reflection lengthens the codes of both bands alike.
        sky.code_m[i] += (
            factor * skies.code_bias_sigma_m[k, i] * (0.7 * of_satellite + 0.7 * np.random.normal())
        )


@compiled
def _integers(sky: SingleDifferences, kind: int, limits: FixCriteria) -> tuple[bool, bool, Floats]:
    """Is there a fix of this kind, do its residuals pass, and its integers' errors (m,), NaN where not fixed."""
    m = sky.satellite.size
    integer, off, passed = np.zeros(m), False, True
    if kind == 0:
        _off_by_cycles(sky, integer)
    elif kind == 1:
        estimated = estimate(sky, np.ones(m, np.bool_), PositionPrior(np.zeros(3), np.zeros((3, 3))), limits)
        if estimated.status != RESOLVED and estimated.status != CONTRADICTORY:
            return False, False, integer
        passed = estimated.status == RESOLVED
        integer[:] = estimated.integer
    for i in range(m):
        off = off or (integer[i] == integer[i] and integer[i] != 0.0)
    if off != (kind != 2):
        return False, False, integer
    if kind != 1:
        chi2, freedom = phase_residuals(sky, integer)
        passed = freedom < 1 or not chi2 > chi2_limit(freedom, limits.residual_quantile)
    return kind != 2 or passed, passed, integer


@compiled
def _off_by_cycles(rows: SingleDifferences, integer: Floats) -> None:
    """One to three cycles on one to three satellites, on one band of each or on all, into `integer` (m,)."""
    m = integer.size
    for _ in range(np.random.randint(1, 4)):
        chosen = np.random.randint(0, m)
        cycles = np.random.randint(1, 4) * (1.0 if np.random.random() < 0.5 else -1.0)
        alone = np.random.random() < 0.5
        for i in range(m):
            if i == chosen or (rows.satellite[i] == rows.satellite[chosen] and not alone):
                integer[i] = cycles


@compiled
def _solved(
    rows: SingleDifferences, direction: Floats, integer: Floats
) -> tuple[bool, Floats, Floats, Floats]:
    """Where the integers (NaN: not fixed) move a position by these directions (m, 3), its covariance, and what each
    phase moves it by, (m, 3) per metre."""
    m = integer.size
    length, weights = np.zeros(m), np.zeros(m)
    for i in range(m):
        if integer[i] == integer[i]:
            length[i] = -integer[i] * rows.wavelength_m[i]
            weights[i] = 1.0 / rows.phase_variance_m2[i]
    turned = SingleDifferences(
        rover=rows.rover, base=rows.base, satellite=rows.satellite, group=rows.group, wavelength_m=rows.wavelength_m,
        direction=np.ascontiguousarray(direction), code_m=rows.code_m, phase_m=rows.phase_m,
        code_variance_m2=rows.code_variance_m2, phase_variance_m2=rows.phase_variance_m2,
        elevation_rad=rows.elevation_rad, cn0_dbhz=rows.cn0_dbhz, atmosphere_m2=rows.atmosphere_m2,
    )  # fmt: skip
    centred, _, _ = without_clocks(turned, length, weights)
    information = np.zeros((3, 3))
    for i in range(m):
        for a in range(3):
            for b in range(3):
                information[a, b] += weights[i] * centred[i, a] * centred[i, b]
    covariance, good = inverse_3(information)
    mapped, dx = np.zeros((m, 3)), np.zeros(3)
    for i in range(m):
        for a in range(3):
            for b in range(3):
                mapped[i, a] += weights[i] * covariance[a, b] * centred[i, b]
            dx[a] += mapped[i, a] * length[i]
    return good, dx, covariance, mapped
