"""The eight coefficients of the broadcast ionosphere (Klobuchar's model), as GPS, QZSS and BeiDou send them.

Sources: IS-GPS-200, 20.3.3.5.1.7 and table 20-X; BDS-SIS-ICD-B1I, 5.2.4.7. Both have the same widths and steps; those
of BeiDou are for its own model, in geographic coordinates and for B1I; those of QZSS are for Japan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from camber.formats.broadcast.ephemeris_fields import BitField

_STEPS = (2.0**-30, 2.0**-27, 2.0**-24, 2.0**-24, 2.0**11, 2.0**14, 2.0**16, 2.0**16)
_NAMES = ("alpha0", "alpha1", "alpha2", "alpha3", "beta0", "beta1", "beta2", "beta3")
IONOSPHERE_FIELDS = {name: BitField(8, step, signed=True) for name, step in zip(_NAMES, _STEPS, strict=True)}

Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class IonosphereCoefficients:
    """Of the system `G`, `J` or `C`: amplitude `alpha` and period `beta` [s, s/semicircle, s/semicircle², …]."""

    system: str
    alpha: Four
    beta: Four


def coefficients_from_integers(system: str, integers: Mapping[str, int]) -> IonosphereCoefficients:
    """From signed integers under the names of `IONOSPHERE_FIELDS`."""
    a0, a1, a2, a3, b0, b1, b2, b3 = (integers[name] * IONOSPHERE_FIELDS[name].resolution for name in _NAMES)
    return IonosphereCoefficients(system=system, alpha=(a0, a1, a2, a3), beta=(b0, b1, b2, b3))
