"""The inputs of the judge at one time, and the ordered checks that they are complete.

The checks run in this order; the first that applies gives the reason published, so the most direct cause comes first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from camber.integrity.checks.pose_offset import can_move_on, pose_sigma_m
from camber.integrity.rules import SAME_EPOCH_S, Rules
from camber.schemas.antenna import AntennaHeight
from camber.schemas.integrity import Reason
from camber.schemas.pose import Pose, RoadReason

SubjectT = TypeVar("SubjectT")


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
        return first_reason(POSE_CHECKS, self, at_ns, rules)

    def missing_antenna(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return why the antenna height cannot be used, None where it can."""
        return first_reason(ANTENNA_CHECKS, self, at_ns, rules)

    def missing_road(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return why the road below the pose cannot be used, None where it can."""
        return "pose_missing" if self.pose is None else first_reason(ROAD_CHECKS, self, at_ns, rules)

    def missing(self, at_ns: int, rules: Rules) -> Reason | None:
        """Return the first input that is missing for a verdict at this time."""
        return first_reason(input_checks(rules), self, at_ns, rules)

    def lacks_pose_at(self, at_ns: int, rules: Rules) -> bool:
        """Is there no pose within its age limit?"""
        return self.pose is None or not abs(age_s(self.pose.time_ns, at_ns)) <= rules.pose_max_age_s

    def lacks_antenna_at(self, at_ns: int, rules: Rules) -> bool:
        """Is there no antenna height within its age limit?"""
        return self.antenna is None or not abs(age_s(self.antenna.time_ns, at_ns)) <= rules.antenna_max_age_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Generic[SubjectT]):
    """One reason why no verdict can be given: `applies` is asked only where no check before it applied."""

    reason: Reason
    explanation: str
    applies: Callable[[SubjectT, int, Rules], bool]


def first_reason(
    checks: Sequence[Check[SubjectT]], subject: SubjectT, at_ns: int, rules: Rules
) -> Reason | None:
    """Return the reason of the first check that applies to this subject at this time."""
    for check in checks:
        if check.applies(subject, at_ns, rules):
            return check.reason
    return None


def input_checks(rules: Rules) -> tuple[Check[EpochInputs], ...]:
    """Return the checks for a verdict: road and antenna only where the height is tested."""
    return (*POSE_CHECKS, *ANTENNA_CHECKS, *ROAD_CHECKS) if rules.determination.asks_height else POSE_CHECKS


def _lacks_position(pose: Pose) -> bool:
    undefined = pose.mode == "none" or pose.provenance == "none"
    return undefined or None in (pose.latitude_rad, pose.longitude_rad, pose.covariance_east_north_yaw)


def _is_same_epoch(pose: Pose, at_ns: int) -> bool:
    return abs(age_s(pose.time_ns, at_ns)) <= SAME_EPOCH_S


def _has_no_road(inputs: EpochInputs, at_ns: int, rules: Rules) -> bool:
    road = inputs.known_pose.road
    return road.status != "known" or road.elevation_m is None or road.sigma_m is None


def _check(
    reason: Reason, explanation: str, applies: Callable[[EpochInputs, int, Rules], bool]
) -> Check[EpochInputs]:
    return Check(reason=reason, explanation=explanation, applies=applies)


def _road_check(reason: Reason, explanation: str, road_reason: RoadReason) -> Check[EpochInputs]:
    def applies(inputs: EpochInputs, at_ns: int, rules: Rules) -> bool:
        road = inputs.known_pose.road
        return road.status != "known" and road.reason == road_reason

    return _check(reason, explanation, applies)


POSE_CHECKS = (
    _check(
        "localizer_absent",
        "no pose within its age limit, and the localizer has left the bus",
        lambda inputs, at_ns, rules: inputs.lacks_pose_at(at_ns, rules) and "localizer" not in inputs.alive,
    ),
    _check(
        "pose_missing",
        "no pose yet, or one without position, covariance or provenance",
        lambda inputs, at_ns, rules: (
            inputs.pose is None or (not inputs.lacks_pose_at(at_ns, rules) and _lacks_position(inputs.pose))
        ),
    ),
    _check(
        "pose_stale",
        "no pose within its age limit, or one of another epoch without speed or direction",
        lambda inputs, at_ns, rules: (
            inputs.lacks_pose_at(at_ns, rules)
            or not (_is_same_epoch(inputs.known_pose, at_ns) or can_move_on(inputs.known_pose))
        ),
    ),
    _check(
        "pose_too_uncertain",
        "the pose's σ is above `pose_sigma_limit_m`, or its covariance is invalid",
        lambda inputs, _, rules: not pose_sigma_m(inputs.known_pose) <= rules.pose_sigma_limit_m,
    ),
)
ANTENNA_CHECKS = (
    _check(
        "antenna_height_absent",
        "no antenna height within its age limit, and its service has left the bus",
        lambda inputs, at_ns, rules: (
            inputs.lacks_antenna_at(at_ns, rules) and "antenna_height" not in inputs.alive
        ),
    ),
    _check(
        "antenna_height_stale",
        "no antenna height within its age limit",
        lambda inputs, at_ns, rules: inputs.antenna is not None and inputs.lacks_antenna_at(at_ns, rules),
    ),
    _check(
        "antenna_height_disagrees",
        "the methods of measuring the antenna height contradict one another",
        lambda inputs, at_ns, _: inputs.antenna is not None and inputs.antenna.status == "disagreement",
    ),
    _check(
        "antenna_height_missing",
        "the antenna height is not known",
        lambda inputs, at_ns, _: (
            inputs.antenna is None
            or inputs.antenna.status != "known"
            or None in (inputs.antenna.height_m, inputs.antenna.sigma_m)
        ),
    ),
)
ROAD_CHECKS = (
    _road_check("pose_missing", "the localizer has no pose for the road", "no_pose"),
    _road_check("pose_too_uncertain", "the pose is too uncertain to select a road", "pose_too_uncertain"),
    _road_check(
        "levels_ambiguous",
        "several decks, one above another, that cannot be distinguished",
        "levels_ambiguous",
    ),
    _road_check("map_server_absent", "the map server does not answer", "map_server_absent"),
    _road_check("datum_mismatch", "the localizer reports a map in another datum", "datum_mismatch"),
    _check("road_unknown", "the map has no road below the pose", _has_no_road),
    _check(
        "datum_mismatch",
        "the datum of the road's heights is not known",
        lambda inputs, at_ns, _: inputs.known_pose.road.datum is None,
    ),
)
