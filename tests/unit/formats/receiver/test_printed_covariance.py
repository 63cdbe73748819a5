"""Covariances printed with few decimals: unknown, rounded and impossible ones are distinguished."""

import pytest

from camber.formats.receiver.printed_covariance import covariance_from_printed, signed_root

ROUNDING_M = 0.5e-4


def test_signed_roots() -> None:
    covariance = covariance_from_printed((2.0, 3.0, 4.0), (1.0, -2.0, 0.5), ROUNDING_M)
    assert covariance == (4.0, 1.0, -4.0, 9.0, 0.25, 16.0)
    assert (signed_root(4.0), signed_root(-4.0), signed_root(0.0)) == (2.0, -2.0, 0.0)


def test_all_zero_deviations_are_unknown() -> None:
    assert covariance_from_printed((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ROUNDING_M) is None


def test_single_zero_deviation_is_replaced_by_the_rounding() -> None:
    covariance = covariance_from_printed((0.0, 0.01, 0.01), (0.0, 0.0, 0.0), ROUNDING_M)
    assert covariance is not None
    assert covariance[0] == pytest.approx(ROUNDING_M**2)


@pytest.mark.parametrize(
    ("deviations", "roots"),
    [
        ((1.0, -1.0, 1.0), (0.0, 0.0, 0.0)),
        ((float("nan"), 1.0, 1.0), (0.0, 0.0, 0.0)),
        ((1.0, 1.0, 1.0), (1.1, 0.0, 0.0)),
        ((1.0, 1.0, 1.0), (0.9, 0.9, -0.9)),
        ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)),
        ((0.0, 1.0, 1.0), (0.1, 0.0, 0.0)),
    ],
)
def test_impossible_covariance_is_refused(
    deviations: tuple[float, float, float], roots: tuple[float, float, float]
) -> None:
    with pytest.raises(ValueError, match=r"deviations|semidefinite"):
        covariance_from_printed(deviations, roots, ROUNDING_M)
