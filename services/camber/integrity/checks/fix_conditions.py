"""The tests of one fix, as the conditions of the decision table ask for them.

Each is computed when it is first asked for, and only asks: neither history nor learning is changed here.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

from camber.integrity.checks.captured_pose import FixRun
from camber.integrity.checks.carried_position import CarriedPosition
from camber.integrity.checks.chi2_test import AGREES, CONTRADICTS
from camber.integrity.checks.consistency_tests import ALL_AGREE, POSITION_CONTRADICTS, POSITION_UNVERIFIED
from camber.integrity.checks.fix_comparison import FixComparison, compare
from camber.integrity.checks.fix_history import FixHistory, is_precise
from camber.integrity.checks.height_model import HeightModel, RoadPoint, road_at
from camber.integrity.checks.independent_position import IndependentComparison, compare_with_independent
from camber.integrity.checks.pose_offset import offset_from_pose, pose_sigma_m
from camber.integrity.checks.start_rule import StartCount
from camber.integrity.checks.verification import phase_residuals_agree, scan_matching_agrees, verified
from camber.integrity.epoch_inputs import EpochInputs, age_s
from camber.integrity.latest_inputs import LatestInputs
from camber.integrity.learning.height_correction import Correction, Learning
from camber.integrity.learning.height_residual import base_of, key_of
from camber.integrity.learning.offset_causes import Diagnosis
from camber.integrity.pose_provenance import is_provisional, rests_on_fixes
from camber.integrity.re_estimation.requests import limits_after
from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Cause, Evidence
from camber.schemas.pose import Pose


class JudgeState:
    """What the tests of a fix rest on besides the fix: rules, latest inputs, earlier fixes, learning."""

    def __init__(self, rules: Rules, latest: LatestInputs, history: FixHistory, learning: Learning) -> None:
        self.rules, self.latest, self.history, self.learning = rules, latest, history, learning
        self.carried = CarriedPosition(rules.carried, rules.true_sigma, rules.levels.wrong_fix)

    def inputs(self, at_ns: int, alive: frozenset[str]) -> EpochInputs:
        """What is known at this time besides the fix, with the pose at the carried position where that is narrower."""
        inputs = self.latest.inputs(at_ns, alive)
        pose = inputs.pose
        if pose is None or is_provisional(pose) or not pose_sigma_m(pose) <= self.rules.pose_sigma_limit_m:
            return inputs
        return replace(inputs, pose=self.carried.improve(pose))


class FixConditions:
    """The tests of a fix, the last of `trials` estimates; `alive` are the services on the bus."""

    def __init__(self, fix: Fix, state: JudgeState, *, alive: frozenset[str], trials: int) -> None:
        self.fix, self.trials = fix, trials
        self.rules, self.determination = state.rules, state.rules.determination
        self.inputs = state.inputs(fix.time_ns, alive)
        self._state = state

    @property
    def pose(self) -> Pose:
        """The prior pose."""
        assert self.inputs.pose is not None
        return self.inputs.pose

    @property
    def correction(self) -> Correction:
        """The height correction in force."""
        return self._state.learning.correction(
            key_of(base_of(self.fix), self.inputs.pose, self.inputs.antenna)
        )

    @property
    def common_cause(self) -> Cause:
        """The cause of a lasting offset that is common to all fixes."""
        return self._state.learning.diagnosis(None).reported

    @property
    def cause_here(self) -> Cause:
        """The cause of a lasting offset on the road under the fix; none for a fix that is back from it."""
        is_back = self._diagnosis_here.is_of_all_fixes and self.is_back_from_offset
        return "none" if is_back else self._diagnosis_here.reported

    @property
    def has_common_offset(self) -> bool:
        """Are all fixes off by one vector, of the base or the datum, or one that grows, and this one with them?"""
        return self._diagnosis_here.is_of_all_fixes and not self.is_back_from_offset

    @property
    def _diagnosis_here(self) -> Diagnosis:
        return self._state.learning.diagnosis(self.road.surface_id if self.road is not None else None)

    @property
    def is_back_from_offset(self) -> bool:
        """Does it agree again with fixes that were confirmed before the offset of all fixes began?"""
        cause = self._state.learning.diagnosis(None)
        if self.outcome != ALL_AGREE or cause.onset_ns is None or cause.east_north_m is None:
            return False
        # A pose that is wide agrees with fixes that have the offset too.
        narrow = self.comparison.acceptance_radius_m < math.hypot(*cause.east_north_m)
        returned = self._state.carried.has_returned_since(cause.onset_ns, self.fix.time_ns)
        return narrow and returned and not self.began_elsewhere

    # Tests that need neither pose nor road.

    @property
    def has_contradictory_phases(self) -> bool:
        """Do the phases contradict the integers?"""
        return "phase_residuals" in self.determination.tests and self.fix.phase_residuals == "contradictory"

    @cached_property
    def receiver_warning(self) -> str:
        """The receiver's warnings, empty where there are none."""
        if "receiver" not in self.determination.tests:
            return ""
        return self._state.latest.receiver.warning(self.fix.time_ns, self.rules.receiver_max_age_s) or ""

    @property
    def contradicts_confirmed_integers(self) -> bool:
        """Has the fix other integers than one confirmed just before, without a slip between them?"""
        return "continuity" in self.determination.tests and self._state.history.integers.contradict(
            self.fix, self.rules.series.longest_gap_s
        )

    @property
    def since_confirmed_s(self) -> float:
        """Seconds since the last fix of the confirmed arc."""
        return age_s(self._state.history.integers.last_ns, self.fix.time_ns)

    # The height model.

    @property
    def has_datum_mismatch(self) -> bool:
        """Are fix and road in different datums?"""
        return self.pose.road.datum is not None and self.pose.road.datum != self.fix.datum

    @cached_property
    def road(self) -> RoadPoint | None:
        """The road at the fix; None where it is not needed or the fix is beyond the surface's plane."""
        if not self.determination.asks_height:
            return None
        fix, pose = self.fix, self.pose
        # The road's planes are relative to where the pose was at its own time.
        return road_at(pose.road, *offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, pose.time_ns))

    @cached_property
    def is_off_road(self) -> bool:
        """Is the fix beyond the planes of the map, because it is far from the pose or because the pose is wrong?"""
        return self.determination.asks_height and self.road is None

    @cached_property
    def height(self) -> HeightModel | None:
        """Antenna height and correction; None where there is no road to apply them to."""
        if self.road is None:
            return None
        antenna, correction = self.inputs.antenna, self.correction
        assert antenna is not None
        assert antenna.height_m is not None
        assert antenna.sigma_m is not None
        return HeightModel(
            antenna_m=antenna.height_m,
            correction_m=correction.correction_m,
            sigma_m=math.hypot(antenna.sigma_m, correction.sigma_m),
        )

    @cached_property
    def model_sigma_m(self) -> float:
        """σ of road and antenna height together; zero where the height is not tested."""
        if self.road is None or self.height is None:
            return 0.0
        return math.sqrt(self.height.variance_m2(self.road))

    @property
    def has_uncertain_model(self) -> bool:
        """Is the height model worse known than the largest tolerance?"""
        return not self.model_sigma_m <= self.determination.largest_tolerance_m

    @property
    def has_uncertain_road(self) -> bool:
        """Is the road the worse known part of the height model?"""
        assert self.road is not None
        assert self.height is not None
        return not self.road.sigma_m <= self.height.sigma_m

    @property
    def has_invalid_model(self) -> bool:
        """Is the expected height not a number?"""
        if self.road is None or self.height is None:
            return False
        return not math.isfinite(self.height.expected_m(self.road))

    # Consistency with pose and height model.

    @cached_property
    def comparison(self) -> FixComparison:
        """The fix against pose, road and antenna height."""
        return compare(
            self.fix,
            self.pose,
            road=self.road,
            height=self.height,
            sigma=self.rules.true_sigma,
            limits=limits_after(self.determination, self.trials),
        )

    @property
    def contradicts_pose(self) -> bool:
        """Does the horizontal position contradict the pose, in a test that is in use?"""
        return "position" in self.determination.tests and self.comparison.position == CONTRADICTS

    @property
    def is_reference_required(self) -> bool:
        """Is only an independent position evidence of the position?"""
        return self.rules.horizontal_reference == "required"

    @cached_property
    def independent(self) -> IndependentComparison | None:
        """The fix against the independent position; None where there is none, or none is required."""
        if not (self.is_reference_required and self.determination.asks_position):
            return None
        limits = limits_after(self.determination, self.trials)
        return compare_with_independent(self.fix, self.pose, self.rules.true_sigma, limits)

    @property
    def contradicts_independent(self) -> bool:
        """Does the fix contradict the independent position?"""
        return self.independent is not None and self.independent.contradicts

    @property
    def is_unverified_by_independent(self) -> bool:
        """Does the fix neither agree with the independent position nor contradict it?"""
        return self.independent is not None and not self.independent.agrees

    @cached_property
    def began_elsewhere(self) -> bool:
        """Has the run of fixes that it goes on from begun elsewhere than where earlier confirmed fixes lead?"""
        if not self.determination.asks_position or self.is_starting:
            return False
        limits = limits_after(self.determination, self.trials)
        return self._state.carried.began_elsewhere(self.fix, self.pose, limits)

    @property
    def is_elsewhere(self) -> bool:
        """Does it not agree with the independent position, or its run not with where earlier confirmed fixes lead?"""
        return self.is_unverified_by_independent or self.began_elsewhere

    @property
    def off_road_since_ns(self) -> int | None:
        """When the run of the fix began, where its height or that of one before it has contradicted the road."""
        limits = limits_after(self.determination, self.trials)
        height_m, sigma_m = self.comparison.height_m, self.comparison.height_sigma_m
        off_road = height_m is not None and height_m * height_m > limits.height[1] * sigma_m * sigma_m
        return self._state.carried.off_road_since_ns(self.fix, self.pose, off_road=off_road)

    @property
    def has_pose_of_fixes(self) -> bool:
        """Have fixes anchored the pose, so that agreement with it is that of fixes with one another?"""
        return rests_on_fixes(self.pose)

    @property
    def may_be_captured(self) -> bool:
        """Does a fix with the road's height contradict a pose that others anchored by their height alone?"""
        doubtful = self._state.history.captured.support is not None and self.has_pose_of_fixes
        here = self.outcome == POSITION_CONTRADICTS and self.road is not None
        return self.is_reference_required and doubtful and here and not self.contradicts_independent

    @cached_property
    def rival(self) -> FixRun:
        """The run of fixes that contradict the pose, with this one."""
        history = self._state.history
        run = history.run_of(self.fix, self.comparison.position_m)
        return history.captured.rival_with(run, self.rules.capture)

    @property
    def wins_against_pose(self) -> bool:
        """Is it so much likelier that the pose is captured than that the run of fixes is wrong?"""
        rules, rival = self.rules, self.rival
        long_enough = rival.fixes >= rules.start.fixes and rival.duration_s >= rules.start.duration_s
        return long_enough and self._state.history.rival_odds(rival) >= rules.capture.least_odds

    @property
    def rival_detail(self) -> str:
        """The figures of both hypotheses, and those of the comparison."""
        odds = self._state.history.rival_odds(self.rival)
        return f"{self.rival.fixes} such in a row, odds {odds:.2g} that they are right; {self.detail}"

    @property
    def has_position_evidence(self) -> bool:
        """Does the fix agree with an independent position that is narrow enough to contradict it?"""
        narrow_m = self.determination.position_cap_m
        other = self.independent
        return other is not None and other.agrees and other.acceptance_radius_m <= narrow_m

    @property
    def independent_detail(self) -> str:
        """The figures of the independent position, and those of the pose."""
        described = self.independent.describe() if self.independent is not None else ""
        return f"{described}; {self.detail}"

    @cached_property
    def outcome(self) -> int:
        """Index of `consistency.REASONS`; off the road only the position was tested."""
        return POSITION_CONTRADICTS if self.is_off_road else self.comparison.outcome

    @property
    def detail(self) -> str:
        """All figures of the comparison."""
        return self.comparison.describe(pose_sigma_m(self.pose))

    @property
    def has_disagreeing_subset(self) -> bool:
        """Is a subset of the satellites fixed elsewhere?"""
        return "subset_agreement" in self.determination.tests and self.fix.subset_agreement == "disagree"

    # Evidence, verification and start.

    @property
    def is_starting(self) -> bool:
        """Does the pose rest on unconfirmed fixes alone?"""
        return is_provisional(self.pose)

    @cached_property
    def evidence(self) -> tuple[Evidence, ...]:
        """The tests that support a fix that nothing contradicts, and that could have contradicted it."""
        parameters, evidence = self.determination, list[Evidence]()
        if parameters.asks_height:
            evidence.append("height")
        if self.has_position_evidence:
            evidence.append("position")
        # A pose that stems from the fixes themselves, or is metres wide, agrees with everything.
        narrow = self.comparison.acceptance_radius_m <= parameters.position_cap_m
        if parameters.asks_position and narrow and not self.is_starting:
            if not self.is_reference_required:
                evidence.append("position")
            elif self.has_pose_of_fixes:
                evidence.append("consistency")
        if "phase_residuals" in parameters.tests and self.fix.phase_residuals == "consistent":
            evidence.append("phase_residuals")
        if "subset_agreement" in parameters.tests and self.fix.subset_agreement == "agree":
            evidence.append("subset_agreement")
        return tuple(evidence)

    @cached_property
    def verification(self) -> tuple[Evidence, ...]:
        """The evidence that confirms the fix although a test is against it; empty where it does not suffice."""
        if self.is_starting or not is_precise(self.fix, self.rules) or self.is_elsewhere:
            return ()
        evidence = self._verification_evidence()
        if self.outcome != ALL_AGREE and self.comparison.position != AGREES:
            # With the height agreed, the pose is in doubt as much as the fix: only what is independent of it counts.
            doubtful = self.outcome == POSITION_UNVERIFIED
            evidence = tuple(name for name in evidence if doubtful and name == "ambiguity_continuity")
        return evidence if verified(frozenset(evidence), self.rules.verification) else ()

    def _verification_evidence(self) -> tuple[Evidence, ...]:
        fix, pose, rules = self.fix, self.pose, self.rules
        supports: dict[Evidence, bool] = {
            "time_series": self._continues_previous(),
            "ambiguity_continuity": self._state.history.integers.carry(fix, rules.verification),
            "scan_matching": rules.determination.asks_position
            and scan_matching_agrees(
                pose,
                pose_sigma_m=pose_sigma_m(pose),
                at_ns=fix.time_ns,
                max_age_s=rules.pose_max_age_s,
                limit_m=rules.verification.scan_sigma_m,
            ),
            "phase_residuals": phase_residuals_agree(fix, rules.verification),
        }
        return tuple(name for name, applies in supports.items() if applies)

    def _continues_previous(self) -> bool:
        """Does the fix continue the right ones before it, by the poses of both times?"""
        history, latest = self._state.history, self._state.latest
        if history.chain is None:
            return False
        then, now = latest.pose_near(history.chain.time_ns), latest.pose_near(self.fix.time_ns)
        return history.is_consistent_with_previous(self.fix, then, now)

    @cached_property
    def start(self) -> StartCount:
        """The agreeing fixes in a row, with this one."""
        return self._state.history.start_after(
            self.fix, self._state.latest.speed_at(self.fix.time_ns, self.rules.motion_max_age_s)
        )

    @property
    def needs_more_fixes_to_start(self) -> bool:
        """Does the pose rest on unconfirmed fixes, of which not enough agree yet?"""
        return self.is_starting and not self.start.enough(self.rules.start)
