"""Normal gravity has the values that the definition of WGS 84 prints."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.geodesy.gravity import normal_gravity_m_s2
from support.strapdown import earth_gravity_m_s2


def test_it_is_that_of_wgs_84_at_the_equator_and_at_a_pole() -> None:
    """NIMA TR8350.2, table 3.4."""
    assert normal_gravity_m_s2(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity_m_s2(0.5 * math.pi, 0.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert normal_gravity_m_s2(-0.5 * math.pi, 0.0) == normal_gravity_m_s2(0.5 * math.pi, 0.0)


@pytest.mark.parametrize("latitude_deg", [0.0, 35.0, 70.0])
def test_it_falls_with_height_as_the_field_of_the_earth_does(latitude_deg: float) -> None:
    """Another derivation: the field with its flattening (J2, J4) and the centrifugal force."""
    latitude_rad, height_m = math.radians(latitude_deg), 3000.0
    change = normal_gravity_m_s2(latitude_rad, height_m) - normal_gravity_m_s2(latitude_rad, 0.0)
    expected = gravity_by_j2_m_s2(latitude_rad, height_m) - gravity_by_j2_m_s2(latitude_rad, 0.0)
    assert change == pytest.approx(expected, abs=2e-6)
    assert normal_gravity_m_s2(latitude_rad, 0.0) == pytest.approx(
        gravity_by_j2_m_s2(latitude_rad, 0.0), abs=5e-5
    )


def gravity_by_j2_m_s2(latitude_rad: float, height_m: float) -> float:
    return math.hypot(*earth_gravity_m_s2(np.array(ecef_from_geodetic_scalar(latitude_rad, 0.3, height_m))))
