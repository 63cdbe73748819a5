"""Every code of a problem that a service can put into health, found in the source."""

from __future__ import annotations

import ast
import typing
from collections.abc import Iterator

from camber.gnss.candidates.receiver_candidates import Refusal
from camber.gnss.position.rtk_engine import EngineWarning
from camber.integrity.learning.offset_causes import ISSUE_CODES
from camber.localizer.matching.sweep_preparation import SweepProblem
from camber.map_update.service import UNAVAILABLE_ISSUES
from camber.runtime.health.issue_log import _OTHERS
from camber.sensors.lidar_reader import ISSUES
from support.tree import ROOT

SOURCE = ROOT / "services" / "camber"
NO_SERVICES = (
    "tools",
    "validation",
    "replay",
    "simulator",
    "road_map",
    "transport",
    "formats",
    "geodesy",
    "compiled",
)

_WITHIN_SERVICES = ("replay/lock_step/service_loop.py",)
"""Modules of NO_SERVICES that run inside a service."""
_QUEUED = (
    "map_server/download_thread.py",
    "runtime/uploads/uploader.py",
    "sensors/inputs.py",
    "sensors/lidar_reader.py",
)
_OF_QUEUES: tuple[str, ...] = ()  # these are texts where they are queued

ELSEWHERE: dict[tuple[str, str], tuple[str, ...]] = {
    ("gnss/service.py", "code"): (*typing.get_args(EngineWarning), "ephemeris_refused"),
    ("gnss/service.py", "refusal"): typing.get_args(Refusal),
    ("integrity/service.py", "ISSUE_CODES[named.reported]"): tuple(ISSUE_CODES.values()),
    ("integrity/service.py", "code"): _OF_QUEUES,
    ("localizer/localization.py", "f'imu_{order}'"): ("imu_repeated", "imu_backwards"),
    ("localizer/localization.py", "f'motion_{outcome}'"): ("motion_repeated", "motion_backwards"),
    ("localizer/localization.py", "f'motion_{order}'"): ("motion_repeated", "motion_backwards"),
    ("localizer/matching/scan_matcher.py", "f'sweep_{sweep.problem}'"): tuple(
        f"sweep_{word}" for word in typing.get_args(SweepProblem)
    ),
    ("map_server/download_thread.py", "code"): ("store_full", "release_refused"),
    ("map_server/service.py", "code"): ("datum_mismatch", "release_refused"),
    ("map_update/service.py", "UNAVAILABLE_ISSUES[name]"): tuple(UNAVAILABLE_ISSUES.values()),
    ("runtime/bus.py", "code"): (_OTHERS,),
    ("runtime/uploads/uploader.py", "code"): (
        "outbox_damaged",
        "upload_unanswered",
        "upload_refused",
        "upload_not_acknowledged",
    ),
    ("sensors/service.py", "code"): _OF_QUEUES,
    **{
        ("sensors/inputs.py", f"f'{{self._name}}_{word}'"): (f"lidar_{word}", f"can_{word}")
        for word in ("port", "too_fast", "recording", "ended")
    },
}
"""Where a code is no text in the call itself: what it can be. A place that is not here fails the test."""


def issue_codes() -> tuple[set[str], set[tuple[str, str]]]:
    """All codes, and places of whose codes nobody knows."""
    codes = set(ISSUES.values())
    unknown: set[tuple[str, str]] = set()
    for file, code in _places():
        if isinstance(code, ast.Constant) and isinstance(code.value, str):
            codes.add(code.value)
        elif isinstance(code, ast.Constant):
            continue
        elif (place := (file, ast.unparse(code))) in ELSEWHERE:
            codes.update(ELSEWHERE[place])
        else:
            unknown.add(place)
    return codes, unknown


def _places() -> Iterator[tuple[str, ast.expr]]:
    for path in sorted(SOURCE.rglob("*.py")):
        file = path.relative_to(SOURCE).as_posix()
        if file.split("/")[0] in NO_SERVICES and file not in _WITHIN_SERVICES:
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            if node.func.attr == "issue" and node.args:
                yield file, node.args[0]
            # (code, text), handed to the work loop by a thread or a pure part.
            handed = node.args[0] if len(node.args) == 1 and node.func.attr in ("put", "append") else None
            if file in _QUEUED and isinstance(handed, ast.Tuple) and len(handed.elts) == 2:
                yield file, handed.elts[0]
