"""Static transforms are chained to the vehicle's frame, whatever their order and tree."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from camber.formats.ros.static_frames import StaticFrames, rotation_from_quaternion

NUMBERS = st.floats(-5.0, 5.0)
QUATERNIONS = st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS).filter(lambda q: np.linalg.norm(q) > 0.01)


def tf(*links: tuple[str, str, Any, Any]) -> Any:
    """A TFMessage of (parent, child, quaternion x y z w, translation)."""
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(frame_id=parent),
                child_frame_id=child,
                transform=SimpleNamespace(
                    rotation=SimpleNamespace(**dict(zip("xyzw", turn, strict=True))),
                    translation=SimpleNamespace(**dict(zip("xyz", place, strict=True))),
                ),
            )
            for parent, child, turn, place in links
        ]
    )


@settings(max_examples=50, derandomize=True)
@given(turns=st.tuples(*[QUATERNIONS] * 3), places=st.tuples(*[st.tuples(NUMBERS, NUMBERS, NUMBERS)] * 3))
def test_a_chain_over_a_common_parent_is_that_of_scipy(turns: Any, places: Any) -> None:
    frames = StaticFrames()
    links = [("body", "base_link"), ("/body", "/roof"), ("roof", "lidar")]
    for (parent, child), turn, place in zip(links, turns, places, strict=True):
        frames.add(tf((parent, child, turn, place)))
    base, roof, lidar = (
        RigidTransform.from_components(place, Rotation.from_quat(turn))
        for turn, place in zip(turns, places, strict=True)
    )
    expected = (base.inv() * roof * lidar).as_matrix()
    assert np.allclose(frames.base_from("base_link", "lidar"), expected, atol=1e-9)
    assert np.allclose(frames.base_from("base_link", "base_link"), np.eye(4), atol=1e-12)


def test_a_frame_that_nothing_connects_is_unknown() -> None:
    frames = StaticFrames()
    frames.add(tf(("base_link", "lidar", (0, 0, 0, 1), (1, 2, 3)), ("other", "gps", (0, 0, 0, 1), (0, 0, 0))))
    assert frames.base_from("base_link", "gps") is None
    assert frames.base_from("base_link", "nowhere") is None
    assert "gps" in frames
    assert "/other" in frames
    assert "nowhere" not in frames


def test_a_loop_ends() -> None:
    frames = StaticFrames()
    frames.add(tf(("a", "b", (0, 0, 0, 1), (1, 0, 0)), ("b", "a", (0, 0, 0, 1), (1, 0, 0))))
    assert frames.base_from("base_link", "a") is None


@pytest.mark.parametrize(
    "quaternion", [(0.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0), (np.inf, 0.0, 0.0, 1.0)]
)
def test_a_quaternion_without_direction_is_refused(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="expected a length above zero"):
        rotation_from_quaternion(*quaternion)


def test_a_place_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        StaticFrames().add(tf(("base_link", "lidar", (0, 0, 0, 1), (np.nan, 0, 0))))
