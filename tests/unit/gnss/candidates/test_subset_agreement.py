"""A fix and those from its satellites less one system: when they agree, and what may speak against a fix."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from camber.gnss.ambiguity.fixed_solution import estimate
from camber.gnss.candidates import subset_agreement as module
from camber.gnss.candidates.satellite_subsets import SubsetCandidate
from camber.gnss.candidates.subset_agreement import subset_agreement
from camber.gnss.observations.differenced_observations import SingleDifferences
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.float_solution import NO_PRIOR
from camber.gnss.position.rtk_engine import Solution
from support.engine_drives import open_sky_drive, solved
from support.single_difference_rows import made_up_rows

LIMITS = EngineSettings().fix_criteria()
AT = np.array([1000.0, 2000.0, 3000.0])
MOVED_M = np.array([0.2, 0.0, 0.0])
"""About one cycle."""


def fixed(rows: SingleDifferences, **changed: Any) -> Solution:
    """The fix of all rows, as the engine makes it."""
    agreement = estimate(rows, np.ones(rows.group.size, np.bool_), NO_PRIOR, LIMITS)
    assert agreement.status == 0
    solution = Solution(
        time_ns=0,
        quality="fixed",
        reason="resolved",
        position_ecef_m=AT + agreement.dx_m,
        covariance_ecef_m2=agreement.covariance_m2,
        satellites=16,
        approximate_ecef_m=AT,
        rows=rows,
    )
    return replace(solution, **changed)


def made_up(seed: int = 1, **arguments: Any) -> SingleDifferences:
    return made_up_rows(np.random.default_rng(seed), **arguments).rows


def moved(solution: Solution, by_m: np.ndarray = MOVED_M) -> Solution:
    assert solution.position_ecef_m is not None
    return replace(solution, position_ecef_m=solution.position_ecef_m + by_m)


def test_under_open_skies_every_epoch_agrees_with_its_subsets():
    solutions = solved(open_sky_drive(seed=3, seconds=3))
    assert [s.quality for s in solutions] == ["fixed"] * len(solutions)
    assert {subset_agreement(s, LIMITS) for s in solutions} == {"agree"}


def test_right_integers_with_the_modelled_noise_agree():
    """150 draws: the rate of false alarms is one in ten thousand."""
    outcomes = [subset_agreement(fixed(made_up(seed, systems="GEC")), LIMITS) for seed in range(150)]
    assert outcomes == ["agree"] * 150


@pytest.mark.parametrize("axis", range(3))
def test_a_fix_one_cycle_off_its_subsets_disagrees(axis):
    moved_fix = moved(fixed(made_up()), 0.2 * np.eye(3)[axis])
    assert subset_agreement(moved_fix, LIMITS) == "disagree"


def test_how_far_apart_they_may_be_follows_from_their_covariances():
    solution = fixed(made_up())
    vague = replace(solution, covariance_ecef_m2=0.1**2 * np.eye(3))
    assert subset_agreement(moved(vague), LIMITS) == "agree"
    assert subset_agreement(moved(vague, 5.0 * MOVED_M), LIMITS) == "disagree"
    assert subset_agreement(moved(solution), LIMITS._replace(residual_quantile=1e3)) == "agree"


def test_the_air_that_they_have_in_common_excuses_no_difference():
    rows = made_up()._replace(atmosphere_m2=0.3**2 * np.eye(3))
    assert subset_agreement(fixed(rows), LIMITS) == "agree"
    assert subset_agreement(moved(fixed(rows)), LIMITS) == "disagree"


def test_only_a_subset_that_could_be_a_fix_itself_speaks_against_one():
    unsure = LIMITS._replace(least_success_rate=1.0 + 1e-9)
    assert subset_agreement(moved(fixed(made_up())), unsure) == "unknown"
    assert subset_agreement(fixed(made_up()), unsure) == "agree"


@pytest.mark.parametrize(
    "changed",
    [
        *({"quality": quality} for quality in ("float", "single", "none")),
        *({lacking: None} for lacking in ("position_ecef_m", "covariance_ecef_m2", "rows")),
    ],
)
def test_what_is_no_fix_or_has_no_rows_has_no_subsets(changed):
    assert subset_agreement(replace(fixed(made_up()), **changed), LIMITS) == "unknown"


def test_one_system_alone_has_no_second_opinion():
    assert subset_agreement(fixed(made_up(systems="G")), LIMITS) == "unknown"


def other(by_m: np.ndarray, covariance_m2: np.ndarray, success_rate: float = 0.99) -> SubsetCandidate:
    return SubsetCandidate(
        position_ecef_m=AT + by_m,
        covariance_ecef_m2=covariance_m2,
        excluded=("G01",),
        ambiguities=9,
        fixed=9,
        ratio=5.0,
        success_rate=success_rate,
        agreeing=0,
    )


def agreement_with(monkeypatch: pytest.MonkeyPatch, *subsets: SubsetCandidate) -> str:
    monkeypatch.setattr(module, "subset_candidates", lambda *_, **__: (len(subsets), list(subsets)))
    solution = fixed(made_up(), position_ecef_m=AT, covariance_ecef_m2=1e-4 * np.eye(3))
    return subset_agreement(solution, LIMITS)


def test_the_very_same_position_is_no_second_opinion(monkeypatch):
    assert agreement_with(monkeypatch, other(0.0 * MOVED_M, 1e-4 * np.eye(3))) == "unknown"


def test_one_sure_subset_that_is_elsewhere_outweighs_those_that_agree(monkeypatch):
    near, far = other(0.01 * MOVED_M, 1e-4 * np.eye(3)), other(MOVED_M, 1e-4 * np.eye(3))
    assert agreement_with(monkeypatch, near, far) == agreement_with(monkeypatch, far, near) == "disagree"
    assert agreement_with(monkeypatch, near, replace(far, success_rate=0.94)) == "agree"


@pytest.mark.parametrize("covariance_m2", [-1e-4 * np.eye(3), np.full((3, 3), np.nan)])
def test_with_a_covariance_that_is_none_nothing_agrees(covariance_m2, monkeypatch):
    assert agreement_with(monkeypatch, other(0.01 * MOVED_M, covariance_m2)) == "disagree"
    assert agreement_with(monkeypatch, other(0.01 * MOVED_M, covariance_m2, 0.9)) == "unknown"
    assert agreement_with(monkeypatch, other(np.full(3, np.nan), 1e-4 * np.eye(3), 0.9)) == "unknown"
