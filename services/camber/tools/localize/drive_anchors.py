"""Unconfirmed fixes and anchors of a recorded drive, as inputs of a localizer that is run alone.

Anchors are surrogates for verdicts without errors: the truth itself, or the receiver's fixes that agree with the truth.
Results obtained with them must say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import ValidationError

from camber.formats.receiver.solution import ReceiverSolution
from camber.gnss.candidates.receiver_candidates import fix_from, fix_id_of, refuse
from camber.gnss.observations.receiver_streams import StreamReader
from camber.replay.drive_inputs import DriveInputs
from camber.schemas.drive import ManifestError
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.validation.fix_statistics import RIGHT_M
from camber.validation.reference_trajectory import ReferenceTrajectory, offset_of, truth_of

Anchors = Literal["none", "truth", "right-fixes"]
_EVERY_NS = 1_000_000_000  # chosen: one anchor a second
_SIGMA_M = 0.02  # chosen: horizontal σ of an RTK fix


def receiver_fixes(inputs: DriveInputs) -> list[Fix]:
    """The receiver's own positions, unconfirmed, in the order of their times; what gnss would refuse is left out.

    Raises ManifestError where the drive has none.
    """
    manifest = inputs.manifest
    if manifest.receiver is None:
        raise ManifestError(f"{manifest.name}: no table receiver, expected the receiver's own positions")
    readers: dict[str, StreamReader] = {}
    fixes: list[Fix] = []
    for arrival in inputs.receiver:
        part = arrival.message
        if part.stream != "rover" or part.protocol not in ("pos", "nmea"):
            continue
        if part.protocol not in readers:
            date = manifest.receiver.utc_date
            readers[part.protocol] = StreamReader(
                "rover", part.protocol, manifest.receiver.file.name, part.time_ns, utc_date=date
            )
        for _, item in readers[part.protocol].feed(part.payload.tobytes()):
            if isinstance(item, ReceiverSolution):
                fixes += _fix(item, manifest.datum, fixes[-1].time_ns if fixes else None, part.time_ns)
    return fixes


def anchors_of(inputs: DriveInputs, kind: Anchors) -> list[Verdict]:
    """Confirmed positions in the order of their times; ManifestError where the drive has no truth to make them from."""
    if kind == "none":
        return []
    if inputs.truth is None:
        raise ManifestError(f"{inputs.manifest.name}: no table truth, expected one for anchors of {kind}")
    table = inputs.truth
    if kind == "truth":
        rows = np.unique(table.time_ns // _EVERY_NS, return_index=True)[1].tolist()
        variance = _SIGMA_M**2
        return [
            _confirmed(
                int(table.time_ns[row]),
                (float(table.latitude_rad[row]), float(table.longitude_rad[row]), float(table.height_m[row])),
                (variance, 0.0, 0.0, variance, 0.0, 4.0 * variance),
            )
            for row in rows
        ]
    fixes = [fix for fix in receiver_fixes(inputs) if fix.quality == "fixed"]
    return _right(fixes, truth_of(table), inputs)


def _fix(solution: ReceiverSolution, datum: str, last_ns: int | None, now_ns: int) -> list[Fix]:
    if refuse(solution.time_ns, last_ns, now_ns) is not None:
        return []
    try:
        return [fix_from(solution, datum)]
    except ValidationError:  # a place that no antenna can be at
        return []


def _right(fixes: Sequence[Fix], truth: ReferenceTrajectory, inputs: DriveInputs) -> list[Verdict]:
    if not fixes:
        return []
    places = np.array([(fix.latitude_rad, fix.longitude_rad, fix.height_m) for fix in fixes])
    time_ns = np.array([fix.time_ns for fix in fixes], np.int64)
    error_m = np.linalg.norm(
        truth.error_enu_m(
            time_ns, places[:, 0], places[:, 1], places[:, 2], offset_enu_m=offset_of(inputs.manifest)
        ),
        axis=1,
    )
    return [
        _confirmed(fix.time_ns, (fix.latitude_rad, fix.longitude_rad, fix.height_m), fix.covariance_enu_m2)
        for fix, error in zip(fixes, error_m.tolist(), strict=True)
        if error <= RIGHT_M and fix.covariance_enu_m2 is not None
    ]


def _confirmed(
    time_ns: int,
    place: tuple[float, float, float],
    covariance_enu_m2: tuple[float, float, float, float, float, float] | None,
) -> Verdict:
    latitude_rad, longitude_rad, height_m = place
    return Verdict(
        time_ns=time_ns,
        fix_id=fix_id_of(time_ns),
        verdict="confirmed",
        reason="height_agrees",
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=height_m,
        covariance_enu_m2=covariance_enu_m2,
    )
