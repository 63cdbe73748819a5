"""Residual of a judged fix for the learning: its offset from the model, the uncertainty of that, and its reference."""

from __future__ import annotations

import math
from dataclasses import replace

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.fix_comparison import FixComparison
from camber.integrity.checks.pose_offset import can_move_on, offset_from_pose
from camber.integrity.judgement import FixJudgement
from camber.integrity.learning.fix_track_offset import JudgedTrackOffset
from camber.integrity.learning.residuals import FixResidual, ReferenceKey
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.pose import FixesOffset, Pose

_FREE_OF_THIS_FIX = ("scan_match", "given", "confirmed")
"""Such a pose owes nothing to a fix that is not confirmed yet; to those before, where no scan match holds it."""


def base_of(fix: Fix) -> str:
    """Whose fixes these are: those of another receiver, engine, frame or station may all be off by something else."""
    return f"{fix.origin}:{fix.datum}:{fix.base_station or ''}"


def key_of(base: str, pose: Pose | None, antenna: AntennaHeight | None) -> ReferenceKey:
    """To what a lasting difference of height belongs."""
    method = antenna.way if antenna is not None and antenna.way is not None else ""
    version = pose.road.map_version if pose is not None else None
    return ReferenceKey(antenna=method, base=base, map_version=version if version is not None else 0)


def residual_of(judgement: FixJudgement, result: FixComparison, speed_m_s: float | None) -> FixResidual:
    """Of a fix that was compared, whatever the verdict; `speed_m_s` of the wheels, None: not known."""
    fix, pose, antenna, road = judgement.fix, judgement.pose, judgement.antenna, judgement.road
    residual = _without_differences(judgement, pose, antenna, speed_m_s)
    if pose is not None:
        residual = _with_horizontal(
            residual, fix, pose, position_m=result.position_m, sigma_m=result.position_sigma_m
        )
    if road is None or antenna is None or antenna.height_m is None:
        return residual
    return replace(
        residual,
        up_m=fix.height_m - road.elevation_m - antenna.height_m,
        fix_sigma_m=math.sqrt(max(result.height_sigma_m**2 - road.sigma_m**2, 0.0)),
        map_sigma_m=road.sigma_m,
        surface_id=road.surface_id,
    )


def independent_residual_of(
    judgement: FixJudgement, pose: Pose, antenna: AntennaHeight | None, speed_m_s: float | None
) -> FixResidual | None:
    """Of a fix that could not be compared with pose or road: the independent position may be known all the same.

    Without it a fault that all fixes share would go on unnamed, as soon as it has made the pose too uncertain.
    """
    fix = judgement.fix
    if pose.independent is None or not (pose.time_ns == fix.time_ns or can_move_on(pose)):
        return None
    residual = _without_differences(judgement, pose, antenna, speed_m_s)
    position_m = offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, fix.time_ns)
    return _with_horizontal(residual, fix, pose, position_m=position_m, sigma_m=math.inf)


def _without_differences(
    judgement: FixJudgement, pose: Pose | None, antenna: AntennaHeight | None, speed_m_s: float | None
) -> FixResidual:
    fix, offset = judgement.fix, None if pose is None else pose.fixes_offset
    return FixResidual(
        time_ns=fix.time_ns,
        verdict=judgement.verdict,
        latitude_rad=fix.latitude_rad,
        longitude_rad=fix.longitude_rad,
        speed_m_s=speed_m_s,
        key=key_of(base_of(fix), pose, antenna),
        link_id=pose.link_id if pose is not None else None,
        track_offset=None if offset is None else track_offset_of(offset),
        run_begin_ns=None if pose is None else pose.fix_run_begin_time_ns,
        heading_rad=None if pose is None else pose.yaw_rad,
    )


def _with_horizontal(
    residual: FixResidual, fix: Fix, pose: Pose, *, position_m: tuple[float, float], sigma_m: float
) -> FixResidual:
    """With the difference from the independent position; where there is none, from a pose free of this fix.

    A scan match is precise and rests on no fix: each stretch of it counts for itself. An independent position of
    another basis has errors that last: `independent_offset` judges it by its covariance.
    """
    (east_m, north_m), anchored_ns = position_m, pose.anchor_time_ns
    free = pose.provenance in _FREE_OF_THIS_FIX
    independent = pose.independent
    if independent is not None and pose.latitude_rad is not None and pose.longitude_rad is not None:
        apart_m = east_north_between(
            independent.latitude_rad, independent.longitude_rad, pose.latitude_rad, pose.longitude_rad
        )
        east_m, north_m = east_m + apart_m[0], north_m + apart_m[1]
        (ee, en, nn), fix_sigma_m = independent.covariance_east_north, _fix_sigma_m(fix)
        residual = replace(
            residual,
            independent=(east_m, north_m, ee, en, nn, fix_sigma_m),
            evidence_ns=independent.evidence_time_ns,
        )
        sigma_m = math.sqrt(larger_eigenvalue(ee, en, nn) + fix_sigma_m**2)
        free, anchored_ns = independent.basis == "scan_match", None
    if not free:
        return residual
    return replace(
        residual,
        east_m=east_m,
        north_m=north_m,
        horizontal_sigma_m=sigma_m,
        anchored_ns=None if pose.mode == "scan_match" else anchored_ns,
    )


def track_offset_of(offset: FixesOffset) -> JudgedTrackOffset:
    """Of a message."""
    return JudgedTrackOffset(
        begin_ns=offset.begin_time_ns,
        end_ns=offset.end_time_ns,
        east_north_m=offset.east_north_m,
        covariance_m2=offset.covariance_east_north,
        growth_m_s=offset.growth_east_north_m_s,
        growth_covariance=offset.growth_covariance_east_north,
        is_estimate=offset.steps == 0,
    )


def _fix_sigma_m(fix: Fix) -> float:
    """In its worst horizontal direction."""
    if fix.covariance_enu_m2 is None:
        return math.inf
    ee, en, _, nn, _, _ = fix.covariance_enu_m2
    return math.sqrt(larger_eigenvalue(ee, en, nn))
