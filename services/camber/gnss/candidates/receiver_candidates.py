"""Candidate fixes from the receiver's solutions; the covariance is passed on as claimed, never trusted."""

from __future__ import annotations

from typing import Literal

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.gnss.observations.base_station import station_name
from camber.schemas.gnss import Fix, Quality

QUALITY: dict[SolutionQuality, Quality] = {
    SolutionQuality.FIX: "fixed",
    SolutionQuality.FLOAT: "float",
    SolutionQuality.SBAS: "sbas",
    SolutionQuality.DGPS: "dgps",
    SolutionQuality.SINGLE: "single",
    SolutionQuality.PPP: "ppp",
    SolutionQuality.DEAD_RECKONING: "estimated",
}
_FUTURE_LIMIT_NS = 500_000_000  # chosen: ample for a machine's clock disciplined by NTP

Refusal = Literal["repeated_epoch", "out_of_order_epoch", "epoch_from_the_future"]


def refuse(time_ns: int, last_ns: int | None, now_ns: int) -> Refusal | None:
    """Reason why an epoch is not passed on: repeated, late, or more than 0.5 s ahead of this machine's clock."""
    if time_ns > now_ns + _FUTURE_LIMIT_NS:
        return "epoch_from_the_future"
    if last_ns is None or time_ns > last_ns:
        return None
    return "repeated_epoch" if time_ns == last_ns else "out_of_order_epoch"


def fix_id_of(time_ns: int) -> int:
    """The epoch in milliseconds: stable over restarts and replays."""
    return time_ns // 1_000_000


def fix_from(solution: ReceiverSolution, datum: str) -> Fix:
    """The candidate fix of a receiver's solution."""
    return Fix(
        time_ns=solution.time_ns,
        fix_id=fix_id_of(solution.time_ns),
        origin="receiver",
        quality=QUALITY[solution.quality],
        latitude_rad=solution.latitude_rad,
        longitude_rad=solution.longitude_rad,
        height_m=solution.height_m,
        covariance_enu_m2=solution.covariance_enu_m2,
        datum=datum,
        satellites=solution.satellites,
        ratio=solution.ratio,
        age_of_corrections_s=solution.age_s,
        base_station=None if solution.station is None else station_name(f"station-{solution.station}"),
    )
