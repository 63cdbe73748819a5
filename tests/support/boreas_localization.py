"""The localizer on the two drives of `boreas-tracks`: one day's heights are the map, the other day is driven.

Speed and yaw rate are the recording's with errors of a car's sensors added (`SENSORS`); fixes, once a second, are the
recording's places and heights, with a horizontal fault added. Every fix is confirmed, as by a judge without position
evidence, so that the pose follows the fault. There is no LiDAR, and there are no links unless asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.localization import Localization, LocalizationOptions
from camber.localizer.map_queries import MapQueryFailure
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from camber.schemas.motion import Motion
from camber.schemas.pose import Road
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)
from support.boreas_relief import DAYS, MAP_SIGMA_M, ProfileMap, folder, track

Floats = NDArray[np.float64]
FRAME = LocalFrame(math.radians(43.78), math.radians(-79.46), 0.0)
ORIGIN_M = (622_000.0, 4_848_500.0)  # of the plane that stands for the recording's UTM grid
START_NS = 1_300_000_000 * 1_000_000_000
_MOVING_M_S = 0.1
_VERTICES = 40
BOTH_DAYS = (DAYS, DAYS[::-1])
FAULT_AFTER_M = 1500.0
"""Path driven before fixes are led away."""
Fault = Callable[[float, float, float], tuple[float, float]]
"""East and north (m) of a fix less the truth, from seconds and path (m) since the begin of the fault, and heading."""


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Errors of speed (scale, white m/s) and yaw rate (bias rad/s, white rad/s)."""

    scale: float = 0.003
    speed_noise_m_s: float = 0.03
    bias_rad_s: float = math.radians(0.03)
    rate_noise_rad_s: float = math.radians(0.05)


@dataclass(frozen=True, kw_only=True)
class LocalizedDrive:
    """At each fix (n,): time, path, heading, true and fix's place (n, 2); the independent position (n, 2), NaN where
    there is none, its covariance (n, 2, 2), and whether it rests on relief."""

    time_s: Floats
    path_m: Floats
    heading_rad: Floats
    true_m: Floats
    fix_m: Floats
    independent_m: Floats
    covariance: Floats

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where there is an independent position."""
        return np.isfinite(self.independent_m[:, 0])

    @property
    def error_m(self) -> Floats:
        """Independent position less truth, along and across (n, 2)."""
        east, north = (self.independent_m - self.true_m).T
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.column_stack([east * cos + north * sin, north * cos - east * sin])

    @property
    def chi2(self) -> Floats:
        """Squared error over covariance (n,), 2 degrees of freedom."""
        return _chi2(self.independent_m - self.true_m, self.covariance)

    def fault_chi2(self, fix_sigma_m: float = 0.05) -> Floats:
        """The same of the fix less the independent position, with both covariances."""
        return _chi2(self.fix_m - self.independent_m, self.covariance + fix_sigma_m**2 * np.eye(2))


def _chi2(offset: Floats, covariance: Floats) -> Floats:
    out = np.full(len(offset), np.nan)
    known = np.isfinite(offset[:, 0])
    inverse = np.linalg.inv(covariance[known])
    out[known] = np.einsum("ni,nij,nj->n", offset[known], inverse, offset[known])
    return out


class _ProfileQueries:
    """The map: one drive's profile, looked up in the direction of the vehicle, and its track as links, if wanted."""

    def __init__(self, profile: ProfileMap, links: LinksReply | None) -> None:
        self._profile, self._links = profile, links
        self.heading_rad = 0.0

    def elevation(self, request: ElevationRequest) -> ElevationReply | MapQueryFailure:
        east, north = FRAME.east_north_from_geodetic(request.latitude_rad, request.longitude_rad, 0.0)
        place = np.array([east + ORIGIN_M[0]]), np.array([north + ORIGIN_M[1]])
        terrain = self._profile.at(np.array([self.heading_rad]), *place)
        if not np.isfinite(terrain.elevation_m[0]):
            road = Road(status="unknown", reason="no_surface", datum="WGS84", map_version=1)
            return ElevationReply(time_ns=request.time_ns, road=road)
        road = Road(
            status="known",
            surface_id=1,
            level=0,
            elevation_m=float(terrain.elevation_m[0]),
            sigma_m=MAP_SIGMA_M,
            slope_east=float(terrain.slope_east[0]),
            slope_north=float(terrain.slope_north[0]),
            extent_m=5.0,
            datum="WGS84",
            map_version=1,
        )
        return ElevationReply(time_ns=request.time_ns, road=road)

    def links(self, request: LinksRequest) -> LinksReply | MapQueryFailure:
        return self._links or MapQueryFailure("refused", "no links")

    def tile(self, request: TileRequest) -> TileReply | MapQueryFailure:
        return MapQueryFailure("refused", "no tiles")

    def is_available(self) -> bool:
        return True


