"""Direction and C/N0 of each satellite of an epoch, and whether it is in the epoch's position or why not."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers, ObservationEpoch
from camber.gnss.observations.differenced_observations import Masks
from camber.gnss.observations.satellite_states import enu_from_ecef_rotation, geodetic, ranges
from camber.gnss.position.rtk_engine import Solution
from camber.gnss.position.single_point import LOWEST_ELEVATION_RAD, SinglePoint
from camber.schemas.gnss import SATELLITE_USES

_NUMBER = {use: number for number, use in enumerate(SATELLITE_USES)}
_SINGLE_POINT_MASKS = Masks(LOWEST_ELEVATION_RAD, -math.inf)


class SatelliteColumns(NamedTuple):
    """One row a satellite (m,); `azimuth_rad` clockwise from north, NaN where something is not known.

    `use` is the place of a term in `SATELLITE_USES`.
    """

    satellite: Integers
    azimuth_rad: Floats
    elevation_rad: Floats
    cn0_dbhz: Floats
    use: Integers


def satellite_columns(epoch: ObservationEpoch, solution: Solution, masks: Masks) -> SatelliteColumns | None:
    """The satellites of a solved epoch; None for an epoch that was not solved because it came too late.

    `masks` are those of the differences to the base; a position of one receiver has its own.
    """
    single = solution.single
    if single is None:
        return None
    at_ecef_m = single.approximate_ecef_m if solution.position_ecef_m is None else solution.position_ecef_m
    azimuth_rad, elevation_rad = _directions(single.states.position_m, at_ecef_m)
    cn0_dbhz = _strongest_dbhz(epoch, single)
    masks = _SINGLE_POINT_MASKS if solution.rows is None else masks
    use = np.full(
        single.satellite.size, _NUMBER["no_position" if solution.rows is None else "not_differenced"]
    )
    use[cn0_dbhz < masks.least_cn0_dbhz] = _NUMBER["below_cn0_mask"]
    use[elevation_rad < masks.lowest_elevation_rad] = _NUMBER["below_elevation_mask"]
    use[np.isnan(single.states.clock_s)] = _NUMBER["no_ephemeris"]
    measured = np.abs(epoch.pseudorange_m[single.codes.row]) < SPEED_OF_LIGHT_M_S
    use[~measured] = _NUMBER["no_pseudorange"]
    if solution.rows is None:
        use[single.excluded] = _NUMBER["outlier"]
        use[single.used] = _NUMBER["used"]
    else:
        _set_use_of_differences(use, solution, single)
    return SatelliteColumns(
        satellite=single.satellite,
        azimuth_rad=azimuth_rad,
        elevation_rad=elevation_rad,
        cn0_dbhz=cn0_dbhz,
        use=use,
    )


def _directions(position_m: Floats, at_ecef_m: Floats) -> tuple[Floats, Floats]:
    """Azimuths and elevations (m,) of satellites (m, 3) from a receiver (3,)."""
    latitude_rad, longitude_rad, _ = geodetic(at_ecef_m)
    _, direction = ranges(position_m, at_ecef_m)
    east, north, up = enu_from_ecef_rotation(latitude_rad, longitude_rad) @ direction.T
    return np.arctan2(east, north), np.arcsin(np.clip(up, -1.0, 1.0))


def _strongest_dbhz(epoch: ObservationEpoch, single: SinglePoint) -> Floats:
    """C/N0 (m,) of each satellite's strongest signal, NaN without any."""
    strongest_dbhz = np.full(single.satellite.size, np.nan)
    of_system = single.codes.place >= 0
    np.fmax.at(strongest_dbhz, single.codes.place[of_system], epoch.cn0_dbhz[of_system])
    return strongest_dbhz


def _set_use_of_differences(use: Integers, solution: Solution, single: SinglePoint) -> None:
    """Write the use of the satellites that were differenced with the base."""
    rows, estimate = solution.rows, solution.estimate
    if rows is None or estimate is None:
        return
    fixed = solution.quality == "fixed"
    at = single.codes.place[rows.rover]
    use[at] = _NUMBER["outlier"]
    use[at[estimate.code_used]] = _NUMBER["integers_unresolved" if fixed else "used"]
    if fixed:
        use[at[~np.isnan(estimate.integer)]] = _NUMBER["used"]
