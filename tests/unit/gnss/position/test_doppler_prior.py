"""The last float position, moved by the Doppler velocity."""

import functools

import numpy as np
import pytest

from camber.gnss.position.doppler_prior import DopplerPrior
from camber.gnss.position.single_point import single_point
from camber.gnss.velocity.doppler_velocity import doppler_velocity
from support.engine_drives import open_sky_drive, some_rows


@functools.cache
def drive(rate_hz: int):
    return open_sky_drive(seed=2, seconds=6, rate_hz=rate_hz)


def measured(rate_hz: int, k: int):
    d = drive(rate_hz)
    single = single_point(d.rover[k], d.store)
    return doppler_velocity(d.rover[k], single), single, d.true_ecef_m[k]


@pytest.mark.parametrize("rate_hz", [1, 10])
def test_from_the_truth_it_comes_to_the_truth(rate_hz):
    for k in range(1, 5):
        prior = DopplerPrior()
        velocity, single, truth = measured(rate_hz, k - 1)
        prior.keep(velocity, single, truth, np.eye(3) * 0.01)
        velocity, single, truth = measured(rate_hz, k)
        propagated = prior.at(velocity, single)
        assert np.linalg.norm(propagated.position_m - truth) < 0.15 / rate_hz
        assert np.linalg.norm(propagated.position_m - drive(rate_hz).true_ecef_m[k - 1]) > 5.0 / rate_hz


@pytest.mark.parametrize("rate_hz", [1, 5])
def test_it_is_less_sure_than_what_it_comes_from_by_as_much_in_a_second_at_any_rate(rate_hz):
    covariance = np.diag([0.3, 0.2, 0.9])
    at = drive(rate_hz).true_ecef_m[0]
    for k in range(rate_hz):
        prior = DopplerPrior()
        velocity, single, _ = measured(rate_hz, k)
        prior.keep(velocity, single, at, covariance)
        velocity, single, _ = measured(rate_hz, k + 1)
        propagated = prior.at(velocity, single)
        grown = np.linalg.inv(propagated.information)
        assert np.linalg.eigvalsh(grown - covariance).min() > 0.0
        at, covariance = propagated.position_m, grown
    assert 0.05 < np.sqrt(np.trace(covariance) - 1.4) < 0.5


def test_there_is_none_at_first_after_a_gap_or_back_in_time_or_without_velocity():
    prior = DopplerPrior()
    first, third, sixth = measured(1, 0), measured(1, 2), measured(1, 5)
    nothing = lambda p: not p.information.any()  # noqa: E731
    assert nothing(prior.at(*first[:2]))
    prior.keep(*third[:2], third[2], np.eye(3))
    assert nothing(prior.at(*first[:2]))
    assert nothing(prior.at(*third[:2]))
    assert nothing(prior.at(*sixth[:2]))
    assert not nothing(prior.at(*measured(1, 4)[:2]))
    few = some_rows(drive(1).rover[3], np.arange(2))
    single = single_point(few, drive(1).store)
    assert nothing(prior.at(doppler_velocity(few, single), single))
    prior.keep(doppler_velocity(few, single), single, third[2], np.eye(3))
    assert nothing(prior.at(*measured(1, 4)[:2]))
