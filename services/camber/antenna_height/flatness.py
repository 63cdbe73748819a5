"""Is the road flat? H takes ranging there, and scan matching where it is not."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from camber.antenna_height.body_attitude import Slopes

_NS = 1_000_000_000
_WINDOW_M = 5.0
_LONGEST_STEP_S = 1.0


@dataclass(frozen=True, slots=True)
class FlatRules:
    """Not flat from `*_leave` on, flat again below `*_return`, and no sooner than `dwell_s` after the last change.

    `slope`: steepest slope of the road. `uneven`: how far the road may lie off its plane [m] where the beam meets it.
    """

    slope_leave: float = 0.05
    slope_return: float = 0.04
    uneven_leave_m: float = 0.03
    uneven_return_m: float = 0.02
    dwell_s: float = 2.0


@dataclass(slots=True)
class Flatness:
    """Follows the road under the vehicle. `flat`: None before anything is known.

    Unevenness is how much the road's slope along the way has changed within the last five metres, times
    `reach_m`, the level distance from where the beam meets the road to the antenna.
    """

    rules: FlatRules
    reach_m: float = 1.0
    flat: bool | None = None
    reason: str = ""
    _changed_ns: int = 0
    _time_ns: int = 0
    _driven_m: float = 0.0
    _passed: deque[tuple[float, float]] = field(default_factory=deque)

    def hear(self, time_ns: int, road: Slopes | None, speed_m_s: float | None) -> None:
        """The road of one pose; None: not known, then the last word stands."""
        step_s, self._time_ns = (time_ns - self._time_ns) / _NS, time_ns
        if not 0.0 <= step_s <= _LONGEST_STEP_S or road is None:
            self._passed.clear()
        if road is None:
            return
        self._driven_m += abs(speed_m_s or 0.0) * step_s if self._passed else 0.0
        self._passed.append((self._driven_m, road.forward))
        while self._driven_m - self._passed[0][0] > _WINDOW_M:
            self._passed.popleft()
        slopes = [slope for _, slope in self._passed]
        self._judge(time_ns, road.steepness, (max(slopes) - min(slopes)) * self.reach_m)

    def _judge(self, time_ns: int, steepness: float, uneven_m: float) -> None:
        rules = self.rules
        if self.flat is not False:
            flat = steepness <= rules.slope_leave and uneven_m <= rules.uneven_leave_m
        else:
            flat = steepness <= rules.slope_return and uneven_m <= rules.uneven_return_m
        if flat == self.flat:
            return
        waited = not 0 <= time_ns - self._changed_ns < rules.dwell_s * _NS
        if self.flat is None or waited:
            self.flat, self._changed_ns = flat, time_ns
            self.reason = (
                f"road {'flat' if flat else 'not flat'}: slope {steepness:.3f}, uneven by {uneven_m:.3f} m"
            )
