"""The model's defaults on the two drives of `boreas-tracks`."""

from __future__ import annotations

from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel
from support.gnss_files import recording
from support.map_error_statistics import likelihood_of, road_difference


def test_two_scales_are_likelier_than_one_of_twenty_metres_or_any_other() -> None:
    """Twice the difference of log-likelihoods against a nested model is χ²: 30 is beyond 1e-5 for two parameters."""
    road = road_difference(recording("boreas-tracks"))
    measured = likelihood_of(road, MAP_ERRORS)
    one_scale = [likelihood_of(road, MapErrorModel(short_share=1.0, short_m=m)) for m in (20.0, 50.0, 100.0)]
    one_scale += [likelihood_of(road, MapErrorModel(short_share=0.0, long_m=m)) for m in (20.0, 50.0, 100.0)]
    assert measured > max(one_scale) + 15.0


def test_the_surveys_differ_by_a_constant_that_the_offset_explains() -> None:
    road = road_difference(recording("boreas-tracks"))
    assert abs(road.difference_m.mean()) < 2.0 * MAP_ERRORS.common_offset_sigma_m
