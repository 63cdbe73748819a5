"""What the horizontal position of the pose rests on."""

from __future__ import annotations

from typing import Final

from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.schemas.pose import HorizontalBasis

_GIVEN_FOR_M: Final = 100.0  # chosen: dead reckoning errs by at most 1 % of the distance, 1 m


def horizontal_basis(estimate: PoseEstimate, *, since_given_m: float) -> HorizontalBasis:
    """Return the newest source of a pose; `since_given_m`: distance driven since a given pose was used.

    `fixes` from the first confirmed position on, until a match determines the position; `odometry` where a match or a
    given pose is no longer fresh. A pose that has been anchored rests on fixes too; only the independent position does
    not.
    """
    if estimate.mode == "none":
        return "none"
    if estimate.mode == "scan_match":
        return "scan_match"
    anchored, matched = estimate.anchor_time_ns, estimate.match_time_ns
    is_newer = anchored is not None and (matched is None or anchored > matched)
    if estimate.provenance == "fixes" or is_newer:
        return "fixes"
    return "given" if matched is None and since_given_m <= _GIVEN_FOR_M else "odometry"