class _Silent:
    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def issue(self, code: str, text: str) -> None:
        pass

    def count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1


def _track_links(day: str) -> LinksReply:
    """The track as a chain of links of `_VERTICES` vertices, one every 10 m."""
    drive = track(day)
    vertices = np.flatnonzero(np.diff(np.floor(drive.path_m / 10.0), prepend=-1.0) > 0)
    latitude, longitude = np.array(
        [
            FRAME.geodetic_from_east_north(
                drive.east_m[k] - ORIGIN_M[0], drive.north_m[k] - ORIGIN_M[1], 0.0
            )[:2]
            for k in vertices
        ]
    ).T
    starts = np.arange(0, len(vertices) - 1, _VERTICES)
    spans = [np.arange(start, min(start + _VERTICES + 1, len(vertices))) for start in starts]
    rows = np.concatenate(spans)
    count = len(starts)
    return LinksReply(
        time_ns=START_NS,
        status="known",
        map_version=1,
        link_id=np.arange(count, dtype=np.int64) + 1,
        start_node=np.arange(count, dtype=np.int64),
        end_node=np.arange(count, dtype=np.int64) + 1,
        level=np.zeros(count, dtype=np.int32),
        sigma_m=np.full(count, 0.5),
        first_vertex=np.append(0, np.cumsum([len(span) for span in spans])).astype(np.int32),
        latitude_rad=latitude[rows],
        longitude_rad=longitude[rows],
    )


@cache
def _rows(day: str) -> Floats:
    path = folder()
    assert path is not None
    return np.genfromtxt(path / f"{day}.csv", delimiter=",", skip_header=1)


