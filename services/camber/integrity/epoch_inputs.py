"""The inputs of the judge at one time, and the ordered checks that they are complete.

The checks run in this order; the first that applies gives the reason published, so the most direct cause comes first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from camber.integrity.checks.pose_gate import can_move_on, claimed_sigma_m, pose_sigma_m
from camber.integrity.rules import SAME_EPOCH_S, Rules
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Reason
from camber.schemas.pose import Pose


def age_s(time_ns: int, now_ns: int) -> float:
    """Return the seconds since `time_ns`; negative for what is dated ahead."""
    return (now_ns - time_ns) / 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class EpochInputs:
    """The inputs nearest to a time `at_ns`, and which services are alive."""

    pose: Pose | None
    antenna: AntennaHeight | None
    alive: frozenset[str]

    @property
    def known_pose(self) -> Pose:
        """The pose, where it is known that there is one."""
        assert self.pose is not None
        return self.pose

    def missing_pose(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return why the pose cannot be used, None where it can."""
        return _first_reason(POSE_CHECKS, self, at_ns, rules)

    def missing_antenna(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return why the antenna height cannot be used, None where it can."""
        return _first_reason(ANTENNA_CHECKS, self, at_ns, rules)

    def missing_road(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return why the road below the pose cannot be used, None where it can."""
        return "pose_missing" if self.pose is None else _first_reason(ROAD_CHECKS, self, at_ns, rules)

    def missing(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return the first input that is missing for a verdict at this time."""
        return _first_reason(input_checks(rules), self, at_ns, rules)

    def lacks_pose_at(self, at_ns: int, rules: Rules) -> bool:
        """Is there no pose within its age limit?"""
        return self.pose is None or not abs(age_s(self.pose.time_ns, at_ns)) <= rules.pose_max_age_s

    def lacks_antenna_at(self, at_ns: int, rules: Rules) -> bool:
        """Is there no antenna height within its age limit?"""
        return self.antenna is None or not abs(age_s(self.antenna.time_ns, at_ns)) <= rules.antenna_max_age_s


@dataclass(frozen=True, slots=True, kw_only=True)
class InputCheck:
    """One reason why no verdict can be given: `applies` is asked only where no check before it applied."""

    reason: Reason
    explanation: str
    applies: Callable[[EpochInputs, int, Rules], bool]


def _first_reason(
    checks: Sequence[InputCheck], inputs: EpochInputs, at_ns: int, rules: Rules
) -> Reason | None:
    return next((check.reason for check in checks if check.applies(inputs, at_ns, rules)), None)


def input_checks(rules: Rules) -> tuple[InputCheck, ...]:
    """Return the checks for a verdict: road and antenna only where the height is tested."""
    return (*POSE_CHECKS, *ANTENNA_CHECKS, *ROAD_CHECKS) if rules.determination.asks_height else POSE_CHECKS


def _lacks_position(pose: Pose) -> bool:
    undefined = pose.mode == "none" or pose.provenance == "none"
    return undefined or None in (pose.latitude_rad, pose.longitude_rad, pose.covariance_east_north_yaw)


def _is_same_epoch(pose: Pose, at_ns: int) -> bool:
    return abs(age_s(pose.time_ns, at_ns)) <= SAME_EPOCH_S


def _no_road_because(reason: str) -> Callable[[EpochInputs, int, Rules], bool]:
    def applies(inputs: EpochInputs, at_ns: int, rules: Rules) -> bool:
        road = inputs.known_pose.road
        return road.status != "known" and road.reason == reason

    return applies


def _has_no_road(inputs: EpochInputs, at_ns: int, rules: Rules) -> bool:
    road = inputs.known_pose.road
    return road.status != "known" or road.elevation_m is None or road.sigma_m is None


POSE_CHECKS: tuple[InputCheck, ...] = (
    InputCheck(
        reason="localizer_absent",
        explanation="no pose within its age limit, and the localizer has left the bus",
        applies=lambda inputs, at_ns, rules: (
            inputs.lacks_pose_at(at_ns, rules) and "localizer" not in inputs.alive
        ),
    ),
    InputCheck(
        reason="pose_missing",
        explanation="no pose yet, or one without position, covariance or provenance",
        applies=lambda inputs, at_ns, rules: (
            inputs.pose is None or (not inputs.lacks_pose_at(at_ns, rules) and _lacks_position(inputs.pose))
        ),
    ),
    InputCheck(
        reason="pose_stale",
        explanation="no pose within its age limit, or one of another epoch without speed or direction",
        applies=lambda inputs, at_ns, rules: (
            inputs.lacks_pose_at(at_ns, rules)
            or not (_is_same_epoch(inputs.known_pose, at_ns) or can_move_on(inputs.known_pose))
        ),
    ),
    InputCheck(
        reason="pose_too_uncertain",
        explanation="the pose's σ is above `pose_sigma_limit_m`, or its covariance is invalid",
        applies=lambda inputs, _, rules: not pose_sigma_m(inputs.known_pose) <= rules.pose_sigma_limit_m,
    ),
)
ANTENNA_CHECKS: tuple[InputCheck, ...] = (
    InputCheck(
        reason="antenna_height_absent",
        explanation="no antenna height within its age limit, and its service has left the bus",
        applies=lambda inputs, at_ns, rules: (
            inputs.lacks_antenna_at(at_ns, rules) and "antenna_height" not in inputs.alive
        ),
    ),
    InputCheck(
        reason="antenna_height_stale",
        explanation="no antenna height within its age limit",
        applies=lambda inputs, at_ns, rules: (
            inputs.antenna is not None and inputs.lacks_antenna_at(at_ns, rules)
        ),
    ),
    InputCheck(
        reason="antenna_height_disagrees",
        explanation="the methods of measuring the antenna height contradict one another",
        applies=lambda inputs, at_ns, _: (
            inputs.antenna is not None and inputs.antenna.status == "disagreement"
        ),
    ),
    InputCheck(
        reason="antenna_height_missing",
        explanation="the antenna height is not known",
        applies=lambda inputs, at_ns, _: (
            inputs.antenna is None
            or inputs.antenna.status != "known"
            or None in (inputs.antenna.height_m, inputs.antenna.sigma_m)
        ),
    ),
)
ROAD_CHECKS: tuple[InputCheck, ...] = (
    InputCheck(
        reason="pose_missing",
        explanation="the localizer has no pose for the road",
        applies=_no_road_because("no_pose"),
    ),
    InputCheck(
        reason="pose_too_uncertain",
        explanation="the pose is too uncertain to select a road",
        applies=_no_road_because("pose_too_uncertain"),
    ),
    InputCheck(
        reason="levels_ambiguous",
        explanation="several decks, one above another, that cannot be distinguished",
        applies=_no_road_because("levels_ambiguous"),
    ),
    InputCheck(
        reason="map_server_absent",
        explanation="the map server does not answer",
        applies=_no_road_because("map_server_absent"),
    ),
    InputCheck(
        reason="datum_mismatch",
        explanation="the localizer reports a map in another datum",
        applies=_no_road_because("datum_mismatch"),
    ),
    InputCheck(reason="road_unknown", explanation="the map has no road below the pose", applies=_has_no_road),
    InputCheck(
        reason="datum_mismatch",
        explanation="the datum of the road's heights is not known",
        applies=lambda inputs, at_ns, _: inputs.known_pose.road.datum is None,
    ),
)


def unusable_fix(fix: Fix, rules: Rules) -> Reason | None:
    """Why a solution is no fix that could be confirmed, whatever the road says.

    Resolved integers make centimetres: one that claims less by its own account is none.
    """
    if fix.quality != "fixed":
        return "not_a_fix"
    place_is_known = all(map(math.isfinite, (fix.latitude_rad, fix.longitude_rad, fix.height_m)))
    if fix.covariance_enu_m2 is None or not place_is_known:
        return "fix_implausible"
    return None if claimed_sigma_m(fix.covariance_enu_m2) <= rules.fix_sigma_limit_m else "fix_implausible"
