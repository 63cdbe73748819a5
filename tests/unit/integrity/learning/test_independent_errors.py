"""Covariances of an independent position's errors along the way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.learning.independent_errors import PARTS, SINGLE, IndependentErrors, _roots

variances = st.floats(1e-6, 1e4)
samples = st.lists(
    st.tuples(variances, variances, st.floats(-0.999, 0.999), st.floats(0.0, 500.0), st.booleans()),
    min_size=2,
    max_size=20,
)


def errors_of(covariance_m2, driven_m, renewed_m=None):
    driven_m = np.asarray(driven_m, float)
    renewed_m = driven_m if renewed_m is None else np.asarray(renewed_m, float)
    return IndependentErrors(
        covariance_m2=np.asarray(covariance_m2, float), driven_m=driven_m, renewed_m=renewed_m
    )


@settings(derandomize=True, deadline=None)
@given(samples)
def test_each_model_is_a_covariance_and_has_the_covariances_given(rows):
    ee, nn, correlation, steps, evidence = map(np.array, zip(*rows, strict=True))
    en = correlation * np.sqrt(ee * nn)
    given_m2 = np.stack([np.stack([ee, en], -1), np.stack([en, nn], -1)], -2)
    driven_m = np.cumsum(steps)
    renewed_m = np.maximum.accumulate(np.where(evidence, driven_m, 0.0))
    n = len(rows)
    models = list(errors_of(given_m2, driven_m, renewed_m).models())
    assert len(models) == 4
    for model in models:
        for k in range(n):
            assert model[k, :, k] == pytest.approx(given_m2[k], rel=1e-3, abs=2e-6)
        size = np.sqrt(np.einsum("iaia->ia", model)).reshape(2 * n)
        whitened = model.reshape(2 * n, 2 * n) / np.outer(size, size)
        assert np.linalg.eigvalsh(whitened)[0] >= -1e-6


def test_errors_last_over_their_lengths_and_those_of_single_samples_do_not():
    apart_m = np.array([0.0, 1e-9, 300.0, 1e6])
    model = next(errors_of([np.eye(2)] * 4, apart_m).models())[0, 0, :, 0]
    lasting = sum(share * np.exp(-300.0 / length_m) for share, length_m in PARTS)
    assert sum(share for share, _ in PARTS) == pytest.approx(1.0)
    assert model == pytest.approx([1.0, 1.0 - SINGLE, (1.0 - SINGLE) * lasting, 0.0], abs=1e-5)


def test_without_evidence_nothing_is_renewed_and_what_sigma_grows_by_is_new_or_the_same_error():
    covariance_m2 = [np.eye(2), 4.0 * np.eye(2)]
    models = list(errors_of(covariance_m2, [0.0, 1000.0], [0.0, 0.0]).models())
    new, same = (model[0, 0, 1, 0] for model in models[2:])
    assert new == pytest.approx((1.0 - SINGLE) * 1.0, rel=1e-4), "the variance of the first"
    assert same == pytest.approx((1.0 - SINGLE) * 2.0, rel=1e-4), "the product of both σ"
    assert all(model[0, 0, 1, 0] < 0.3 for model in models[:2])


def test_no_error_is_smaller_than_a_millimetre_whatever_covariance_is_given():
    """One of zero, and one that is none."""
    for covariance_m2 in (np.zeros((2, 2)), np.array([[1e-4, 1.0], [1.0, 1e-4]])):
        root, size_m = _roots(covariance_m2[None])
        assert size_m == pytest.approx(1e-3)
        assert np.isfinite(root).all()
