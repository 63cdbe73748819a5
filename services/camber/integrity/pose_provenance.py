"""What a pose rests on: fixes that nothing has confirmed, fixes that were confirmed, or none."""

from __future__ import annotations

from camber.schemas.pose import Pose


def is_provisional(pose: Pose) -> bool:
    """Does the pose rest on unconfirmed fixes alone?"""
    return pose.provenance == "fixes" or pose.mode == "provisional"


def rests_on_fixes(pose: Pose) -> bool:
    """Have confirmed positions entered it?"""
    return pose.provenance == "confirmed" or pose.mode == "anchored" or pose.anchor_time_ns is not None
