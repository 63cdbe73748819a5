"""Elevation and slope of a point from a map release, beside one point of one raster with SciPy."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from figure import Figure, lower, per_call_us
from scipy.interpolate import RegularGridInterpolator

from camber.formats.map_release import read_release
from camber.map_server.elevation import ElevationMap
from camber.simulator.short_drive import short_drive_truth, write_short_drive


def of_release(folder: Path) -> list[Figure]:
    release = read_release(folder)
    manifest = release.manifest
    roads = ElevationMap(
        release.surface_tile,
        release.link_tile,
        datum=manifest.datum,
        map_version=manifest.map_version,
        tiles_kept=256,
    )
    truth = short_drive_truth()
    points = list(zip(truth.latitude_rad[60:].tolist(), truth.longitude_rad[60:].tolist(), strict=True))
    grid = RegularGridInterpolator((np.arange(400.0), np.arange(400.0)), np.zeros((400, 400)))
    figures = []
    for name, radius_m in (("", 0.0), (", with the road 5 m around it", 5.0)):

        def ours(radius_m: float = radius_m) -> None:
            for latitude, longitude in points[::20]:
                roads.road_around(latitude, longitude, radius_m, (), None)

        def peer() -> None:
            for place in range(len(points[::20])):
                grid((place + 0.5, 17.3))

        figures.append(
            lower(
                f"elevation of one point{name}",
                "µs",
                per_call_us(ours) / len(points[::20]),
                per_call_us(peer) / len(points[::20]),
                "SciPy RegularGridInterpolator, one point of one raster: no levels, no slope, no σ",
            )
        )
    return figures


def figures() -> list[Figure]:
    with tempfile.TemporaryDirectory() as name:
        write_short_drive(Path(name) / "drive")
        return of_release(Path(name) / "drive" / "map")
