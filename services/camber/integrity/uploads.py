"""What a vehicle tells the fleet of one fix: the road's height there, free of the map's own, with the verdict as a flag.

Epochs that did not pass are uploaded too: were only passed ones sent, a real change of the road would censor itself.
"""

from __future__ import annotations

import hashlib

from camber.geodesy.gps_time import gpst_from_gps_ns
from camber.integrity.judge import Judgement
from camber.schemas.fleet import ElevationUpload


def upload_for(judgement: Judgement, vehicle: str) -> ElevationUpload | None:
    """The upload of one judgement; None where fix, antenna height or surface is not known."""
    fix, pose, antenna = judgement.fix, judgement.pose, judgement.antenna
    if fix.quality != "fixed" or fix.covariance_enu_m2 is None or pose is None or antenna is None:
        return None
    if antenna.height_m is None or antenna.sigma_m is None or pose.road.surface_id is None:
        return None
    # Named by what was measured: the same epoch uploaded twice, also after a restart, is one upload.
    digest = hashlib.sha256(f"{fix.time_ns}:{fix.fix_id}".encode()).hexdigest()[:16]
    return ElevationUpload(
        time_ns=fix.time_ns,
        vehicle=vehicle,
        upload_id=f"{fix.time_ns}-{digest}",
        fix_id=fix.fix_id,
        fix_quality=fix.quality,
        verdict=judgement.word,
        latitude_rad=fix.latitude_rad,
        longitude_rad=fix.longitude_rad,
        road_height_m=fix.height_m - antenna.height_m,
        road_height_sigma_m=(fix.covariance_enu_m2[5] + antenna.sigma_m**2) ** 0.5,
        antenna_height_m=antenna.height_m,
        position_covariance_enu_m2=fix.covariance_enu_m2,
        datum=fix.datum,
        epoch_year=_decimal_year(fix.time_ns),
        map_version=pose.road.map_version or 0,
        surface_id=pose.road.surface_id,
    )


def _decimal_year(time_ns: int) -> float:
    calendar = gpst_from_gps_ns(time_ns)
    return calendar.year + (calendar.month - 1) / 12.0 + (calendar.day - 1) / 365.25
