"""Unconfirmed fixes and anchors of a recorded drive, as inputs of a localizer that is run alone.

Anchors are surrogates for verdicts without errors: the truth itself, or the receiver's fixes that agree with the truth.
Results obtained with them must say so.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any, Literal

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
            last_ns = fixes[-1].time_ns if fixes else None
            if isinstance(item, ReceiverSolution) and refuse(item.time_ns, last_ns, part.time_ns) is None:
                with contextlib.suppress(ValidationError):  # a place that no antenna can be at
                    fixes.append(fix_from(item, manifest.datum))
    return fixes


def anchors_of(inputs: DriveInputs, kind: Anchors) -> list[Verdict]:
    """Confirmed positions in the order of their times; ManifestError where the drive has no truth to make them from."""
    if kind == "none":
        return []
    if inputs.truth is None:
        raise ManifestError(f"{inputs.manifest.name}: no table truth, expected one for anchors of {kind}")
    table = inputs.truth
    if kind == "truth":
        rows = np.unique(table.time_ns // _EVERY_NS, return_index=True)[1]
        places = np.column_stack((table.latitude_rad, table.longitude_rad, table.height_m))[rows].tolist()
        variance = _SIGMA_M**2
        covariance = (variance, 0.0, 0.0, variance, 0.0, 4.0 * variance)
        times_ns = table.time_ns[rows].tolist()
        return [
            _confirmed(time_ns, place, covariance) for time_ns, place in zip(times_ns, places, strict=True)
        ]
    fixes = [fix for fix in receiver_fixes(inputs) if fix.quality == "fixed"]
    return _right(fixes, truth_of(table), inputs)


def _right(fixes: Sequence[Fix], truth: ReferenceTrajectory, inputs: DriveInputs) -> list[Verdict]:
    if not fixes:
        return []
    places = np.array([(fix.latitude_rad, fix.longitude_rad, fix.height_m) for fix in fixes])
    time_ns = np.array([fix.time_ns for fix in fixes], np.int64)
    error_enu_m = truth.error_enu_m(time_ns, *places.T, offset_enu_m=offset_of(inputs.manifest))
    return [
        _confirmed(fix.time_ns, place, fix.covariance_enu_m2)
        for fix, place, error_m in zip(
            fixes, places.tolist(), np.linalg.norm(error_enu_m, axis=1), strict=True
        )
        if error_m <= RIGHT_M and fix.covariance_enu_m2 is not None
    ]


def _confirmed(time_ns: int, place: Sequence[float], covariance_enu_m2: Any) -> Verdict:
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
