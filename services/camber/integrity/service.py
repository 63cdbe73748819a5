"""The judge's process: wires inputs to `judge.py`, publishes verdicts and positions, puts uploads into the outbox."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from camber.integrity.judge import Judge
from camber.integrity.judgement import Judgement, verdict_of
from camber.integrity.learning import Correction, LearningRules, correction_from_text, text_from_correction
from camber.integrity.position import no_position, pose_position, rtk_position
from camber.integrity.rules import SAME_EPOCH_S
from camber.integrity.settings import IntegritySettings
from camber.integrity.situation import Situation, age_s
from camber.integrity.spoken import Spoken
from camber.integrity.uploads import Collector, upload_for
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.uploader import Uploader
from camber.schemas.fleet import UploadBatch
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Reason, Verdict

_SERVICES = ("gnss", "localizer", "antenna_height", "map_server")
_SAVE_EVERY = 50  # learning steps between two writes of the correction


class IntegrityService(Service[IntegritySettings]):
    """One verdict per fix; *unknown* with its reason where there is none to judge or nothing to judge it by."""

    NAME = "integrity"
    SETTINGS = IntegritySettings

    def __init__(self, settings: IntegritySettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._rules = settings.rules()
        self._state = settings.state_dir / "correction.json" if settings.state_dir else None
        self._judge = Judge(self._rules, _load_correction(self._state, self._rules.learning, bus))
        self._saved = self._judge.correction.samples
        self._pending: list[tuple[Fix, int]] = []  # with the time at which each was heard
        self._spoken = Spoken()
        self._collector = Collector(settings.upload_every_s)
        self._uploader = self._make_uploader() if settings.upload and settings.state_dir else None

    def _make_uploader(self) -> Uploader:
        assert self.settings.state_dir is not None
        return Uploader(
            self.settings.state_dir / "outbox.sqlite",
            source=self.NAME,
            limit_bytes=int(self.settings.outbox_limit_mb * 1e6),
            ask=self.bus.ask_bytes,
        )

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return {
            "fix": lambda fix: self._pending.append((fix, self.bus.now_ns())),
            "pose": self._judge.hear_pose,
            "antenna_height": self._judge.hear_antenna,
            "motion": lambda motion: self._judge.hear_speed(motion.time_ns, motion.wheel_speed_m_s),
        }

    def advance(self, now_ns: int) -> None:
        """Judge what can be judged, then say where the vehicle is."""
        alive = self._alive()
        self._judge.forget_future(now_ns)
        self._spoken.forget_after(now_ns + round(self._rules.future_limit_s * 1e9))
        pending, self._pending = self._pending, []
        for fix, heard_ns in pending:
            if self._should_wait(fix, heard_ns, now_ns, alive):
                self._pending.append((fix, heard_ns))
            else:
                self._judge_fix(fix, now_ns, alive)
        self._publish_pose_position(alive)
        self._break_silence(now_ns, alive)
        self._hand_over(self._collector.due(now_ns))
        self._report()

    def _alive(self) -> frozenset[str]:
        return frozenset(name for name in _SERVICES if self.bus.is_alive(name))

    def _should_wait(self, fix: Fix, heard_ns: int, now_ns: int, alive: frozenset[str]) -> bool:
        """A fix waits for the pose of its epoch: not longer than an epoch's width, whatever the clocks do."""
        pose = self._judge.pose
        pose_is_there = pose is not None and age_s(pose.time_ns, fix.time_ns) <= SAME_EPOCH_S
        waited = (
            not 0.0 <= age_s(heard_ns, now_ns) < SAME_EPOCH_S or age_s(fix.time_ns, now_ns) >= SAME_EPOCH_S
        )
        return not pose_is_there and not waited and "localizer" in alive

    def _judge_fix(self, fix: Fix, now_ns: int, alive: frozenset[str]) -> None:
        judgement = self._judge.judge(fix, now_ns, alive)
        if judgement is None:
            self.bus.count("fix.judged_already")
            return
        self.bus.count(f"verdict.{judgement.word}")
        self.bus.publish("verdict", verdict_of(judgement, self._rules.true_sigma))
        self._spoken.verdict(now_ns)
        if judgement.confirmed:
            self.bus.publish("position", rtk_position(judgement, self._rules))
            self._spoken.rtk(fix.time_ns)
        self._save(_SAVE_EVERY)
        self._collect(judgement)

    def _publish_pose_position(self, alive: frozenset[str]) -> None:
        pose = self._judge.pose
        if pose is None or not self._spoken.pose_is_due(pose.time_ns):
            return
        situation = self._judge.situation(pose.time_ns, alive)
        self._spoken.position(pose.time_ns)
        self.bus.publish(
            "position", pose_position(situation, self._judge.correction.correction_m, self._rules)
        )

    def _break_silence(self, now_ns: int, alive: frozenset[str]) -> None:
        """A consumer must hear *unknown*, not nothing, when there is no fix or no pose."""
        situation = self._judge.situation(now_ns, alive)
        reason = self._silence_reason(now_ns, situation)
        if reason is not None and not self._pending and self._spoken.verdict_is_due(now_ns):
            self._spoken.verdict(now_ns)
            self.bus.publish(
                "verdict", Verdict(time_ns=now_ns, fix_id=None, verdict="unknown", reason=reason)
            )
        missing = situation.missing_pose(now_ns, self._rules) or reason
        if missing is not None and self._spoken.position_is_due(now_ns, self._rules.pose_max_age_s):
            self._spoken.no_position(now_ns)
            self.bus.publish("position", no_position(now_ns, missing, self._rules))

    def _silence_reason(self, now_ns: int, situation: Situation) -> Reason | None:
        last_ns = self._judge.last_fix_ns
        if "gnss" not in situation.alive:
            return "gnss_absent"
        if last_ns is None or not age_s(last_ns, now_ns) <= self._rules.fix_max_age_s:
            return "gnss_stale"
        return situation.missing(now_ns, self._rules)

    def _collect(self, judgement: Judgement) -> None:
        upload = upload_for(judgement, self.settings.vehicle)
        if upload is not None and self._uploader is not None:
            self._hand_over(self._collector.add(upload))

    def _hand_over(self, batch: UploadBatch | None) -> None:
        if batch is not None and self._uploader is not None:
            self._uploader.put(batch.batch_id, "upload_batch", batch)

    def _report(self) -> None:
        for code, text in self._uploader.problems() if self._uploader is not None else ():
            self.bus.issue(code, text)

    def _save(self, least: int) -> None:
        """Write the correction where it has been learnt from `least` positions since."""
        correction = self._judge.correction
        if self._state is None or correction.samples < self._saved + least:
            return
        self._saved = correction.samples
        try:
            self._state.parent.mkdir(parents=True, exist_ok=True)
            fresh = self._state.with_suffix(".new")
            fresh.write_text(text_from_correction(correction))
            fresh.replace(self._state)
        except OSError as error:
            self.bus.issue("correction_not_saved", f"{self._state}: {error.strerror}")

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


def _load_correction(path: Path | None, rules: LearningRules, bus: Bus) -> Correction:
    if path is None or not path.exists():
        return Correction()
    try:
        return correction_from_text(path.read_text(), rules)
    except (OSError, ValueError) as error:
        bus.issue("correction_unreadable", f"{path}: {error}")
        return Correction()


SERVICE = IntegrityService
