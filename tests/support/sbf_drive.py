"""A u-blox receiver's stream as a Septentrio receiver would have sent it."""

from __future__ import annotations

from typing import Any

from camber.formats.observations import Ephemeris
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ubx.reader import UbxDecoder
from support.sbf_blocks import (
    END_OF_PVT,
    POS_COV_GEODETIC,
    PVT_GEODETIC,
    ephemeris_block,
    measurements_block,
    sbf_block,
)

MODES = {SolutionQuality.SINGLE: 1, SolutionQuality.DGPS: 2, SolutionQuality.FIX: 4, SolutionQuality.FLOAT: 5}


def sbf_of_ubx(data: bytes, near_ns: int) -> bytes:
    """Return the observations, ephemerides and positions of a stream as SBF, in the order of their times."""
    decoder = UbxDecoder("rover.ubx", near_ns)
    return b"".join(map(_blocks, sorted(decoder.feed(data) + decoder.finish(), key=_time_ns)))


def _time_ns(result: Any) -> int:
    match result:
        case ReceiverEpoch():
            return result.epoch.time_ns
        case Ephemeris():
            return result.transmission_ns
    return int(result.time_ns)


def _blocks(result: object) -> bytes:
    match result:
        case ReceiverEpoch():
            return measurements_block(result.epoch)
        case Ephemeris():
            return ephemeris_block(result, result.transmission_ns)
        case ReceiverSolution():
            return position_blocks(result)
    return b""


def position_blocks(solution: ReceiverSolution) -> bytes:
    """Return PVTGeodetic, PosCovGeodetic where the covariance is known, and EndOfPVT."""
    east, north, up = solution.velocity_enu_m_s or (-2e10, -2e10, -2e10)
    pvt = sbf_block(
        PVT_GEODETIC,
        solution.time_ns,
        revision=2,
        Mode=MODES[solution.quality],
        Latitude=solution.latitude_rad,
        Longitude=solution.longitude_rad,
        Height=solution.height_m,
        Vn=north,
        Ve=east,
        Vu=up,
        NrSV=255 if solution.satellites is None else solution.satellites,
        MeanCorrAge=65535 if solution.age_s is None else round(solution.age_s * 100.0),
        AlertFlag=1,
    )
    end = sbf_block(END_OF_PVT, solution.time_ns)
    if solution.covariance_enu_m2 is None:
        return pvt + end
    ee, en, eu, nn, nu, uu = solution.covariance_enu_m2
    covariance = sbf_block(
        POS_COV_GEODETIC,
        solution.time_ns,
        Mode=MODES[solution.quality],
        Cov_latlat=nn,
        Cov_lonlon=ee,
        Cov_hgthgt=uu,
        Cov_latlon=en,
        Cov_lathgt=nu,
        Cov_lonhgt=eu,
    )
    return pvt + covariance + end
