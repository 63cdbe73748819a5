"""What a drive came to: wrong fixes confirmed, usable epochs beyond their level, when and as what a fault was named."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.integrity.learning.offset_causes import ISSUE_CODES
from camber.replay.single_process_replay import DriveOutput
from camber.schemas.base import Int64
from camber.schemas.integrity import CONFIRMED_VERDICTS, Position, Verdict
from camber.validation.common_faults.drive import FaultDrive
from camber.validation.common_faults.fault_cases import CommonFault
from camber.validation.common_faults.independent_figures import independent_figures
from camber.validation.protection_level_statistics import positions_by_epoch
from camber.validation.reference_trajectory import truth_of

NAMES = frozenset({"base", "drift"})
"""Causes of a verdict that name a common fault horizontally."""
_NAMING_ISSUES = {code: cause for cause, code in ISSUE_CODES.items() if cause in NAMES}
_RIGHT_M = 0.2  # as the evidence page defines it
_WARM_UP_M = 2_000.0  # chosen: until then relief need not show a place
_ALERT_LIMIT_M = 1.5  # chosen: the default of the judge and of a drive


def outcome(drive: FaultDrive, output: DriveOutput, fault: CommonFault) -> dict[str, Any]:
    """Figures of one drive; times in seconds after the fault's onset, distances in metres."""
    first_ns = int(drive.fixes.time_ns[0])
    onset_ns = first_ns + round(fault.onset_s * NS_PER_SECOND)
    verdicts = [item.message for item in output.recorded["verdict"]]
    return {
        "driven_m": drive.driven_m,
        **_fixes(drive, verdicts),
        **_positions(drive, output, onset_ns),
        **_naming(verdicts, output, onset_ns),
        **independent_figures(drive, output, least_driven_m=_WARM_UP_M),
    }


def _fixes(drive: FaultDrive, verdicts: list[Verdict]) -> dict[str, Any]:
    by_time = {v.time_ns: v for v in verdicts if v.fix_id is not None}
    error_m = np.linalg.norm(drive.fixes.error_m, axis=1)
    wrong, right = drive.fixes.wrong, error_m <= _RIGHT_M
    names = [by_time[t].verdict if t in by_time else "none" for t in drive.fixes.time_ns.tolist()]
    confirmed = np.isin(names, CONFIRMED_VERDICTS)
    erroneous = np.array(names) == "erroneous"
    worst = float(error_m[wrong & confirmed].max()) if (wrong & confirmed).any() else 0.0
    return {
        "fixes": len(error_m),
        "wrong": int(wrong.sum()),
        "wrong_confirmed": int((wrong & confirmed).sum()),
        "worst_m": worst,
        "right": int(right.sum()),
        "right_confirmed": int((right & confirmed).sum()),
        "right_erroneous": int((right & erroneous).sum()),
    }


def _positions(drive: FaultDrive, output: DriveOutput, onset_ns: int) -> dict[str, Any]:
    recorded = output.recorded["position"]
    positions = positions_by_epoch(recorded, truth_of(drive.truth), (0.0, 0.0, 0.0), None)
    last: dict[int, Position] = {item.message.time_ns: item.message for item in recorded}
    time_ns: Int64 = positions.time_ns
    usable = np.array([last[t].usable for t in time_ns.tolist()], bool)
    reasons = Counter(last[t].reason for t in time_ns[~usable].tolist())
    sideways, up = positions.horizontal_error_m, np.abs(positions.error_enu_m[:, 2])
    beyond = usable & (sideways > positions.hpl_m)
    beyond_up = usable & (up > positions.vpl_m)
    driven = np.interp(time_ns, drive.truth.time_ns, drive.truth.more["driven_m"])
    warm, before = driven >= _WARM_UP_M, time_ns < onset_ns
    ends = time_ns[usable & ~before]

    def share(of: Any) -> float | None:
        return float(usable[of].mean()) if of.any() else None

    def median(of: Any) -> float | None:
        return float(np.median(positions.hpl_m[of])) if of.any() else None

    return {
        "epochs": len(usable),
        "usable": int(usable.sum()),
        "beyond_level": int(beyond.sum()),
        "beyond_level_and_limit": int((beyond & (sideways > _ALERT_LIMIT_M)).sum()),
        "beyond_vertical_level": int(beyond_up.sum()),
        "worst_usable_m": float(sideways[usable].max()) if usable.any() else 0.0,
        "usable_share": share(np.ones(len(usable), bool)),
        "usable_share_before": share(before),
        "usable_share_after_2_km": share(warm),
        "usable_until_s": float(ends[-1] - onset_ns) / NS_PER_SECOND if len(ends) else None,
        "median_level_m": median(usable),
        "median_error_m": float(np.median(sideways[usable])) if usable.any() else None,
        "reasons": dict(reasons.most_common(5)),
    }


def _naming(verdicts: list[Verdict], output: DriveOutput, onset_ns: int) -> dict[str, Any]:
    """When a cause was first named, and which issues were reported; before the onset it is a false alarm."""
    causes = [(v.time_ns, v.cause) for v in verdicts if v.cause != "none"]
    issues = [(i.time_ns, i.code) for i in output.issues if i.service == "integrity"]
    named: list[tuple[int, str]] = [(t, c) for t, c in causes if c in NAMES]
    named += [(t, _NAMING_ISSUES[code]) for t, code in issues if code in _NAMING_ISSUES]
    after = sorted(item for item in named if item[0] >= onset_ns)
    return {
        "named_by": after[0][1] if after else None,
        "named_after_s": (after[0][0] - onset_ns) / NS_PER_SECOND if after else None,
        "named_before_onset": sum(t < onset_ns for t, _ in named),
        "causes": dict(Counter(cause for _, cause in causes)),
        "issues": dict(Counter(code for _, code in issues)),
    }
