"""GNSS poses reach Autoware only with the stamp of a trusted fix; modes and limits are Autoware's."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.formats.ros.message_types import new_message
from camber.ros2.pose_selection import PoseLimits, PoseSelection

NS = 1_000_000_000
NOW_NS = 1_764_000_000 * NS
LIMITS = PoseLimits(
    most_yaw_rad=math.radians(0.3),
    most_height_m=0.1,
    gnss_alone_m=0.1,
    most_horizontal_m=0.25,
    timeout_s=1.0,
)


def pose(horizontal_m: float, height_m: float = 0.05, yaw_rad: float = 0.001) -> Any:
    sigmas = np.array([horizontal_m, horizontal_m, height_m, 0.01, 0.01, yaw_rad])
    return new_message(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=None,
        pose=new_message(
            "geometry_msgs/msg/PoseWithCovariance", pose=None, covariance=np.diag(sigmas**2).reshape(-1)
        ),
    )


NDT = pose(0.2, 0.2)


def trusting(*stamps_ns: int) -> PoseSelection:
    selection = PoseSelection(LIMITS)
    for stamp_ns in stamps_ns:
        selection.add_trusted(stamp_ns)
    return selection


def test_without_a_trusted_fix_ndt_poses_pass_unchanged() -> None:
    selection = trusting(NOW_NS - 100_000_000)
    assert selection.gnss(pose(0.01), NOW_NS, NOW_NS) is None
    assert selection.ndt(NDT, NOW_NS) is NDT
    assert selection.source(NOW_NS) == "NDT"


def test_a_precise_trusted_pose_replaces_ndt() -> None:
    selection, gnss = trusting(NOW_NS), pose(0.01)
    assert selection.gnss(gnss, NOW_NS, NOW_NS + 1) is gnss
    assert selection.ndt(NDT, NOW_NS + NS) is None
    assert selection.ndt(NDT, NOW_NS + NS + 1) is NDT, "too old"


@pytest.mark.parametrize(
    ("gnss", "source"),
    [
        (pose(0.1), "GNSS"),
        (pose(0.101), "GNSS_NDT"),
        (pose(0.25), "GNSS_NDT"),
        (pose(0.251), "NDT"),
        (pose(0.01, height_m=0.101), "NDT"),
        (pose(0.01, yaw_rad=math.radians(0.31)), "NDT"),
        (pose(math.nan), "NDT"),
    ],
)
def test_modes_follow_the_limits(gnss: Any, source: str) -> None:
    selection = trusting(NOW_NS)
    assert (selection.gnss(gnss, NOW_NS, NOW_NS) is gnss) == (source != "NDT")
    assert selection.source(NOW_NS) == source


@pytest.mark.parametrize(("gnss_m", "ndt_m"), [(0.1001, 0.3), (0.175, 0.225), (0.25, 0.15)])
def test_between_the_limits_the_ndt_pose_weighs_the_more_the_less_gnss_does(
    gnss_m: float, ndt_m: float
) -> None:
    """README.md of autoware_pose_covariance_modifier, "NDT covariance calculation"."""
    selection = trusting(NOW_NS)
    selection.gnss(pose(gnss_m, height_m=0.1), NOW_NS, NOW_NS)
    weighted = selection.ndt(NDT, NOW_NS)
    assert math.sqrt(weighted.pose.covariance[0]) == pytest.approx(ndt_m, abs=1e-3)
    assert weighted.pose.covariance[35] == NDT.pose.covariance[35]
    assert NDT.pose.covariance[0] == pytest.approx(0.04), "the message itself stays"


def test_an_ndt_covariance_that_is_no_preset_one_stays() -> None:
    selection = trusting(NOW_NS)
    selection.gnss(pose(0.2), NOW_NS, NOW_NS)
    narrow = pose(0.05, 0.05)
    np.testing.assert_array_equal(selection.ndt(narrow, NOW_NS).pose.covariance, narrow.pose.covariance)


def test_an_untrusted_pose_does_not_end_a_trusted_one_at_once() -> None:
    selection = trusting(NOW_NS)
    selection.gnss(pose(0.01), NOW_NS, NOW_NS)
    assert selection.gnss(pose(0.01), NOW_NS + NS // 10, NOW_NS + NS // 10) is None
    assert selection.ndt(NDT, NOW_NS + NS // 10) is None
    assert selection.ndt(NDT, NOW_NS + 2 * NS) is NDT


@given(
    st.lists(st.integers(0, 50), max_size=20),
    st.lists(st.tuples(st.integers(0, 50), st.integers(0, 60)), max_size=30),
)
def test_no_pose_passes_but_of_a_trusted_fix_that_is_fresh(
    trusted: list[int], poses: list[tuple[int, int]]
) -> None:
    selection = trusting(*(NOW_NS + tenth * NS // 10 for tenth in trusted))
    for stamp, now in poses:
        passed = selection.gnss(pose(0.01), NOW_NS + stamp * NS // 10, NOW_NS + now * NS // 10)
        assert (passed is not None) == (stamp in trusted and 0 <= now - stamp <= 10)
