"""The method whose height is published, and the reason where it is not the configured one.

The automatic choice of JP7707657B2 is ranging where the road is flat, and scan matching otherwise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

from camber.antenna_height.available_heights import Heights
from camber.antenna_height.body_attitude import Slopes
from camber.schemas.antenna import AntennaHeight, HeightMethod

_WINDOW_M = 5.0  # chosen: some lengths from the antenna to where the beam meets the road
_LONGEST_STEP_S = 1.0  # chosen: after a longer gap in the poses the road between is not known
_AUTOMATIC: dict[bool, tuple[HeightMethod, ...]] = {
    True: ("ranging", "scan_matching", "stroke", "fixed"),
    False: ("scan_matching", "ranging", "stroke", "fixed"),
}
"""By whether the road is flat the preferred method and its substitutes (JP7707657B2, third embodiment)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatRules:
    """Not flat above `*_leave`, flat again below `*_return`, and no sooner than `dwell_s` after the last change.

    `slope`: steepest slope of the road. `uneven`: distance of the road from its plane [m] where the beam meets it.
    """

    slope_leave: float = 0.05
    slope_return: float = 0.04
    uneven_leave_m: float = 0.03
    uneven_return_m: float = 0.02
    dwell_s: float = 2.0


@dataclass(slots=True, kw_only=True)
class Flatness:
    """The state of the road below the vehicle. `flat`: None before the road is known.

    Unevenness is the change of the road's slope ahead within the last five metres, times `reach_m`, the level distance
    from where the beam meets the road to the antenna.
    """

    rules: FlatRules
    reach_m: float = 1.0
    flat: bool | None = None
    reason: str = ""
    _changed_ns: int = 0
    _time_ns: int = 0
    _driven_m: float = 0.0
    _passed: deque[tuple[float, float]] = field(default_factory=deque)

    def update(self, time_ns: int, road: Slopes | None, speed_m_s: float | None) -> None:
        """Add the road of one pose; None: not known, the last state stays."""
        step_s, self._time_ns = (time_ns - self._time_ns) / 1e9, time_ns
        if not 0.0 <= step_s <= _LONGEST_STEP_S or road is None:
            self._passed.clear()
        if road is None:
            return
        self._driven_m += abs(speed_m_s or 0.0) * step_s if self._passed else 0.0
        self._passed.append((self._driven_m, road.forward))
        while self._driven_m - self._passed[0][0] > _WINDOW_M:
            self._passed.popleft()
        slopes = [slope for _, slope in self._passed]
        self._classify(time_ns, road.steepness, (max(slopes) - min(slopes)) * self.reach_m)

    def _classify(self, time_ns: int, steepness: float, uneven_m: float) -> None:
        rules = self.rules
        slope, limit_m = rules.slope_leave, rules.uneven_leave_m
        if self.flat is False:
            slope, limit_m = rules.slope_return, rules.uneven_return_m
        flat = steepness <= slope and uneven_m <= limit_m
        dwells = 0 <= time_ns - self._changed_ns < rules.dwell_s * 1e9
        if flat == self.flat or (self.flat is not None and dwells):
            return
        self.flat, self._changed_ns = flat, time_ns
        state = "flat" if flat else "not flat"
        self.reason = f"road {state}: slope {steepness:.3f}, uneven by {uneven_m:.3f} m"


def select_method(
    configured: HeightMethod | Literal["automatic"], heights: Heights, flatness: Flatness
) -> tuple[HeightMethod | None, str]:
    """Return the method whose height is published and, where it is not the preferred one, why.

    A configured method has no substitute: such a vehicle has none.
    """
    if configured != "automatic":
        return (configured, "") if configured in heights.known else (None, heights.missing[configured])
    order = _AUTOMATIC[flatness.flat is not False]
    first = next((method for method in order if method in heights.known), None)
    why = flatness.reason or "road not known"
    if first == order[0]:
        return first, "" if flatness.reason else why
    reason = f"{why}; {heights.missing[order[0]]}"
    return first, reason if first is None else f"{reason}: {first} instead"


def antenna_height_message(
    time_ns: int, selected: tuple[HeightMethod | None, str], heights: Heights, *, disagreement: str
) -> AntennaHeight:
    """Return the message. A disagreement is no height, whichever method was selected."""
    method, reason = selected
    chosen = None if method is None else heights.known[method]
    others = tuple(height for height in heights.known.values() if height is not chosen)
    if disagreement:
        everything = others if chosen is None else (chosen, *others)
        return AntennaHeight(
            time_ns=time_ns, status="disagreement", reason=disagreement[:500], others=everything
        )
    if chosen is None:
        return AntennaHeight(time_ns=time_ns, status="unknown", reason=reason[:500], others=others)
    return AntennaHeight(
        time_ns=time_ns, status="known", reason=reason[:500], others=others, **chosen.model_dump()
    )
