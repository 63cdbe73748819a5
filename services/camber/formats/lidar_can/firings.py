"""Firings of a rotating LiDAR as its packets contain them, by the sensor's own clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from camber.schemas.base import Float32

Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Firings:
    """Firings (n,), each of all beams (b,) of the sensor once.

    `packet` is the index of each firing's packet among those that were decoded, `after_ns` its time after its packet's
    stamp; `turn` ∈ [0, 1) its position in the rotation, from the seam on. Points (n, b, 3) are in the sensor's frame,
    x forward, y left, z up; `returned` is false where nothing came back.
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
        """Return the firings of a slice, a mask or indices."""
        return Firings(**{column.name: getattr(self, column.name)[rows] for column in fields(Firings)})


def joined(parts: Sequence[Firings]) -> Firings:
    """Return the firings one after the other; at least one part."""
    names = (column.name for column in fields(Firings))
    return Firings(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


@dataclass(slots=True, eq=False, kw_only=True)
class Decoded:
    """Content of some packets (p,): `stamp_ns` by the sensor's clock, None for a refused one, and the firings.

    `refused` counts by reason, `details` is the last text of each. `session` distinguishes runs of the sensor, where
    packets contain it. `wrong_rotation` are the packets refused because the sensor does not rotate as it should
    (reason `turn`): earlier packets of the same rotation are void.
    """

    stamp_ns: list[int | None]
    firings: Firings | None = None
    refused: Counter[str] = field(default_factory=Counter)
    details: dict[str, str] = field(default_factory=dict)
    session: int | None = None
    wrong_rotation: set[int] = field(default_factory=set)

    def refuse(self, number: int, reason: str, detail: str) -> None:
        """Refuse one packet."""
        self.stamp_ns[number] = None
        self.refused[reason] += 1
        self.details[reason] = detail
        if reason == "turn":
            self.wrong_rotation.add(number)


class LidarDecoder(Protocol):
    """Decoder of a sensor model. `beam_after_ns` (b,): when each beam fires after its firing's time."""

    interval_ns: int
    beam_after_ns: Int32

    def decode(self, payloads: Sequence[bytes]) -> Decoded:
        """Decode packets in the order of arrival."""


Refusal = tuple[str, str] | None
"""Reason and detail; None for a packet that is accepted."""


def accepted_packets(
    payloads: Sequence[bytes], refusal: Callable[[bytes], Refusal], packet: np.dtype[Any]
) -> tuple[Decoded, NDArray[Any], Int64]:
    """Refuse packets; return the result so far, the accepted packets as one array (a,) and their indices (a,)."""
    decoded = Decoded(stamp_ns=[None] * len(payloads))
    accepted = []
    for number, payload in enumerate(payloads):
        if refused := refusal(payload):
            decoded.refuse(number, *refused)
        else:
            accepted.append(number)
    packets = np.frombuffer(b"".join(payloads[number] for number in accepted), packet)
    return decoded, packets, np.array(accepted, np.int64)
