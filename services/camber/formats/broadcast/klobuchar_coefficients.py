"""The eight coefficients of the broadcast ionosphere model (Klobuchar) of GPS, QZSS and BeiDou.

Sources: IS-GPS-200, 20.3.3.5.1.7 and table 20-X; BDS-SIS-ICD-B1I, 5.2.4.7, with the same widths and scale factors.
BeiDou's are for its own model, in geographic coordinates and for B1I; those of QZSS are for Japan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from camber.formats.broadcast.bit_fields import BitField

# IS-GPS-200, table 20-X: scale factors of α0 to α3 and β0 to β3.
_RESOLUTIONS = (2.0**-30, 2.0**-27, 2.0**-24, 2.0**-24, 2.0**11, 2.0**14, 2.0**16, 2.0**16)
_NAMES = ("alpha0", "alpha1", "alpha2", "alpha3", "beta0", "beta1", "beta2", "beta3")
IONOSPHERE_FIELDS = {
    name: BitField(8, resolution, signed=True) for name, resolution in zip(_NAMES, _RESOLUTIONS, strict=True)
}

Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class IonosphereCoefficients:
    """Amplitude `alpha` and period `beta` [s, s/semicircle, s/semicircle², …] of the system `G`, `J` or `C`."""

    system: str
    alpha: Four
    beta: Four


def coefficients_from_integers(system: str, integers: Mapping[str, int]) -> IonosphereCoefficients:
    """Scale the signed integers named as in `IONOSPHERE_FIELDS`."""
    a0, a1, a2, a3, b0, b1, b2, b3 = (integers[name] * IONOSPHERE_FIELDS[name].resolution for name in _NAMES)
    return IonosphereCoefficients(system=system, alpha=(a0, a1, a2, a3), beta=(b0, b1, b2, b3))
