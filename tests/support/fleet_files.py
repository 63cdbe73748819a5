"""What a small fleet saw on days gone by, as files for `camber upload`: a bridge was raised, all else is as it was."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from camber.formats.drive.uploads_csv import COLUMNS
from camber.map_server.elevation_queries import ElevationMap
from camber.replay.short_drive import short_drive_truth
from camber.road_map.release import Release
from camber.runtime.clock import SystemClock

RAISED_M = 0.12
RAISED_S = (66.0, 71.0)
"""Of the short drive, when it is on the piece that was raised: some 45 m on the bridge."""
DAYS_AGO = (9, 9, 8, 7, 6, 5, 4)
"""When each vehicle drove."""
DAY_NS = 86_400 * 10**9


def write_fleet(folder: Path, release: Release, *, seed: int = 3) -> tuple[list[Path], np.ndarray]:
    """A file for each vehicle, `car-1` on; and the ids of the surfaces that are `RAISED_M` higher now."""
    manifest = release.manifest
    truth = short_drive_truth()
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum=manifest.datum, map_version=1)
    roads = the_map.roads(truth.latitude_rad, truth.longitude_rad)
    known = np.flatnonzero(roads.reason == 0)  # columns of roads are of these
    now_s = (truth.time_ns[known] - truth.time_ns[0]) / 1e9
    there = (now_s >= RAISED_S[0]) & (now_s < RAISED_S[1])
    raised = np.unique(roads.surface_id[there])
    rng = np.random.default_rng(seed)
    today_ns = SystemClock().now_ns() // DAY_NS * DAY_NS
    paths = []
    for car, ago in enumerate(DAYS_AGO, start=1):
        path = folder / f"car-{car}.csv"
        with path.open("w", newline="") as file:
            out = csv.DictWriter(file, ("id", *COLUMNS))
            out.writeheader()
            for row, n in enumerate(known.tolist()):
                surface = int(roads.surface_id[row])
                height_m = roads.elevation_m[row] + RAISED_M * (surface in raised) + rng.normal(0.0, 0.01)
                out.writerow(
                    {
                        "id": f"day-{ago}",
                        "vehicle": f"car-{car}",
                        "datum": manifest.datum,
                        "map_version": 1,
                        "epoch_year": manifest.epoch_year,
                        "time_ns": today_ns - ago * DAY_NS + int(truth.time_ns[n] - truth.time_ns[0]),
                        "fix_id": n,
                        "fix_quality": "fixed",
                        "surface_id": surface,
                        "verdict": "erroneous" if surface in raised else "confirmed",
                        "latitude_rad": f"{truth.latitude_rad[n]:.10f}",
                        "longitude_rad": f"{truth.longitude_rad[n]:.10f}",
                        "horizontal_sigma_m": 0.02,
                        "road_height_m": f"{height_m:.4f}",
                        "road_height_sigma_m": 0.03,
                        "antenna_height_m": 1.6,
                    }
                )
        paths.append(path)
    return paths, raised