def localize(
    map_day: str,
    drive_day: str,
    *,
    fault: Fault | None = None,
    sensors: Sensors | None = None,
    seed: int = 1,
    from_m: float = 0.0,
    to_m: float = math.inf,
    links: bool = False,
) -> tuple[LocalizedDrive, dict[str, int]]:
    """Run the localizer over a part of a drive; return it with the localizer's counters."""
    sensors, rng, rows = sensors or Sensors(), np.random.default_rng(seed), _rows(drive_day)
    queries, counters = (
        _ProfileQueries(
            ProfileMap(track(map_day), track(drive_day)), _track_links(map_day) if links else None
        ),
        _Silent(),
    )
    options = LocalizationOptions(model=PoseModel(couple_links=links))
    localization = Localization(options, queries, counters)
    path_m = np.append(0.0, np.cumsum(np.hypot(np.diff(rows[:, 1]), np.diff(rows[:, 2]))))
    time_ns = START_NS + np.round((rows[:, 0] - rows[0, 0]) * 1e3).astype(np.int64)
    speed = np.hypot(rows[:, 4], rows[:, 5])
    heading = np.unwrap(np.arctan2(rows[:, 5], rows[:, 4]))
    kept: list[list[float]] = []
    begin_ns: int | None = None
    last_heading = float(heading[int(np.argmax(speed > 1.0))])
    white = rng.standard_normal((len(rows), 2))
    for k in np.flatnonzero((path_m >= from_m) & (path_m < to_m)).tolist():
        if speed[k] > 0.5:
            last_heading = float(heading[k])
        queries.heading_rad = last_heading
        moving = speed[k] > _MOVING_M_S
        wheel = speed[k] * (1.0 - sensors.scale) + sensors.speed_noise_m_s * white[k, 0] if moving else 0.0
        rate = rows[k, 10] + sensors.bias_rad_s + sensors.rate_noise_rad_s * white[k, 1]
        now = int(time_ns[k])
        localization.on_motion(Motion(time_ns=now, wheel_speed_m_s=max(0.0, wheel), yaw_rate_rad_s=rate))
        pose = None
        if k % 10 == 0:
            offset = (0.0, 0.0)
            if fault is not None and path_m[k] - from_m >= FAULT_AFTER_M:
                begin_ns = now if begin_ns is None else begin_ns
                offset = fault((now - begin_ns) * 1e-9, path_m[k] - from_m - FAULT_AFTER_M, last_heading)
            fix_m = rows[k, 1] + offset[0], rows[k, 2] + offset[1]
            latitude, longitude, _ = FRAME.geodetic_from_east_north(
                fix_m[0] - ORIGIN_M[0], fix_m[1] - ORIGIN_M[1], 0.0
            )
            common = {
                "time_ns": now,
                "fix_id": k,
                "latitude_rad": latitude,
                "longitude_rad": longitude,
                "height_m": float(rows[k, 3]),
                "covariance_enu_m2": (4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-4),
            }
            localization.on_fix(Fix(origin="receiver", quality="fixed", **common))
            pose = localization.advance().pose
            if pose is not None and pose.mode != "none":
                localization.on_verdict(Verdict(verdict="confirmed", reason="none", **common))
            row = [now * 1e-9, path_m[k], last_heading, rows[k, 1], rows[k, 2], *fix_m]
            result = None if pose is None else pose.independent
            if result is None:
                row += [math.nan] * 5
            else:
                east, north = FRAME.east_north_from_geodetic(result.latitude_rad, result.longitude_rad, 0.0)
                row += [east + ORIGIN_M[0], north + ORIGIN_M[1], *result.covariance_east_north]
            kept.append(row)
        else:
            localization.advance()
    table = np.array(kept)
    covariance = table[:, [9, 10, 10, 11]].reshape(-1, 2, 2)
    drive = LocalizedDrive(
        time_s=table[:, 0],
        path_m=table[:, 1],
        heading_rad=table[:, 2],
        true_m=table[:, 3:5],
        fix_m=table[:, 5:7],
        independent_m=table[:, 7:9],
        covariance=covariance,
    )
    return drive, counters.counts


def main() -> None:
    """Print the tables of the localizer of docs/theory/relief.md."""
    for links in (True, False):
        for days in BOTH_DAYS:
            drive, _ = localize(*days, links=links)
            known, error = drive.known, np.abs(drive.error_m[drive.known])
            along, across = np.quantile(error, [0.5, 0.95, 1.0], axis=0).T.round(2)
            chi2 = drive.chi2[known]
            print(
                f"links {links}, drive of {days[1]}: known {known.mean():.3f} from {drive.path_m[known][0]:.0f} m; "
                f"along {along} across {across} m; in the 99 % ellipse {(chi2 < 9.21).mean():.3f}; "
                f"largest χ² of a right fix {np.nanmax(drive.fault_chi2()):.1f}",
                flush=True,
            )
    for days in BOTH_DAYS:
        for from_m in (500.0, 2500.0, 4500.0):
            for along, across in ((0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.0, -0.05)):
                fault = led_away(along, across)
                drive, _ = localize(*days, fault=fault, links=True, from_m=from_m, to_m=from_m + 3300.0)
                named = np.flatnonzero(drive.fault_chi2() > 27.6)
                away_m = np.hypot(*(drive.fix_m - drive.true_m).T)
                text = f"{away_m[named[0]]:.2f} m" if len(named) else f"not within {away_m[-1]:.1f} m"
                print(
                    f"{days[1]} from {from_m:g} m, {along:+.2f} along {across:+.2f} across: {text}",
                    flush=True,
                )


def led_away(along_m_s: float, across_m_s: float) -> Fault:
    """Return the fault of fixes that are led away along and to the left of the driven direction."""

    def fault(seconds: float, path_m: float, heading_rad: float) -> tuple[float, float]:
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        east = along_m_s * cos - across_m_s * sin
        return seconds * east, seconds * (along_m_s * sin + across_m_s * cos)

    return fault


if __name__ == "__main__":
    main()
