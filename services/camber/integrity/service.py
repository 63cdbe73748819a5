"""The judge's process: wires inputs to `judge.py`, publishes verdicts and positions, puts uploads into the outbox."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from camber.integrity.epoch_inputs import EpochInputs, age_s
from camber.integrity.judge import Judge
from camber.integrity.judgement import FixJudgement, verdict_of
from camber.integrity.learning.height_correction import Learning
from camber.integrity.learning.offset_causes import ISSUE_CODES
from camber.integrity.learning.saved_state import from_text, to_text
from camber.integrity.pose_provenance import is_provisional
from camber.integrity.protection.position_output import PositionOutput, unavailable_position
from camber.integrity.publish_schedule import PublishSchedule
from camber.integrity.re_estimation.requests import (
    QueryBackoff,
    conclude_re_estimation,
    estimates_request,
    without_estimates,
)
from camber.integrity.rules import SAME_EPOCH_S
from camber.integrity.settings import IntegritySettings
from camber.integrity.uploads import UploadBatcher, upload_for
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.service import Service
from camber.runtime.state_file import StateFile
from camber.runtime.uploads.uploader import Uploader
from camber.schemas.fleet import UploadBatch
from camber.schemas.gnss import Estimates, EstimatesRequest, Fix
from camber.schemas.integrity import Reason, Verdict

_SERVICES = ("gnss", "localizer", "antenna_height", "map_server")
_SAVE_EVERY = 5  # learning steps between two writes of the correction


class IntegrityService(Service[IntegritySettings]):
    """One verdict per fix; *unknown* with its reason where there is none to judge or nothing to judge it by."""

    NAME = "integrity"
    SETTINGS = IntegritySettings

    def __init__(self, settings: IntegritySettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        if settings.link_delay_s:
            bus.set_link_delay(settings.link_delay_s)
        self._rules = settings.rules()
        self._state = StateFile("correction", settings=settings, bus=bus)
        learning = self._state.load(lambda text: from_text(text, self._rules.learning))
        self._judge = Judge(self._rules, learning or Learning(self._rules.learning))
        self._saved = self._judge.learning.samples
        self._newest_ns = 0  # of all messages received
        self._pending: list[tuple[Fix, int]] = []  # with the time at which each was received
        self._schedule = PublishSchedule()
        self._positions = PositionOutput(self._rules)
        self._gnss = QueryBackoff()
        self._collector = UploadBatcher(settings.upload_every_s)
        self._uploader = self._make_uploader() if settings.upload and settings.state_dir else None

    def _make_uploader(self) -> Uploader:
        assert self.settings.state_dir is not None
        return Uploader(
            self.settings.state_dir / "outbox.sqlite",
            vehicle=self.settings.vehicle,
            source=self.NAME,
            limit_bytes=int(self.settings.outbox_limit_mb * 1e6),
            ask=self.bus.ask_bytes,
        )

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return {
            "fix": self._dated(lambda fix: self._pending.append((fix, self.bus.now_ns()))),
            "pose": self._dated(self._judge.latest.add_pose),
            "antenna_height": self._dated(self._judge.latest.set_antenna_height),
            "receiver_integrity": self._dated(self._judge.latest.receiver.update),
            "velocity": self._dated(self._positions.add_velocity),
            "motion": self._dated(
                lambda motion: self._add_wheel_speed(motion.time_ns, motion.wheel_speed_m_s)
            ),
        }

    def _dated(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def update(message: Any) -> None:
            self._newest_ns = max(self._newest_ns, message.time_ns)
            take(message)

        return update

    def _add_wheel_speed(self, time_ns: int, speed_m_s: float | None) -> None:
        self._judge.latest.add_wheel_speed(time_ns, speed_m_s)
        self._positions.add_wheel_speed(time_ns, speed_m_s)

    def advance(self, now_ns: int) -> None:
        """Judge what can be judged, then say where the vehicle is."""
        alive = self._alive()
        limit_ns = now_ns + round(self._rules.future_limit_s * 1e9)
        if self._newest_ns > limit_ns:  # else nothing that is remembered can be dated later
            self._judge.forget_future(now_ns)
            self._positions.forget_future(now_ns)
            self._schedule.forget_after(limit_ns)
        pending, self._pending = self._pending, []
        for fix, received_ns in pending:
            if self._should_wait(fix, received_ns, now_ns, alive):
                self._pending.append((fix, received_ns))
            else:
                self._judge_fix(fix, now_ns, alive)
        self._publish_pose_position(alive)
        self._break_silence(now_ns, alive)
        self._hand_over(self._collector.due(now_ns))
        self._report()

    def _alive(self) -> frozenset[str]:
        return frozenset(filter(self.bus.is_alive, _SERVICES))

    def _should_wait(self, fix: Fix, received_ns: int, now_ns: int, alive: frozenset[str]) -> bool:
        """A fix waits for the pose of its epoch: not longer than an epoch's width, whatever the clocks do.

        Over a link what is of one epoch comes apart by as much as the link's delay varies.
        """
        pose = self._judge.latest.pose
        if pose is not None and age_s(pose.time_ns, fix.time_ns) <= SAME_EPOCH_S:
            return False
        if age_s(fix.time_ns, now_ns) >= SAME_EPOCH_S or "localizer" not in alive:
            return False
        return 0.0 <= age_s(received_ns, now_ns) < SAME_EPOCH_S + self.settings.link_delay_s

    def _judge_fix(self, fix: Fix, now_ns: int, alive: frozenset[str]) -> None:
        judgement = self._judge.judge(fix, now_ns, alive)
        if judgement is None:
            self.bus.count("fix.judged_already")
            return
        request = estimates_request(judgement, self._rules.re_estimation)
        if request is not None:
            judgement = self._re_estimate(judgement, request, alive)
        self._judge.settle(judgement)
        self.bus.count(f"verdict.{judgement.verdict}")
        self.bus.publish("verdict", self._verdict_of(judgement))
        self._schedule.verdict(now_ns)
        self._positions.update_dispute(judgement)
        if judgement.confirmed:
            inputs = self._judge.inputs(judgement.fix.time_ns, alive)
            correction_m = self._judge.correction(inputs).correction_m
            self.bus.publish("position", self._positions.confirmed(judgement, correction_m, inputs))
            self._schedule.rtk(fix.time_ns)
        self._save(_SAVE_EVERY)
        self._collect(judgement)

    def _verdict_of(self, judgement: FixJudgement) -> Verdict:
        return verdict_of(judgement, self._rules.true_sigma, self._rules.horizontal_reference)

    def _re_estimate(
        self, judgement: FixJudgement, request: EstimatesRequest, alive: frozenset[str]
    ) -> FixJudgement:
        """Return the judgement of another estimate of the fix where one passes, else the one given."""
        rules, fix = self._rules.re_estimation, judgement.fix
        asked_ns, inputs = self.bus.now_ns(), self._judge.inputs(fix.time_ns, alive)
        pose, missing = inputs.pose, inputs.missing(fix.time_ns, self._rules)
        # A provisional pose follows the fixes: it is no independent evidence.
        if pose is None or missing is not None or is_provisional(pose):
            return judgement
        if not self._gnss.is_ready(asked_ns):
            return without_estimates(judgement, "gnss has just not answered")
        late = age_s(fix.time_ns, asked_ns) > self._rules.fix_max_age_s / 2.0
        if self.settings.link_delay_s and late:
            self.bus.count(
                "estimates.too_late"
            )  # another round trip, and the fixes that wait would be too old
            return without_estimates(judgement, "the judge is late already")
        try:
            answer: Estimates = self.bus.ask("estimates", request)
        except QueryFailed as error:
            if error.reason != "absent":
                self._gnss.register_timeout(self.bus.now_ns())
            self.bus.count(f"estimates.{error.reason}")
            return without_estimates(judgement, str(error))
        result = conclude_re_estimation(
            judgement, answer, lambda other, n: self._judge.examine(other, alive, n), rules
        )
        self.bus.count(f"estimates.{'confirmed' if result.confirmed else answer.status}")
        return result

    def _publish_pose_position(self, alive: frozenset[str]) -> None:
        pose = self._judge.latest.pose
        if pose is None or not self._schedule.pose_is_due(pose.time_ns):
            return
        inputs = self._judge.inputs(pose.time_ns, alive)
        self._schedule.position(pose.time_ns)
        self.bus.publish(
            "position", self._positions.at(pose.time_ns, inputs, self._judge.correction(inputs).correction_m)
        )

    def _break_silence(self, now_ns: int, alive: frozenset[str]) -> None:
        """Publish *unknown* when there is no fix or no pose."""
        verdict_is_due = not self._pending and self._schedule.verdict_is_due(now_ns)
        position_is_due = self._schedule.position_is_due(now_ns, self._rules.pose_max_age_s)
        if not (verdict_is_due or position_is_due):
            return
        inputs = self._judge.inputs(now_ns, alive)
        reason = self._silence_reason(now_ns, inputs)
        if reason is not None and verdict_is_due:
            self._schedule.verdict(now_ns)
            self.bus.publish(
                "verdict",
                Verdict(
                    time_ns=now_ns,
                    fix_id=None,
                    verdict="unknown",
                    reason=reason,
                    horizontal_reference=self._rules.horizontal_reference,
                ),
            )
        missing = inputs.missing_pose(now_ns, self._rules) or reason
        if missing is not None and position_is_due:
            self._schedule.unavailable_position(now_ns)
            position = self._positions.at(now_ns, inputs, self._judge.correction(inputs).correction_m)
            if position.source == "none":
                position = unavailable_position(now_ns, missing, self._rules)
            self.bus.publish("position", position)

    def _silence_reason(self, now_ns: int, inputs: EpochInputs) -> Reason | None:
        last_ns = self._judge.last_fix_ns
        if "gnss" not in inputs.alive:
            return "gnss_absent"
        if last_ns is None or not age_s(last_ns, now_ns) <= self._rules.fix_max_age_s:
            return "gnss_stale"
        return inputs.missing(now_ns, self._rules)

    def _collect(self, judgement: FixJudgement) -> None:
        upload = upload_for(judgement, self.settings.vehicle, self._rules.true_sigma)
        if upload is not None and self._uploader is not None:
            self._hand_over(self._collector.add(upload))

    def _hand_over(self, batch: UploadBatch | None) -> None:
        if batch is not None and self._uploader is not None:
            self._uploader.put(batch.batch_id, "upload_batch", batch)

    def _report(self) -> None:
        for named in self._judge.learning.news():
            self.bus.issue(ISSUE_CODES[named.reported], named.text)
        for code, text in self._uploader.problems() if self._uploader is not None else ():
            self.bus.issue(code, text)

    def _save(self, least: int) -> None:
        """Write the correction where it has been learnt from `least` positions since."""
        learning = self._judge.learning
        if self._state.path is None or learning.samples < self._saved + least:
            return
        self._saved = learning.samples
        self._state.save(to_text(learning))

    def gauges(self) -> dict[str, float]:
        """Fixes that wait for their pose, and uploads that wait."""
        uploads = {} if self._uploader is None else self._uploader.waiting()
        return {"fixes_waiting": float(len(self._pending)), **uploads}

    def close(self) -> None:
        """Judge what waits, keep what was learnt, make the last uploads durable."""
        now_ns, alive = self.bus.now_ns(), self._alive()
        pending, self._pending = self._pending, []
        for fix, _ in pending:
            self._judge_fix(fix, now_ns, alive)
        self._save(1)
        self._hand_over(self._collector.take())
        if self._uploader is not None:
            self._uploader.close()
            self._report()


SERVICE = IntegrityService
