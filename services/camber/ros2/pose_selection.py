"""Which pose Autoware's filter gets: GNSS where Camber has confirmed the fix that it was made of, else NDT.

Modes, limits and the σ of the NDT pose between them are those of autoware_pose_covariance_modifier (Autoware Universe,
README.md, "Flowcharts" and "NDT covariance calculation"). What differs: a GNSS pose counts only with the stamp of a fix
that was confirmed and whose position is usable, and NDT poses pass again as soon as such poses cease.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

PoseSource = Literal["GNSS", "GNSS_NDT", "NDT"]
_REMEMBERED = 64  # chosen: six seconds of fixes at 10 Hz, more than any age limit
_X, _Y, _Z, _YAW = 0, 7, 14, 35  # of a row-major 6 × 6 covariance
_NDT_SIGMA_M = (0.15, 0.30)
"""Between these the NDT pose's σ is set. Chosen: from that of ndt_scan_matcher's preset covariance to twice it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseLimits:
    """Standard deviations of a GNSS pose. `gnss_alone_m`: up to it NDT is not used; `timeout_s`: since the stamp."""

    most_yaw_rad: float
    most_height_m: float
    gnss_alone_m: float
    most_horizontal_m: float
    timeout_s: float


class PoseSelection:
    """Takes GNSS and NDT poses, both PoseWithCovarianceStamped, and returns what is passed on."""

    def __init__(self, limits: PoseLimits) -> None:
        self._limits = limits
        self._trusted: deque[int] = deque(maxlen=_REMEMBERED)
        self._source: PoseSource = "NDT"
        self._gnss: tuple[int, Any] = (0, None)

    def add_trusted(self, unix_ns: int) -> None:
        """Trust the GNSS pose with this stamp: its fix is confirmed and its position usable."""
        self._trusted.append(unix_ns)

    def source(self, now_unix_ns: int) -> PoseSource:
        """Return which poses are passed on now."""
        fresh = 0 <= now_unix_ns - self._gnss[0] <= self._limits.timeout_s * 1e9
        return self._source if fresh else "NDT"

    def gnss(self, pose: Any, stamp_unix_ns: int, now_unix_ns: int) -> Any | None:
        """Return a GNSS pose that is to be passed on, None for one that is not."""
        source = self._source_of(pose) if stamp_unix_ns in self._trusted else "NDT"
        if source == "NDT":
            return None  # an older pose that was trusted still counts until it is too old
        self._source, self._gnss = source, (stamp_unix_ns, pose)
        return pose if self.source(now_unix_ns) != "NDT" else None

    def ndt(self, pose: Any, now_unix_ns: int) -> Any | None:
        """Return the NDT pose as it is to be passed on; None while the GNSS pose alone is."""
        source = self.source(now_unix_ns)
        if source == "NDT":
            return pose
        return None if source == "GNSS" else self._weighted(pose)

    def _source_of(self, pose: Any) -> PoseSource:
        variances = np.asarray(pose.pose.covariance, np.float64)[[_X, _Y, _Z, _YAW]]
        if not (np.isfinite(variances).all() and (variances >= 0.0).all()):
            return "NDT"
        x_m, y_m, z_m, yaw_rad = np.sqrt(variances).tolist()
        limits, horizontal_m = self._limits, 0.5 * (x_m + y_m)
        if yaw_rad > limits.most_yaw_rad or z_m > limits.most_height_m:
            return "NDT"
        if horizontal_m <= limits.gnss_alone_m:
            return "GNSS"
        return "GNSS_NDT" if horizontal_m <= limits.most_horizontal_m else "NDT"

    def _weighted(self, pose: Any) -> Any:
        """The NDT pose, whose σ is the smaller the larger that of the GNSS pose is."""
        covariance = np.array(pose.pose.covariance, np.float64)
        gnss = np.asarray(self._gnss[1].pose.covariance, np.float64)
        least_m, most_m = _NDT_SIGMA_M
        span_m = self._limits.most_horizontal_m - self._limits.gnss_alone_m
        for i in (_X, _Y, _Z):
            if covariance[i] >= 0.0 and least_m <= math.sqrt(covariance[i]) <= most_m:
                share = (math.sqrt(gnss[i]) - self._limits.gnss_alone_m) / span_m
                covariance[i] = max(most_m - share * (most_m - least_m), least_m) ** 2
        return replace(pose, pose=replace(pose.pose, covariance=covariance))
