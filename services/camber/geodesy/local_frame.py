"""East-north-up frames tangent to the ellipsoid, for distances of kilometres.

**Up is not height.** The frame is a plane that touches the ellipsoid at the origin, and the earth curves away
below it: a point 4 km off at the same ellipsoidal height lies 1.25 m *below* the plane (d² / 2R), at 20 km 31
m. Compare ellipsoidal heights only. The filters of the vehicle therefore work with
(east, north) of this frame and carry the *ellipsoidal height* beside it, by `east_north_from_geodetic` and
its exact inverse.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camber.geodesy.ellipsoid import (
    ecef_from_geodetic,
    ecef_from_geodetic_scalar,
    geodetic_from_ecef,
    geodetic_from_ecef_scalar,
)

# A height missed by this much moves a point 20 km off by 3e-9 m in the plane.
_HEIGHT_TOLERANCE_M = 1.0e-6
_MAXIMUM_STEPS = 20
_MEAN_RADIUS_M = 6.371e6

_Vector = tuple[float, float, float]
_Arrays = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East-north-up frame with its origin at a latitude, longitude and ellipsoidal height (WGS 84).

    Methods ending in `_array` take and give arrays of n points; the others one point as plain floats. Raises
    ValueError when the origin is not finite or its latitude lies beyond a pole. At a pole itself, east and
    north are those of the meridian given by the longitude.
    """

    latitude_rad: float
    longitude_rad: float
    height_m: float
    _origin_ecef_m: _Vector = field(init=False, repr=False, compare=False)
    _east: _Vector = field(init=False, repr=False, compare=False)
    _north: _Vector = field(init=False, repr=False, compare=False)
    _up: _Vector = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not abs(self.latitude_rad) <= 0.5 * math.pi:
            raise ValueError(f"latitude_rad is {self.latitude_rad}, expected −π/2 to π/2")
        if not (math.isfinite(self.longitude_rad) and math.isfinite(self.height_m)):
            raise ValueError(
                f"longitude_rad, height_m are {self.longitude_rad}, {self.height_m}, expected finite numbers"
            )
        s_lat, c_lat = math.sin(self.latitude_rad), math.cos(self.latitude_rad)
        s_lon, c_lon = math.sin(self.longitude_rad), math.cos(self.longitude_rad)
        origin = ecef_from_geodetic_scalar(self.latitude_rad, self.longitude_rad, self.height_m)
        object.__setattr__(self, "_origin_ecef_m", origin)
        object.__setattr__(self, "_east", (-s_lon, c_lon, 0.0))
        object.__setattr__(self, "_north", (-s_lat * c_lon, -s_lat * s_lon, c_lat))
        object.__setattr__(self, "_up", (c_lat * c_lon, c_lat * s_lon, s_lat))

    def enu_from_ecef_rotation(self) -> NDArray[np.float64]:
        """Rotation (3, 3) that takes ECEF vectors to east, north, up."""
        return np.array([self._east, self._north, self._up])

    # one point

    def enu_from_ecef(self, x_m: float, y_m: float, z_m: float) -> _Vector:
        """East, north, up [m] of an ECEF point [m]."""
        x0, y0, z0 = self._origin_ecef_m
        dx, dy, dz = x_m - x0, y_m - y0, z_m - z0
        ex, ey, _ = self._east
        nx, ny, nz = self._north
        ux, uy, uz = self._up
        return ex * dx + ey * dy, nx * dx + ny * dy + nz * dz, ux * dx + uy * dy + uz * dz

    def ecef_from_enu(self, east_m: float, north_m: float, up_m: float) -> _Vector:
        """ECEF x, y, z [m] of a point given in east, north, up [m]."""
        x0, y0, z0 = self._origin_ecef_m
        ex, ey, _ = self._east
        nx, ny, nz = self._north
        ux, uy, uz = self._up
        return (
            x0 + ex * east_m + nx * north_m + ux * up_m,
            y0 + ey * east_m + ny * north_m + uy * up_m,
            z0 + nz * north_m + uz * up_m,
        )

    def enu_from_geodetic(self, latitude_rad: float, longitude_rad: float, height_m: float) -> _Vector:
        """East, north, up [m] of a point; up is above the tangent plane, no difference of heights."""
        return self.enu_from_ecef(*ecef_from_geodetic_scalar(latitude_rad, longitude_rad, height_m))

    def geodetic_from_enu(self, east_m: float, north_m: float, up_m: float) -> _Vector:
        """Latitude [rad], longitude [rad], ellipsoidal height [m]; up is above the tangent plane."""
        return geodetic_from_ecef_scalar(*self.ecef_from_enu(east_m, north_m, up_m))

    def east_north_from_geodetic(
        self, latitude_rad: float, longitude_rad: float, height_m: float
    ) -> tuple[float, float]:
        """East and north [m] in the tangent plane, the ellipsoidal height being carried separately."""
        east_m, north_m, _ = self.enu_from_geodetic(latitude_rad, longitude_rad, height_m)
        return east_m, north_m

    def geodetic_from_east_north(self, east_m: float, north_m: float, height_m: float) -> _Vector:
        """The point with this east, north [m] that stands at this *ellipsoidal height*: inverse of the above.

        Returns latitude [rad], longitude [rad] and the given height. Round trips agree to 1e-6 m within 20 km
        (far better in practice). The unknown `up` is found by Newton's method with dh/dup taken as 1, the
        cosine of the angle between the two verticals. Raises ValueError where there is no such point or a
        number is not finite.
        """
        up_m = height_m - self.height_m - (east_m * east_m + north_m * north_m) / (2.0 * _MEAN_RADIUS_M)
        for _ in range(_MAXIMUM_STEPS):
            latitude_rad, longitude_rad, reached_m = self.geodetic_from_enu(east_m, north_m, up_m)
            missing_m = height_m - reached_m
            if abs(missing_m) < _HEIGHT_TOLERANCE_M:
                return latitude_rad, longitude_rad, height_m
            up_m += missing_m
        raise ValueError(f"no point at east {east_m} m, north {north_m} m, ellipsoidal height {height_m} m")

    # n points

    def enu_from_geodetic_array(
        self, latitude_rad: ArrayLike, longitude_rad: ArrayLike, height_m: ArrayLike
    ) -> NDArray[np.float64]:
        """East, north, up (n, 3) [m] of n points given as three arrays (n,)."""
        ecef_m = ecef_from_geodetic(latitude_rad, longitude_rad, height_m)
        enu_m: NDArray[np.float64] = (
            ecef_m - np.array(self._origin_ecef_m)
        ) @ self.enu_from_ecef_rotation().T
        return enu_m

    def geodetic_from_enu_array(self, enu_m: ArrayLike) -> _Arrays:
        """Latitudes [rad], longitudes [rad], ellipsoidal heights [m], each (n,), of points (n, 3)."""
        points = np.asarray(enu_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"enu_m has shape {points.shape}, expected (n, 3)")
        if not bool(np.all(np.isfinite(points))):
            raise ValueError("enu_m has a point that is not finite")
        return geodetic_from_ecef(points @ self.enu_from_ecef_rotation() + np.array(self._origin_ecef_m))

    def east_north_from_geodetic_array(
        self, latitude_rad: ArrayLike, longitude_rad: ArrayLike, height_m: ArrayLike
    ) -> NDArray[np.float64]:
        """East and north (n, 2) [m] of n points, their ellipsoidal heights being carried separately."""
        return self.enu_from_geodetic_array(latitude_rad, longitude_rad, height_m)[:, :2]

    def geodetic_from_east_north_array(self, east_north_m: ArrayLike, height_m: ArrayLike) -> _Arrays:
        """As `geodetic_from_east_north` for east and north (n, 2) [m] and ellipsoidal heights (n,) [m]."""
        plane = np.asarray(east_north_m, dtype=np.float64)
        if plane.ndim != 2 or plane.shape[1] != 2:
            raise ValueError(f"east_north_m has shape {plane.shape}, expected (n, 2)")
        height = np.broadcast_to(np.asarray(height_m, dtype=np.float64), plane.shape[:1]).copy()
        up = height - self.height_m - np.sum(plane**2, axis=1) / (2.0 * _MEAN_RADIUS_M)
        for _ in range(_MAXIMUM_STEPS):
            latitude, longitude, reached = self.geodetic_from_enu_array(np.column_stack((plane, up)))
            missing = height - reached
            if bool(np.all(np.abs(missing) < _HEIGHT_TOLERANCE_M)):
                return latitude, longitude, height
            up += missing
        raise ValueError("east_north_m has a point that is at no latitude and longitude with its height")
