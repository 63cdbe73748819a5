"""Raw observations of a simulated drive in the open: as RINEX, UBX, SBF, RTCM, by epoch; where its antenna is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from camber.formats.drive.truth_csv import TruthTable, read_truth
from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.replay.observation_files import read_observation_file
from camber.schemas.gnss import Fix
from support.running import camber
from support.sbf_drive import sbf_of_ubx

DURATION_S, RATE_HZ = 6, 10


class RawDrive:
    """Its files; `…_parts` are the payloads of one epoch each, at `times_ns`."""

    def __init__(self, folder: Path) -> None:
        made = camber(
            "simulate", "open-sky", "--set", f"duration_s={DURATION_S}", "--set", "satellites.base_distance_m=500",
            "--out", folder, "--quiet", timeout_s=120.0,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr
        self.folder = folder
        _, _, parts = read_observation_file(folder / "rover.ubx", None)
        self.times_ns = [part.time_ns for part in parts]
        self.ubx_parts = [part.payload for part in parts]
        (folder / "rover.sbf").write_bytes(sbf_of_ubx((folder / "rover.ubx").read_bytes(), self.times_ns[0]))
        _, _, parts = read_observation_file(folder / "rover.sbf", None)
        self.sbf_parts = [part.payload for part in parts]
        _, _, parts = read_observation_file(folder / "base.rtcm", self.times_ns[0])
        self.rtcm_parts = [part.payload for part in parts]
        self.rover_header, self.rover_rinex_parts = self._rinex("rover.obs")
        self.base_header, self.base_rinex_parts = self._rinex("base.obs")
        self.navigation = (folder / "brdc.nav").read_bytes()
        self._truth = read_truth(folder / "truth.csv", "camber")

    def error_m(self, fix: Fix) -> float:
        """How far a fix is from the truth of its epoch, in three dimensions."""
        return error_m(self._truth, fix)

    def frames(self, epoch: int) -> list[bytes]:
        """The base's messages of one epoch."""
        return [frame.data for frame in FrameBuffer("rtcm").feed(self.rtcm_parts[epoch])]

    def _rinex(self, name: str) -> tuple[bytes, list[bytes]]:
        _, header, parts = read_observation_file(self.folder / name, None)
        return header, [part.payload for part in parts]


def error_m(truth: TruthTable, fix: Fix) -> float:
    """How far a fix is from the truth of its epoch, in three dimensions."""
    (row,) = np.flatnonzero(truth.time_ns == fix.time_ns).tolist()
    place = (truth.latitude_rad[row], truth.longitude_rad[row], truth.height_m[row])
    true_m = ecef_from_geodetic_scalar(*map(float, place))
    position_m = ecef_from_geodetic_scalar(fix.latitude_rad, fix.longitude_rad, fix.height_m)
    return float(np.linalg.norm(np.subtract(position_m, true_m)))
