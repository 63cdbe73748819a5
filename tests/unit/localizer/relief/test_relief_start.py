"""Heights from which a position starts: those of one track."""

from __future__ import annotations

from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.track import TrackPoint
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.relief_start import ReliefStart

NS = 10**9


def is_due(start: ReliefStart, number: int) -> bool:
    """Add the height of a second, 12 m farther on; is it time to solve?"""
    point = TrackPoint(east_m=12.0 * number, path_m=12.0 * number)
    return start.add_height(number * NS, point, height_m=5.0, sigma_m=0.02, map_sigma_m=0.03)


def test_heights_before_a_gap_in_the_motion_do_not_count_after_it() -> None:
    one, other = (ReliefStart(HeightErrorModel(), MotionModel()) for _ in range(2))
    for number in range(5):
        assert not is_due(one, number)
        assert not is_due(other, number)
    one.forget_before(0)
    other.forget_before(5 * NS)
    numbers = range(5, 200)
    first_due, first_due_after = (next(n for n in numbers if is_due(start, n)) for start in (one, other))
    assert first_due_after == first_due + 5
