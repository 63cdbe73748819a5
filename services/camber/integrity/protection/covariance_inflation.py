"""How far off a right fix is: more than the receiver claims.

A receiver's covariance is that of white noise of a few millimetres on each phase, carried through the geometry. It
leaves out

- **multipath of the phase**: 1 to 3 cm in a street, against the 3 to 4 mm a receiver's program assumes. It goes through
  the same geometry, so the claim is scaled: 2 cm of amplitude are 1.4 cm of σ, four times 3.5 mm;
- **the reference point**: antenna, phase centre and the point the map was measured with agree within some 6 cm, in a
  direction that turns with the vehicle: 6 cm / √2 = 4.2 cm an axis;
- **the frame** of the base station against the map's: 2 cm.

The last two make a floor of √(4.2² + 2²) ≈ 5 cm an axis, twice the 2.5 cm of R, whose receiver was geodetic and whose
reference was the same antenna. Errors of neighbouring epochs are alike, so averaging does not help against them.
"""

from __future__ import annotations

from dataclasses import dataclass

from camber.schemas.base import Covariance3


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueSigma:
    """Factor on the claimed σ, and floors an axis."""

    scale: float = 4.0
    horizontal_m: float = 0.05
    vertical_m: float = 0.05


def inflate_covariance(covariance_enu_m2: Covariance3, sigma: TrueSigma) -> Covariance3:
    """The covariance of a right fix from the one its receiver claims."""
    scale2, horizontal, vertical = sigma.scale**2, sigma.horizontal_m**2, sigma.vertical_m**2
    ee, en, eu, nn, nu, uu = covariance_enu_m2
    level = scale2 * en, scale2 * eu, scale2 * nn + horizontal
    return scale2 * ee + horizontal, *level, scale2 * nu, scale2 * uu + vertical
