"""What cannot have moved: columns from knee to overhead."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.map_clouds.static_structure import static_mask


def column(low_m: float, high_m: float, x_m: float = 0.2, step_m: float = 0.2) -> np.ndarray:
    up = np.arange(low_m, high_m, step_m)
    return np.column_stack((np.full(len(up), x_m), np.full(len(up), 0.2), up))


def steady(*columns_m: np.ndarray) -> list[bool]:
    """Of each column, whether all of it is steady, or none."""
    points_m = np.concatenate(columns_m)
    result = static_mask(points_m, points_m[:, 2])
    parts = np.split(result, np.cumsum([len(part) for part in columns_m])[:-1])
    assert all(len(set(part.tolist())) == 1 for part in parts)
    return [bool(part[0]) for part in parts]


@pytest.mark.parametrize(
    ("parts_m", "is_steady"),
    [
        ([(0.0, 5.0)], True),  # a wall or a post
        ([(0.0, 1.6)], False),  # a car
        ([(0.0, 2.0)], False),  # a van
        ([(2.6, 6.0)], False),  # a crown
        ([(0.0, 2.7)], True),  # a hoarding
        ([(0.0, 1.5), (2.5, 6.0)], False),  # a car below a crown
        ([(0.0, 1.15), (1.65, 5.0)], True),  # with the gap of a window or a sign
    ],
)
def test_a_column_is_steady_from_knee_to_overhead(
    parts_m: list[tuple[float, float]], is_steady: bool
) -> None:
    assert steady(np.concatenate([column(*part_m) for part_m in parts_m])) == [is_steady]


def test_a_car_next_to_a_post_is_not_made_static_by_it() -> None:
    assert steady(column(0.0, 5.0), column(0.0, 1.5, x_m=0.8)) == [True, False]


def roof(height_m: float, spread_m: float, seed: int = 3) -> np.ndarray:
    grid = np.array(
        [(x, y, height_m) for x in np.arange(-6.0, 6.0, 0.25) for y in np.arange(-6.0, 6.0, 0.25)]
    )
    return grid + np.random.default_rng(seed).normal(0.0, 1.0, grid.shape) * (0.0, 0.0, spread_m)


def test_under_a_roof_whatever_stands_was_built_there() -> None:
    cabinet = column(0.0, 1.6)
    points_m = np.concatenate((cabinet, roof(4.8, 0.02)))
    assert static_mask(points_m, points_m[:, 2])[: len(cabinet)].all()


def test_a_crown_over_the_road_is_no_roof() -> None:
    car = column(0.0, 1.6)
    points_m = np.concatenate((car, roof(5.5, 0.8)))
    assert not static_mask(points_m, points_m[:, 2])[: len(car)].any()


def test_without_a_road_below_nothing_is_steady() -> None:
    points_m = column(0.0, 5.0)
    assert not static_mask(points_m, np.full(len(points_m), np.nan)).any()
    assert len(static_mask(np.zeros((0, 3)), np.zeros(0))) == 0
