"""How the errors of an independent position go on along the way: their covariance from sample to sample.

A position states its covariance Cᵢ at each time, but not how its errors go on. Here the errors are eᵢ = Rᵢ zᵢ, with the
symmetric root Rᵢ of Cᵢ and

    cov(eᵢ, eⱼ) = ρᵢⱼ γᵢⱼ Rᵢ Rⱼ,   ρ = s δᵢⱼ + (1 − s) Σₖ wₖ exp(−xᵢⱼ / Lₖ)

with several lengths L of a way x, for the errors have several causes at once. One length alone calls a slow error a
drift where it is short, and a quick one where it is long.

| part | share | length | error |
|---|---|---|---|
| single samples | 4 % | – | creeping at a stop (0.2 m), one height or match |
| short | 10 % | 40 m | a link between its vertices, the short scale of the map's heights |
| middle | 70 % | 300 m | what odometry adds and the next 300 m of relief, or links, take away |
| long | 20 % | 2 km | the common shift of a neighbourhood's links, wheel scale and heading |

`support.independent_correlation` measures ρ on drives without a fault. What goes on without evidence is not renewed,
and how much of what a growing σ adds is a new error is not known. So four covariances bound the errors (`models`):
x is the way driven, or that part of it at whose end there was evidence; and γ is 1, where σ grows with one error that
grows (wheel scale, heading), or min(σᵢ/σⱼ, σⱼ/σᵢ), where what is added is independent of what was there: then
cov = min(σᵢ², σⱼ²), that of a random walk.

numpy only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from camber.integrity.learning.common_offset import Floats

PARTS = ((0.1, 40.0), (0.7, 300.0), (0.2, 2000.0))
"""Share and length [m] of the parts that last; the table above."""
SINGLE = 0.04
"""Share of the errors of single samples; the table above."""
_LEAST_M2 = 1e-6  # of a variance; chosen: no position is better known than to a millimetre


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IndependentErrors:
    """n samples: covariance (n, 2, 2) of the independent position, way driven (n,), and that part of it (n,) after
    which there was evidence."""

    covariance_m2: Floats
    driven_m: Floats
    renewed_m: Floats

    def models(self) -> Iterator[Floats]:
        """The covariances (n, 2, n, 2) that bound how the errors go on."""
        root, size_m = _roots(self.covariance_m2)
        ratio = size_m[:, None] / size_m[None, :]
        independent = np.minimum(ratio, 1.0 / ratio)
        for distance_m in (self.driven_m, self.renewed_m):
            correlation = _correlation(np.abs(distance_m[:, None] - distance_m[None, :]))
            for share in (independent, 1.0):
                yield np.einsum("iab,ij,jbc->iajc", root, correlation * share, root)


def _correlation(apart_m: Floats) -> Floats:
    """ρ (n, n)."""
    lasting: Floats = np.sum([share * np.exp(-apart_m / length_m) for share, length_m in PARTS], axis=0)
    return (1.0 - SINGLE) * lasting + SINGLE * np.eye(len(apart_m))


def _roots(covariance_m2: Floats) -> tuple[Floats, Floats]:
    """Symmetric roots (n, 2, 2), by the theorem of Cayley and Hamilton, and their geometric mean sizes (n,)."""
    c = covariance_m2 + _LEAST_M2 * np.eye(2)
    determinant = np.maximum(c[:, 0, 0] * c[:, 1, 1] - c[:, 0, 1] ** 2, _LEAST_M2**2)
    product = np.sqrt(determinant)
    trace = np.sqrt(c[:, 0, 0] + c[:, 1, 1] + 2.0 * product)
    root: Floats = (c + product[:, None, None] * np.eye(2)) / trace[:, None, None]
    return root, np.sqrt(product)
