"""Where the beams of a rotating LiDAR look, and when.

The elevations are those that the makers of two common sensors print in their data sheets: 64 beams in two blocks (32
from +2° every ⅓°, 32 from −8.83° every ½°), and 32 beams from +10.67° to −30.67° every 4/3°.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.simulator.scene import Floats, Integers


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamPattern:
    """A rotating sensor. It turns clockwise seen from above, each turn beginning at the vehicle's back.

    All beams fire one after the other during `firing_share` of a column, in the order of `elevation_deg`, `azimuth_deg`
    off the column. `up_m`: how far above the sensor's origin the beams begin; nothing: none is.
    """

    name: str
    elevation_deg: tuple[float, ...]
    azimuth_deg: tuple[float, ...]
    columns: int
    turn_ns: int = 100_000_000
    firing_share: float = 0.85
    least_range_m: float = 1.0
    most_range_m: float = 120.0
    range_sigma_m: float = 0.02
    range_step_m: float = 0.002
    up_m: tuple[float, ...] = ()

    @property
    def rays(self) -> int:
        """In one turn."""
        return self.columns * len(self.elevation_deg)

    def directions(self) -> Floats:
        """Unit vectors (rays, 3) in the sensor's frame, in the order of firing: column by column."""
        elevation = np.radians(self.elevation_deg)
        around = np.pi - 2.0 * np.pi * (np.arange(self.columns) + 0.5) / self.columns
        azimuth = around[:, None] + np.radians(self.azimuth_deg)
        flat = np.broadcast_to(np.cos(elevation), azimuth.shape)
        up = np.broadcast_to(np.sin(elevation), azimuth.shape)
        return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), up), axis=-1).reshape(-1, 3)

    def rises_m(self) -> Floats:
        """How far above the sensor's origin each ray (rays,) begins."""
        return np.tile(np.array(self.up_m or (0.0,) * len(self.elevation_deg)), self.columns)

    def column_shares(self) -> Floats:
        """When each beam (beams,) fires, in columns after its column's beginning."""
        return self.firing_share * np.arange(len(self.elevation_deg)) / len(self.elevation_deg)

    def offsets_ns(self) -> Integers:
        """When each ray (rays,) leaves, against the end of the turn: −`turn_ns` to 0."""
        columns = np.arange(self.columns)[:, None] + self.column_shares()
        late = np.rint(columns * (self.turn_ns / self.columns)).astype(np.int64)
        return late.reshape(-1) - self.turn_ns


BEAMS_64 = BeamPattern(
    name="lidar64",
    elevation_deg=tuple([2.0 - k / 3.0 for k in range(32)] + [-8.0 - 5.0 / 6.0 - 0.5 * k for k in range(32)]),
    # The upper block's diodes stand in two columns, 4.5° to either side; the lower block's likewise.
    azimuth_deg=tuple(4.5 if k % 2 else -4.5 for k in range(64)),
    columns=1800,
)
BEAMS_32 = BeamPattern(
    name="lidar32",
    elevation_deg=tuple(10.0 + 2.0 / 3.0 - 4.0 / 3.0 * k for k in range(32)),
    azimuth_deg=(0.0,) * 32,
    columns=1800,
    most_range_m=100.0,
)
PATTERNS = {pattern.name: pattern for pattern in (BEAMS_64, BEAMS_32)}
