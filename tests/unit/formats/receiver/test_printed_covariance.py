"""Covariances printed with few decimals: unknown, rounded and impossible ones are distinguished."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.formats.receiver.printed_covariance import covariance_from_printed, signed_root

ROUNDING_M = 0.5e-4


def matrix(covariance: tuple[float, ...]) -> np.ndarray:
    ee, en, eu, nn, nu, uu = covariance
    return np.array([[ee, en, eu], [en, nn, nu], [eu, nu, uu]])


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


entries = st.floats(-1.0, 1.0)


@given(
    st.lists(entries, min_size=9, max_size=9),
    st.sampled_from([0.0, 0.001, 0.3]),
    st.tuples(*[st.floats(2e-4, 10.0)] * 3),
)
def test_a_covariance_survives_printing_and_is_never_indefinite(
    factor: list[float], noise: float, scale: tuple[float, float, float]
) -> None:
    # With no noise the last row is made from the others: singular, the worst case for rounding.
    rows = np.array(factor).reshape(3, 3)
    rows[2] = rows[0] - rows[1] + noise * rows[2]
    rows *= np.array(scale)[:, None]
    true = rows @ rows.T
    printed = [round(float(np.sqrt(true[i, i])), 4) for i in range(3)]
    roots = [round(signed_root(float(true[i, j])), 4) for i, j in ((0, 1), (0, 2), (1, 2))]
    covariance = covariance_from_printed(
        (printed[0], printed[1], printed[2]), (roots[0], roots[1], roots[2]), ROUNDING_M
    )
    if covariance is not None:
        eigenvalues = np.linalg.eigvalsh(matrix(covariance))
        assert eigenvalues[0] >= -1e-12 * eigenvalues[2]
