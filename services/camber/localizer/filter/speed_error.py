"""The error of the odometer's speed as a state of the filter, while it is estimated.

It is wheel slip while that is suspected (`wheel_slip`), or what a speed that is integrated from an accelerometer is off
by (`inertial.inertial_speed`).
"""

from __future__ import annotations

from camber.localizer.filter.dead_reckoning_time_update import SPEED_ERROR
from camber.localizer.filter.filter_state import FilterState


class SpeedError:
    """Since when the error is estimated, and by how much observations have changed it lately."""

    def __init__(self, state: FilterState, keep_s: float) -> None:
        self._state, self._keep_ns = state, round(keep_s * 1e9)
        self.now_ns = self.since_ns = 0
        self.is_estimated = self.is_integrated = False
        self._updates: list[tuple[int, float]] = []  # times and changes of the error by observations

    def begin(self, since_ns: int, *, is_integrated: bool = False) -> None:
        """Estimate the error since then: of a speed that is integrated, or of wheels that slip."""
        self.is_estimated, self.is_integrated, self.since_ns, self._updates = (
            True,
            is_integrated,
            since_ns,
            [],
        )

    def end(self) -> None:
        """Take the odometer's speed for right."""
        self.is_estimated, self.is_integrated, self._updates = False, False, []
        self._state.set_independent(SPEED_ERROR, 0.0)
        self._state.x[SPEED_ERROR] = 0.0

    def record_update(self, before_m_s: float) -> None:
        """Record by how much an observation has changed the error."""
        if not self.is_estimated:
            return
        oldest_ns = self.now_ns - self._keep_ns
        update = (self.now_ns, float(self._state.x[SPEED_ERROR]) - before_m_s)
        self._updates = [*(one for one in self._updates if one[0] >= oldest_ns), update]

    def duration_s(self, time_ns: int) -> float:
        """Return how long since a time the vehicle has driven with the present error; zero without one."""
        if not self.is_estimated:
            return 0.0
        return (self.now_ns - max(time_ns, self.since_ns)) * 1e-9

    def untracked_m(self, time_ns: int) -> float:
        """Return the distance since a time that the track lacks, by later updates of the error."""
        begin_ns = max(time_ns, self.since_ns)
        return sum(more * (at_ns - begin_ns) * 1e-9 for at_ns, more in self._updates if at_ns > begin_ns)
