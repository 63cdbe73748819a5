"""The satellites of an epoch as a message: those that the engine solved, or those that a receiver reports."""

from __future__ import annotations

import math

import numpy as np

from camber.formats.receiver.satellite_report import SatelliteReport
from camber.gnss.candidates.receiver_candidates import QUALITY
from camber.gnss.position.satellite_use import SatelliteColumns
from camber.schemas.gnss import SATELLITE_USES, Quality, SatellitesInView, SatelliteUse

_NUMBER = {use: number for number, use in enumerate(SATELLITE_USES)}
_UNKNOWN_DIRECTION = (math.nan, math.nan)
# Of an epoch without a position in three dimensions within the receiver's masks, which is all that becomes a fix.
_NO_POSITION: tuple[SatelliteUse, ...] = ("used", "reason_not_reported", "use_not_reported")


def satellites_from(time_ns: int, quality: Quality, columns: SatelliteColumns) -> SatellitesInView:
    """The satellites of an epoch and their use."""
    has_direction, has_cn0 = ~np.isnan(columns.elevation_rad), ~np.isnan(columns.cn0_dbhz)
    values = (np.nan_to_num(value).astype(np.float32) for value in columns[1:4])
    azimuth_rad, elevation_rad, cn0_dbhz = values
    return SatellitesInView(
        time_ns=time_ns,
        quality=quality,
        satellite=columns.satellite.astype(np.int32),
        present=has_direction.astype(np.uint8) | has_cn0.astype(np.uint8) << np.uint8(1),
        azimuth_rad=azimuth_rad,
        elevation_rad=elevation_rad,
        cn0_dbhz=cn0_dbhz,
        use=columns.use.astype(np.uint8),
    )


def satellites_from_report(report: SatelliteReport) -> SatellitesInView:
    """The satellites that a receiver reports; without a position none is used."""
    satellites = report.satellites
    no_position = _NO_POSITION if report.quality is None else ()
    directions = np.array([row.direction_rad or _UNKNOWN_DIRECTION for row in satellites]).reshape(-1, 2)
    columns = SatelliteColumns(
        satellite=np.array([row.satellite for row in satellites], np.int64),
        azimuth_rad=directions[:, 0],
        elevation_rad=directions[:, 1],
        cn0_dbhz=np.array([math.nan if row.cn0_dbhz is None else row.cn0_dbhz for row in satellites]),
        use=np.array(
            [_NUMBER["no_position" if row.use in no_position else row.use] for row in satellites], np.int64
        ),
    )
    return satellites_from(
        report.time_ns, "none" if report.quality is None else QUALITY[report.quality], columns
    )
