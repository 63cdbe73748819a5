"""RTK positions from files of raw observations, by Camber's own engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from camber.api.columns import Columns
from camber.gnss.position.engine_settings import EngineSettings
from camber.tools.gnss.raw_recording import load_raw
from camber.tools.gnss.solve import geodetic_places, run_engine

PathLike = Path | str


def solve(
    rover: PathLike,
    base: PathLike,
    navigation: PathLike | Sequence[PathLike],
    *,
    base_ecef_m: Sequence[float] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Columns:
    """Return one row for each epoch of the rover, in the order of the file.

    The files are RINEX, UBX or RTCM 3, plain or packed. `base_ecef_m` (3,) is the antenna reference point of the base
    where its file does not say it. `settings` are those of the table `engine` (docs/services/gnss.md).

    Columns: `time_ns`; `quality`, which is `fixed`, `float`, `single` or `none`; `latitude_rad`, `longitude_rad`,
    `height_m` (ellipsoidal); `position_ecef_m` (n, 3), `covariance_ecef_m2` (n, 9), by rows; `satellites`; `ratio`;
    `age_s` of the base's epoch. `fixed` is what the engine has resolved: only the judge confirms it.

    Raises FormatError for a file that is not what it should be, OSError for one that cannot be opened, ValueError for a
    setting that cannot be.
    """
    files = [navigation] if isinstance(navigation, Path | str) else list(navigation)
    place = None if base_ecef_m is None else (base_ecef_m[0], base_ecef_m[1], base_ecef_m[2])
    recording = load_raw(Path(rover), Path(base), [Path(file) for file in files], base_ecef_m=place)
    solved = run_engine(recording, recording.rover, EngineSettings(**(settings or {})))
    places = geodetic_places(solved)
    return Columns(
        {
            "time_ns": solved.time_ns,
            "quality": solved.quality,
            "latitude_rad": places[:, 0],
            "longitude_rad": places[:, 1],
            "height_m": places[:, 2],
            "position_ecef_m": solved.position_ecef_m,
            "covariance_ecef_m2": solved.covariance_ecef_m2.reshape(-1, 9),
            "satellites": solved.satellites,
            "ratio": solved.ratio,
            "age_s": solved.age_s,
        }
    )
