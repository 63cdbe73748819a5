"""Raw measurements of one epoch as a receiver reports them, in the messages of any maker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Integers, ObservationEpoch


@dataclass(frozen=True, slots=True, eq=False)
class ReceiverEpoch:
    """All observations of one epoch of the rover, and whether it has just reset its clock by whole ms."""

    epoch: ObservationEpoch
    clock_reset: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class OmittedMeasurements:
    """Number of measurements omitted: of unsupported systems, unknown signals, repeated ones, a second antenna."""

    other_systems: int
    unknown_signals: int
    repeated: int
    other_antennas: int = 0


def first_rows(known: NDArray[np.bool_], keys: Integers) -> tuple[Integers, int]:
    """Return the rows of known signals, the first of each, in order; and how many were repeated."""
    used = np.flatnonzero(known)
    if len(set(keys[used].tolist())) == used.size:
        return used, 0
    firsts = np.sort(np.unique(keys[used], return_index=True)[1])
    return used[firsts], used.size - firsts.size
