"""Whether a rover's epoch can be solved with the base's last one: by the differential age, and by its coordinate."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from camber.formats.observations import Floats
from camber.gnss.observations.base_station import BaseStation
from camber.gnss.observations.ephemeris_store import EphemerisStore

BaseProblem = Literal["no_base", "no_base_position", "base_too_old", "base_position_wrong", "base_moved"]
BaseWarning = Literal[
    "base_silent", "base_position_missing", "base_stale", "base_position_wrong", "base_moved"
]


class BaseUse(NamedTuple):
    """The age of the corrections (s); why the base cannot be used, for a solution, and the warning that says so."""

    age_s: float
    reason: BaseProblem | None = None
    warning: BaseWarning | None = None


def base_use(
    base: BaseStation,
    time_ns: int,
    ephemerides: EphemerisStore,
    *,
    ionosphere: Floats,
    longest_age_s: float,
) -> BaseUse:
    """Return whether the base can be used for a rover's epoch of this time, before or after the base's."""
    if base.epoch is None:
        return BaseUse(math.inf, "no_base", "base_silent")
    if base.position_ecef_m is None:
        return BaseUse(math.inf, "no_base_position", "base_position_missing")
    age_s = (time_ns - base.epoch.time_ns) * 1e-9
    if not abs(age_s) <= longest_age_s:
        return BaseUse(age_s, "base_too_old", "base_stale")
    if base.coordinate(ephemerides, ionosphere) == "implausible":
        return BaseUse(age_s, "base_position_wrong", "base_position_wrong")
    if base.move is not None:
        return BaseUse(age_s, "base_moved", "base_moved")
    return BaseUse(age_s)
