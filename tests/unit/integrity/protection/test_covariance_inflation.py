"""A right fix is off by more than its receiver claims."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance

CLAIMED = (4e-4, 1e-4, 2e-5, 9e-4, -3e-5, 16e-4)
variance = st.floats(0.0, 1.0)


def test_the_claim_is_scaled_and_the_floor_added_to_its_variances():
    expected = (64e-4 + 25e-4, 16e-4, 32e-5, 144e-4 + 25e-4, -48e-5, 256e-4 + 1e-2)
    assert inflate_covariance(
        CLAIMED, TrueSigma(scale=4.0, horizontal_m=0.05, vertical_m=0.1)
    ) == pytest.approx(expected)


def test_a_receiver_that_claims_no_error_has_the_floor():
    assert inflate_covariance((0.0,) * 6, TrueSigma()) == pytest.approx((25e-4, 0, 0, 25e-4, 0, 25e-4))


@given(variance, variance, variance, st.floats(1.0, 10.0), st.floats(0.0, 1.0))
def test_no_variance_is_below_the_claimed(ee, nn, uu, scale, floor_m):
    truth = inflate_covariance(
        (ee, 0.0, 0.0, nn, 0.0, uu), TrueSigma(scale=scale, horizontal_m=floor_m, vertical_m=floor_m)
    )
    assert truth[0] >= ee
    assert truth[3] >= nn
    assert truth[5] >= uu
