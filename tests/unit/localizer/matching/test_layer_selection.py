"""One answer of several layers: the document's three rules, and the vote."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from camber.localizer.matching.layer_selection import LayerEstimate, fuse, select


def estimate(
    east_m: float,
    north_m: float = 0.0,
    yaw_rad: float = 0.0,
    sigma_m: float = 0.02,
    distance_m: float = 0.1,
    north_sigma_m: float | None = None,
) -> LayerEstimate:
    north = sigma_m if north_sigma_m is None else north_sigma_m
    return LayerEstimate(
        offset=np.array([east_m, north_m, yaw_rad]),
        covariance=np.diag([sigma_m**2, north**2, 0.001**2]),
        mean_distance_m=distance_m,
    )


@pytest.mark.parametrize(
    ("rule", "east_m", "used"),
    [("best", 0.6, (False, True)), ("mean", 0.3, (True, True)), ("weighted", 0.4, (True, True))],
)
def test_the_documents_rules_take_the_least_distance_the_mean_and_that_by_one_over_the_distance(
    rule: Literal["best", "mean", "weighted"], east_m: float, used: tuple[bool, ...]
) -> None:
    choice = select([estimate(0.0, distance_m=0.2), estimate(0.6, distance_m=0.1)], rule)
    assert choice.offset[0] == (east_m if rule == "best" else pytest.approx(east_m))
    assert choice.used == used


def test_a_layer_that_two_others_contradict_is_voted_out() -> None:
    choice = select([estimate(0.0), estimate(0.8), estimate(0.01)], "voted")
    assert choice.agreed
    assert choice.used == (True, False, True)
    assert choice.offset[0] == pytest.approx(0.005)


@pytest.mark.parametrize("offsets", [(0.0, 0.8), (0.0, 0.8, -0.8), (0.0, 0.01, 0.8, 0.81)])
def test_without_a_majority_nothing_is_agreed_and_the_covariance_holds_the_spread(
    offsets: tuple[float, ...],
) -> None:
    choice = select([estimate(east) for east in offsets], "voted")
    assert not choice.agreed
    sigma_m = float(np.sqrt(choice.covariance[0, 0]))
    assert all(abs(choice.offset[0] - east) < 2.0 * sigma_m for east in offsets)


def test_two_layers_that_disagree_by_yaw_alone_are_noticed() -> None:
    assert not select([estimate(0.0), estimate(0.0, yaw_rad=0.02)], "voted").agreed


def test_a_direction_that_one_layer_alone_sees_is_taken_from_it() -> None:
    walls_along, house_front = estimate(0.1, -3.0, north_sigma_m=10.0), estimate(0.1, 0.4)
    choice = select([walls_along, house_front], "voted")
    assert choice.agreed
    assert choice.used == (True, True)
    assert choice.offset[1] == pytest.approx(0.4, abs=0.001)


def test_a_layer_that_agrees_with_everything_gives_no_majority() -> None:
    blind = estimate(0.0, sigma_m=10.0)
    assert not select([estimate(0.0), estimate(0.8), blind], "voted").agreed


def test_fusing_is_the_least_squares_solution() -> None:
    random = np.random.default_rng(4)
    estimates = []
    for _ in range(3):
        a = random.normal(0.0, 1.0, (3, 3))
        estimates.append(
            LayerEstimate(
                offset=random.normal(0.0, 0.1, 3), covariance=a @ a.T + np.eye(3), mean_distance_m=0.1
            )
        )
    offset, covariance = fuse(estimates)
    roots = [np.linalg.cholesky(np.linalg.inv(e.covariance)).T for e in estimates]
    rows = np.concatenate(roots)
    wanted, *_ = np.linalg.lstsq(
        rows, np.concatenate([r @ e.offset for r, e in zip(roots, estimates, strict=True)])
    )
    np.testing.assert_allclose(offset, wanted, atol=1e-10)
    np.testing.assert_allclose(covariance, np.linalg.inv(rows.T @ rows), atol=1e-10)


def test_layers_that_scatter_more_than_they_say_are_believed_less() -> None:
    apart = [estimate(0.0, sigma_m=0.01), estimate(0.05, sigma_m=0.01)]
    _, covariance = fuse(apart)
    assert covariance[0, 0] > 0.01**2 / 2.0
