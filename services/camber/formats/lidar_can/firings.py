"""What the packets of a rotating LiDAR hold, whoever made it: firings, by the sensor's own clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from camber.schemas.base import Float32

Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Firings:
    """Firings (n,), in each all beams (b,) of the sensor once.

    `packet` is the place of each firing's packet among those that were decoded, `after_ns` its time after its packet's
    stamp; `turn` ∈ [0, 1) its place in the turn, from the seam on. Points (n, b, 3) are in the sensor's frame, x
    forward, y left, z up; where `returned` is false nothing came back.
    """

    packet: Int64
    after_ns: Int64
    turn: Float64
    points_m: Float32
    intensity: Float32
    returned: Bools

    def __len__(self) -> int:
        return len(self.packet)

    def chosen(self, rows: slice | Bools | Int64) -> Firings:
        """Some of them."""
        return Firings(
            self.packet[rows],
            self.after_ns[rows],
            self.turn[rows],
            self.points_m[rows],
            self.intensity[rows],
            self.returned[rows],
        )


def joined(parts: Sequence[Firings]) -> Firings:
    """One after the other; at least one part."""
    return Firings(
        np.concatenate([part.packet for part in parts]),
        np.concatenate([part.after_ns for part in parts]),
        np.concatenate([part.turn for part in parts]),
        np.concatenate([part.points_m for part in parts]),
        np.concatenate([part.intensity for part in parts]),
        np.concatenate([part.returned for part in parts]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """Of some packets (p,): `stamp_ns` by the sensor's clock, and of those that could be read the firings.

    `stamp_ns` is None for a packet that was refused; why stands in `refused`, by reason, with the last one's words in
    `details`. `session` is what tells one run of the sensor from the next, where packets say it. `otherwise` are those
    that were refused because the sensor does not turn as it should: what came before them of a turn is void.
    """

    stamp_ns: Sequence[int | None]
    firings: Firings | None
    refused: Counter[str]
    details: Mapping[str, str]
    session: int | None = None
    otherwise: frozenset[int] = frozenset()


class LidarDecoder(Protocol):
    """A model of sensor. `beam_after_ns` (b,): when each beam fires after its firing's time."""

    interval_ns: int
    beam_after_ns: Int32

    def decode(self, payloads: Sequence[bytes]) -> Decoded:
        """Of packets as they arrived."""
