"""Simulated observations through RTKLIB's `rnx2rtkp`, one epoch at a time, against the truth."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.formats.rinex.writer import StationHeader, navigation_text
from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.geodesy.gps_time import gps_ns_from_week_tow, nanoseconds_from_decimal
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.satellites.atmosphere import KLOBUCHAR_ALPHA, KLOBUCHAR_BETA
from support.gnss_files import observation_text

RNX2RTKP = shutil.which("rnx2rtkp")

OPTIONS = """pos1-posmode=kinematic
pos1-frequency=l1+2
pos1-soltype=forward
pos1-elmask=15
pos1-dynamics=off
pos1-ionoopt=brdc
pos1-tropopt=saas
pos1-sateph=brdc
pos1-navsys=57
pos2-armode=instantaneous
pos2-gloarmode=off
pos2-bdsarmode=on
pos2-arthres=3
pos2-arminfix=0
out-solformat=llh
out-timesys=gpst
out-timeform=tow
out-timendec=3
out-height=ellipsoidal
out-solstatic=all
ant2-postype=xyz
"""


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """Solutions of RTKLIB, columns (n,): quality 1 is fixed; errors (n, 3) east, north, up against the truth."""

    time_ns: NDArray[np.int64]
    quality: NDArray[np.int64]
    satellites: NDArray[np.int64]
    ratio: NDArray[np.float64]
    error_enu_m: NDArray[np.float64]

    @property
    def fixed(self) -> NDArray[np.bool_]:
        return self.quality == 1

    @property
    def horizontal_m(self) -> NDArray[np.float64]:
        return np.hypot(self.error_enu_m[:, 0], self.error_enu_m[:, 1])


def run_rtklib(
    folder: Path,
    rover: Sequence[ObservationEpoch],
    base: Sequence[ObservationEpoch],
    ephemerides: Sequence[Ephemeris],
    frame: LocalFrame,
    truth_time_ns: NDArray[np.int64],
    truth_m: NDArray[np.float64],
    base_m: tuple[float, float, float],
) -> Solutions:
    """Writes the three files, runs `rnx2rtkp` and compares; truth (n, 3) in the world frame."""
    assert RNX2RTKP is not None
    base_ecef = ecef_of(frame, np.array([base_m]))[0]
    station = StationHeader(marker="BASE", position_ecef_m=tuple(base_ecef.tolist()))
    (folder / "base.obs").write_text(observation_text(base, station))
    rover_ecef = ecef_of(frame, truth_m[:1])[0]
    (folder / "rover.obs").write_text(
        observation_text(rover, StationHeader(marker="ROVER", position_ecef_m=tuple(rover_ecef.tolist())))
    )
    ionosphere = IonosphereCoefficients(system="G", alpha=KLOBUCHAR_ALPHA, beta=KLOBUCHAR_BETA)
    (folder / "brdc.nav").write_text(navigation_text(ephemerides, [ionosphere]))
    x, y, z = base_ecef
    (folder / "options.conf").write_text(
        OPTIONS + f"ant2-pos1={x:.4f}\nant2-pos2={y:.4f}\nant2-pos3={z:.4f}\n"
    )
    subprocess.run(
        [RNX2RTKP, "-k", "options.conf", "-o", "out.pos", "rover.obs", "base.obs", "brdc.nav"],
        cwd=folder,
        check=True,
        capture_output=True,
        stdin=subprocess.DEVNULL,
        timeout=300,
    )
    return _read(folder / "out.pos", frame, truth_time_ns, truth_m)


def ecef_of(frame: LocalFrame, world_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """ECEF of points (n, 3) of a world frame: plane and ellipsoidal height."""
    up = np.array([frame.geodetic_from_east_north(e, n, h) for e, n, h in world_m.tolist()])
    return ecef_from_geodetic(up[:, 0], up[:, 1], up[:, 2])


def _read(
    file: Path, frame: LocalFrame, truth_time_ns: NDArray[np.int64], truth_m: NDArray[np.float64]
) -> Solutions:
    rows = [line.split() for line in file.read_text().splitlines() if line and not line.startswith("%")]
    time_ns = np.array(
        [gps_ns_from_week_tow(int(r[0]), nanoseconds_from_decimal(r[1])) for r in rows], np.int64
    )
    values = np.array([[float(v) for v in r[2:]] for r in rows]).reshape(len(rows), -1)
    if not len(rows):
        return Solutions(time_ns, np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)))
    lat, lon = np.deg2rad(values[:, 0]), np.deg2rad(values[:, 1])
    plane = frame.east_north_from_geodetic_array(lat, lon, values[:, 2])
    at = np.column_stack([np.interp(time_ns, truth_time_ns, truth_m[:, k]) for k in range(3)])
    error = np.column_stack((plane - at[:, :2], values[:, 2] - at[:, 2]))
    return Solutions(
        time_ns, values[:, 3].astype(np.int64), values[:, 4].astype(np.int64), values[:, 12], error
    )
