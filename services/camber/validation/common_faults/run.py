"""The jobs: a fault on one ground with one seed, a drive without fault, a drive with episodes of wrong fixes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from camber.integrity.settings import IntegritySettings
from camber.replay.single_process_replay import replay_in_one_process
from camber.schemas.integrity import HorizontalReference
from camber.validation.common_faults.drive import Setting, fault_drive
from camber.validation.common_faults.fault_cases import BY_NAME, CommonFault
from camber.validation.common_faults.fix_series import STREET
from camber.validation.common_faults.outcome import outcome
from camber.validation.common_faults.recovery import recovery
from camber.validation.common_faults.wrong_episodes import wrong_episodes

Part = Literal["faults", "controls", "episodes"]
PARTS: tuple[Part, ...] = get_args(Part)
REFERENCES: tuple[HorizontalReference, ...] = get_args(HorizontalReference)
_SETTING = "horizontal_reference"
_FIRST_EPISODE_S = 60.0  # chosen: from then on the vehicle drives
_CHANNELS = ("verdict", "position", "pose")


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultJob:
    """One drive."""

    part: Part
    fault: str
    setting: Setting
    reference: HorizontalReference

    @property
    def name(self) -> str:
        """Of its figures' file."""
        return f"{self.part}-{self.fault}-{self.setting.name}-{self.reference}"


def run_job(job: FaultJob, folder: Path) -> dict[str, Any]:
    """Make the drive, send it through all services in this process; its figures."""
    about = {"part": job.part, "fault": job.fault, "reference": job.reference, **asdict(job.setting)}
    fault = BY_NAME[job.fault]
    if job.part == "episodes":
        return about | _outcome_of_episodes(job.setting, fault, job.reference, folder)
    return about | outcome_of(job.setting, fault, job.reference, folder)


def outcome_of(
    setting: Setting, fault: CommonFault, reference: HorizontalReference, folder: Path
) -> dict[str, Any]:
    """Figures of one drive with a fault."""
    drive = fault_drive(setting, fault, folder / "drive")
    output = replay_in_one_process(drive.inputs, folder, settings=_settings(reference), channels=_CHANNELS)
    return outcome(drive, output, fault)


def _outcome_of_episodes(
    setting: Setting, fault: CommonFault, reference: HorizontalReference, folder: Path
) -> dict[str, Any]:
    episodes = wrong_episodes(setting.seed, first_s=_FIRST_EPISODE_S, lasts_s=setting.lasts_s)
    drive = fault_drive(setting, fault, folder / "drive", errors=STREET, episodes=episodes)
    output = replay_in_one_process(drive.inputs, folder, settings=_settings(reference), channels=_CHANNELS)
    return outcome(drive, output, fault) | recovery(drive, output, episodes)


def _settings(reference: HorizontalReference) -> dict[str, dict[str, Any]]:
    if _SETTING not in IntegritySettings.model_fields:
        return {}
    return {"integrity": {_SETTING: reference}}
