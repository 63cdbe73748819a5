"""The road map of a folder: elevation, slope and uncertainty under points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from camber.api.columns import Columns
from camber.map_server.elevation_queries import REASONS
from camber.map_server.release_queries import ReleaseQueries
from camber.road_map.release import open_release


class Map:
    """A map release. Raises ReleaseError where the folder has none, or a damaged one."""

    def __init__(self, folder: Path | str) -> None:
        release = open_release(Path(folder))
        self.datum = release.manifest.datum
        self.version = release.manifest.map_version
        self._queries = ReleaseQueries(release)

    def elevations(self, latitude_rad: ArrayLike, longitude_rad: ArrayLike) -> Columns:
        """Return the road under n points: `elevation_m` (ellipsoidal), `sigma_m`, `slope_east`, `slope_north`,
        `surface_id`, `level` and `reason`.

        `reason` is 'none' where the road is known, else 'no_surface' or 'levels_ambiguous', with NaN and −1 in the
        other columns. Raises ValueError for arrays of different lengths, ReleaseError for a damaged tile.
        """
        latitude, longitude = np.atleast_1d(latitude_rad), np.atleast_1d(longitude_rad)
        roads = self._queries.roads(latitude, longitude)
        columns = {"reason": np.array(REASONS)[roads.reason]}
        for name in ("elevation_m", "sigma_m", "slope_east", "slope_north"):
            columns[name] = np.full(len(latitude), np.nan)
            columns[name][roads.known] = getattr(roads, name)
        for name in ("surface_id", "level"):
            columns[name] = np.full(len(latitude), -1, np.int64)
            columns[name][roads.known] = getattr(roads, name)
        return Columns(columns)
