"""The reference trajectory of the antenna, and the error of positions against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from camber.formats.drive.truth_csv import TruthTable
from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.schemas.base import Float64, Int64
from camber.schemas.drive import DriveManifest

MAXIMUM_GAP_S = 1.5
"""Chosen: interpolation over a longer gap is off by more than the reference's own error (at 1 m/s² 0.28 m)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReferenceTrajectory:
    """Four arrays (n,): GPS times in strictly ascending order, angles in radians, ellipsoidal heights.

    Raises ValueError, naming the array, otherwise.
    """

    time_ns: Int64
    latitude_rad: Float64
    longitude_rad: Float64
    height_m: Float64

    def __post_init__(self) -> None:
        if self.time_ns.ndim != 1 or self.time_ns.dtype != np.int64:
            raise ValueError("time_ns: expected an array (n,) of int64")
        if not len(self.time_ns):
            raise ValueError("time_ns: expected at least one row")
        if not (np.diff(self.time_ns) > 0).all():
            raise ValueError("time_ns: expected times that rise strictly")
        limits = {"latitude_rad": 0.5 * np.pi, "longitude_rad": np.pi, "height_m": 1.0e5}
        for name, limit in limits.items():
            values = getattr(self, name)
            if values.shape != self.time_ns.shape or values.dtype != np.float64:
                raise ValueError(f"{name}: expected float64 of the shape {self.time_ns.shape} of time_ns")
            if not (np.abs(values) <= limit).all():
                raise ValueError(f"{name}: expected numbers from −{limit:.6g} to {limit:.6g}")

    def at(self, time_ns: Int64) -> tuple[npt.NDArray[np.bool_], Float64, Float64, Float64]:
        """Whether the truth is known at times (n,), and latitude, longitude, height then (NaN where unknown).

        Linear between two rows no more than `MAXIMUM_GAP_S` apart; nothing is extrapolated.
        """
        after = np.searchsorted(self.time_ns, time_ns, side="left")
        exact = self.time_ns[np.minimum(after, len(self.time_ns) - 1)] == time_ns
        before = np.where(exact, after, after - 1).clip(0, len(self.time_ns) - 1)
        after = after.clip(0, len(self.time_ns) - 1)
        gap_ns = self.time_ns[after] - self.time_ns[before]
        between = (gap_ns > 0) & (gap_ns <= MAXIMUM_GAP_S * 1e9)
        known = exact | (between & (self.time_ns[before] < time_ns) & (time_ns < self.time_ns[after]))
        share = np.where(gap_ns > 0, (time_ns - self.time_ns[before]) / np.maximum(gap_ns, 1), 0.0)
        share = np.where(known, share, np.nan)
        # The shorter direction across the antimeridian.
        turn = np.remainder(self.longitude_rad[after] - self.longitude_rad[before] + np.pi, 2 * np.pi) - np.pi
        return (
            known,
            self.latitude_rad[before] + share * (self.latitude_rad[after] - self.latitude_rad[before]),
            self.longitude_rad[before] + share * turn,
            self.height_m[before] + share * (self.height_m[after] - self.height_m[before]),
        )

    def error_enu_m(
        self,
        time_ns: Int64,
        latitude_rad: Float64,
        longitude_rad: Float64,
        height_m: Float64,
        *,
        offset_enu_m: tuple[float, float, float],
    ) -> Float64:
        """Errors (n, 3) east, north, up [m] of positions (n,) against the truth; NaN where unknown.

        The constant offset receiver − reference of the two datums (or antenna points) `offset_enu_m` is subtracted.
        East, north, up are those of the true position.
        """
        error_m = np.full((len(time_ns), 3), np.nan)
        known, latitude, longitude, height = self.at(time_ns)
        known &= np.isfinite(latitude_rad) & np.isfinite(longitude_rad) & np.isfinite(height_m)
        if not known.any():
            return error_m
        latitude, longitude, height = latitude[known], longitude[known], height[known]
        x, y, z = (
            ecef_from_geodetic(latitude_rad[known], longitude_rad[known], height_m[known])
            - ecef_from_geodetic(latitude, longitude, height)
        ).T
        s_lat, c_lat, s_lon, c_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
        outward = c_lon * x + s_lon * y
        enu_m = np.column_stack(
            (c_lon * y - s_lon * x, c_lat * z - s_lat * outward, c_lat * outward + s_lat * z)
        )
        error_m[known] = enu_m - np.asarray(offset_enu_m)
        return error_m


def truth_of(table: TruthTable) -> ReferenceTrajectory:
    """The positions of a truth file."""
    return ReferenceTrajectory(
        time_ns=table.time_ns,
        latitude_rad=table.latitude_rad,
        longitude_rad=table.longitude_rad,
        height_m=table.height_m,
    )


def offset_of(manifest: DriveManifest) -> tuple[float, float, float]:
    """The drive's constant offset receiver − truth: east, north, up [m]; none without truth."""
    truth = manifest.truth
    if truth is None:
        return (0.0, 0.0, 0.0)
    return (
        truth.receiver_minus_truth_east_m,
        truth.receiver_minus_truth_north_m,
        truth.receiver_minus_truth_up_m,
    )
