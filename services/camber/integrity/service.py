"""The judge's process: wires inputs to `judge.py`, publishes verdicts and positions, puts uploads into the outbox."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camber.integrity.judge import Judge, Judgement
from camber.integrity.learning import Correction
from camber.integrity.position import no_position, pose_position, rtk_position, with_floor
from camber.integrity.settings import IntegritySettings
from camber.integrity.situation import age_s
from camber.integrity.uploads import upload_for
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.uploader import Uploader
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Reason, Verdict
from camber.schemas.pose import Pose

_SERVICES = ("gnss", "localizer", "antenna_height", "map_server")
_POSE_WAIT_S = 0.02  # a fix waits this long for the pose of its own epoch, no longer
_SILENCE_PERIOD_S = 0.1  # without a fix the word *unknown* is repeated this often
_SAVE_EVERY = 50  # learning steps between two writes of the correction


class IntegrityService(Service[IntegritySettings]):
    """One verdict per fix; *unknown* with its reason where there is none to judge or nothing to judge it by."""

    NAME = "integrity"
    SETTINGS = IntegritySettings

    def __init__(self, settings: IntegritySettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._rules = settings.rules()
        self._state = settings.state_dir / "correction.json" if settings.state_dir else None
        self._judge = Judge(self._rules, _load_correction(self._state, bus))
        self._saved = self._judge.correction.samples
        self._pending: list[Fix] = []
        self._antenna: Any = None
        self._published_ns = 0
        self._spoke_ns = 0
        self._uploader = self._make_uploader() if settings.upload and settings.state_dir else None

    def _make_uploader(self) -> Uploader:
        assert self.settings.state_dir is not None
        self.settings.state_dir.mkdir(parents=True, exist_ok=True)
        return Uploader(
            self.settings.state_dir / "outbox.sqlite",
            source=self.NAME,
            limit_bytes=int(self.settings.outbox_limit_mb * 1e6),
            ask=self.bus.ask_bytes,
            report=self.bus.issue,
        )

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return {
            "fix": self._pending.append,
            "pose": self._judge.hear_pose,
            "antenna_height": self._hear_antenna,
            "motion": lambda motion: self._judge.hear_speed(motion.time_ns, motion.wheel_speed_m_s),
        }

    def _hear_antenna(self, antenna: Any) -> None:
        self._antenna = antenna
        self._judge.hear_antenna(antenna)

    def advance(self, now_ns: int) -> None:
        """Judge what can be judged, then say where the vehicle is."""
        alive = frozenset(name for name in _SERVICES if self.bus.is_alive(name))
        waiting = []
        for fix in self._pending:
            if self._should_wait(fix, now_ns, alive):
                waiting.append(fix)
            else:
                self._publish_judgement(self._judge.judge(fix, now_ns, alive))
        self._pending[:] = waiting
        self._publish_pose_position()
        self._break_silence(now_ns, alive)

    def _should_wait(self, fix: Fix, now_ns: int, alive: frozenset[str]) -> bool:
        pose = self._judge.pose
        pose_is_there = pose is not None and age_s(pose.time_ns, fix.time_ns) <= _POSE_WAIT_S
        return not pose_is_there and "localizer" in alive and age_s(fix.time_ns, now_ns) < _POSE_WAIT_S

    def _publish_judgement(self, judgement: Judgement) -> None:
        self.bus.count(f"verdict.{judgement.word}")
        self.bus.publish("verdict", _verdict(judgement, self._rules.rtk_sigma_floor_m))
        self._spoke_ns = self.bus.now_ns()
        if judgement.confirmed:
            self.bus.publish("position", rtk_position(judgement, self._rules))
            self._published_ns = judgement.fix.time_ns
        self._save()
        upload = upload_for(judgement, self.settings.vehicle)
        if upload is not None and self._uploader is not None:
            self._uploader.put(upload.upload_id, "upload", upload)

    def _publish_pose_position(self) -> None:
        pose = self._judge.pose
        if pose is None or pose.time_ns <= self._published_ns:
            return
        self._published_ns = pose.time_ns
        self.bus.publish("position", self._pose_position(pose))

    def _pose_position(self, pose: Pose) -> Any:
        return pose_position(pose, self._antenna, self._judge.correction.correction_m, self._rules)

    def _break_silence(self, now_ns: int, alive: frozenset[str]) -> None:
        """A consumer must hear *unknown*, not nothing, when there is no fix or no pose."""
        if age_s(self._spoke_ns, now_ns) < _SILENCE_PERIOD_S or self._pending:
            return
        reason = self._silence_reason(now_ns, alive)
        if reason is None:
            return
        self._spoke_ns = now_ns
        self.bus.publish("verdict", Verdict(time_ns=now_ns, fix_id=None, verdict="unknown", reason=reason))
        if age_s(self._published_ns, now_ns) > self._rules.pose_max_age_s:
            self._published_ns = now_ns
            self.bus.publish("position", no_position(now_ns, reason, self._rules))

    def _silence_reason(self, now_ns: int, alive: frozenset[str]) -> Reason | None:
        last_ns = self._judge.last_fix_ns
        if "gnss" not in alive:
            return "gnss_absent"
        if last_ns is None or age_s(last_ns, now_ns) > self._rules.fix_max_age_s:
            return "gnss_stale"
        return self._judge.situation(now_ns, alive).missing(now_ns, self._rules)

    def _save(self) -> None:
        if self._state is None or self._judge.correction.samples < self._saved + _SAVE_EVERY:
            return
        self._write_correction()

    def _write_correction(self) -> None:
        correction = self._judge.correction
        assert self._state is not None
        try:
            self._state.parent.mkdir(parents=True, exist_ok=True)
            fresh = self._state.with_suffix(".new")
            fresh.write_text(json.dumps({"correction_m": correction.correction_m, "samples": correction.samples}))
            fresh.replace(self._state)
            self._saved = correction.samples
        except OSError as error:
            self.bus.issue("correction_not_saved", f"{self._state}: {error.strerror}")

    def close(self) -> None:
        """Keep what was learnt; what waits in the outbox is on disk already."""
        if self._state is not None and self._judge.correction.samples != self._saved:
            self._write_correction()
        if self._uploader is not None:
            self._uploader.close()


def _verdict(judgement: Judgement, floor_m: tuple[float, float]) -> Verdict:
    fix, outcome = judgement.fix, judgement.determination
    road = judgement.pose.road if judgement.pose is not None else None
    confirmed = judgement.confirmed and fix.covariance_enu_m2 is not None
    return Verdict(
        time_ns=fix.time_ns,
        fix_id=fix.fix_id,
        verdict=judgement.word,
        reason=judgement.reason,
        detail=judgement.detail,
        evidence=judgement.evidence,
        height_difference_m=outcome.difference_m if outcome else None,
        tolerance_m=outcome.tolerance_m if outcome else None,
        correction_m=judgement.correction_m,
        trials=1,
        latitude_rad=fix.latitude_rad if confirmed else None,
        longitude_rad=fix.longitude_rad if confirmed else None,
        height_m=fix.height_m if confirmed else None,
        covariance_enu_m2=with_floor(fix.covariance_enu_m2, floor_m) if confirmed else None,  # type: ignore[arg-type]
        surface_id=road.surface_id if road else None,
        map_version=road.map_version if road else None,
    )


def _load_correction(path: Path | None, bus: Bus) -> Correction:
    if path is None or not path.exists():
        return Correction()
    try:
        table = json.loads(path.read_text())
        correction = Correction(float(table["correction_m"]), int(table["samples"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        bus.issue("correction_unreadable", f"{path}: expected correction_m and samples, {type(error).__name__}")
        return Correction()
    if not abs(correction.correction_m) <= 1.0:
        bus.issue("correction_unreadable", f"{path}: correction_m {correction.correction_m}, expected at most 1 m")
        return Correction()
    return correction


SERVICE = IntegrityService
