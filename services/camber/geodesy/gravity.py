"""Normal gravity of WGS 84: the pull of the ellipsoid less the centrifugal force of its rotation, along its normal.

Source: NIMA TR8350.2, eq. 4-1 and 4-3, table 3.4. True gravity differs by some 5e-4 m/s² (its anomalies).
"""

import math

from camber.geodesy.ellipsoid import ECCENTRICITY_SQUARED, FLATTENING, SEMI_MAJOR_AXIS_M

STANDARD_GRAVITY_M_S2 = 9.80665  # ISO 80000-3: the unit g of sensors; true gravity differs by 0.3 %
# NIMA TR8350.2, table 3.4
EQUATORIAL_GRAVITY_M_S2 = 9.7803253359
_SOMIGLIANA_K = 0.00193185265241
_CENTRIFUGAL_RATIO = 0.00344978650684


def normal_gravity_m_s2(latitude_rad: float, height_m: float) -> float:
    """Gravity at a latitude and ellipsoidal height, downwards; good to 1e-8 m/s² up to 1 km, 1e-6 m/s² at 10 km."""
    s2 = math.sin(latitude_rad) ** 2
    on_ellipsoid = (
        EQUATORIAL_GRAVITY_M_S2 * (1.0 + _SOMIGLIANA_K * s2) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    )
    relative = height_m / SEMI_MAJOR_AXIS_M
    slope = 2.0 * (1.0 + FLATTENING + _CENTRIFUGAL_RATIO - 2.0 * FLATTENING * s2)
    return on_ellipsoid * (1.0 - slope * relative + 3.0 * relative * relative)
