"""A position in which no satellite's east and north has a part: a pose filter that is never anchored.

Its evidence is a given pose, scan matches and the road's relief (`update_height`); odometry carries it, and the map's
links are coupled to it by a link matching of its own. The sensors' errors are learnt from the same evidence, and at
standstills. It has no access to fixes and verdicts, so that none of them can change a bit of it.

A scan match counts only if it converged, that is, if it determines east, north and yaw by itself. One that was
predicted from this pose updates it. One that was predicted from another pose, which may rest on fixes, could have
been led to a similar place by it: only unique ones count, found by a search, and they restart the position once
several agree along the driven track and, where there is a position, lie within its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.dead_reckoning_time_update import EAST, NORTH, YAW
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import InertialReading
from camber.localizer.filter.planar_pose import largest_variance, rotated
from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.scan_match_update import MatchUpdate
from camber.localizer.filter.start_from_fixes import StartPose
from camber.localizer.filter.track import OverlayLag
from camber.localizer.matching.match_covariance import DEGENERATE_SIGMA_M
from camber.schemas.motion import Motion
from camber.schemas.pose import IndependentBasis

HeightOutcome: TypeAlias = Literal["accepted", "outside_gate", "no_pose", "too_old", "ahead"]

_HEIGHT_GATE: Final = 15.14  # chi-square, 1 degree of freedom, 99.99 %
_HEIGHT_MAX_AGE_NS: Final = 1_000_000_000  # chosen: as a scan match, `PoseModel.match_max_age_s`
_NO_LAG: Final = OverlayLag()


class Evidence(NamedTuple):
    """The last evidence of the position: its kind and time, and the path driven then."""

    basis: IndependentBasis
    time_ns: int
    travelled_m: float


class HeightUpdate(NamedTuple):
    """Outcome of a height; `nis` is the normalised innovation squared (1 degree of freedom)."""

    outcome: HeightOutcome
    nis: float | None = None


class IndependentPoseFilter:
    """Estimates the position. Call `predict` with every motion sample, the updates as they come."""

    def __init__(self, model: PoseModel | None = None, *, extra_states: int = 0) -> None:
        self.filter = PoseFilter(model, extra_states=extra_states)
        """For predictions, and the track. Its state has `extra_states` more, at `filter.state.extra`."""
        self._evidence: Evidence | None = None

    @property
    def evidence(self) -> Evidence | None:
        """The last evidence; None without a position."""
        return None if self.filter.mode == "none" else self._evidence

    @property
    def state(self) -> FilterState:
        """State and covariance: pose of the vehicle's reference point, sensors, and the extra states."""
        return self.filter.state

    @property
    def distance_m(self) -> float:
        """Distance driven since the last evidence."""
        return 0.0 if self._evidence is None else self.filter.travelled_m - self._evidence.travelled_m

    def estimate(self) -> PoseEstimate | None:
        """Return the present pose; None without evidence."""
        return None if self.evidence is None else self.filter.estimate()

    def predict(self, sample: Motion, inertial: InertialReading | None = None) -> None:
        """Propagate the pose to this sample, see `PoseFilter.predict`."""
        self.filter.predict(sample, inertial)

    def start(self, pose: StartPose, basis: IndependentBasis) -> bool:
        """Start from a pose that no fix had a part in; return whether it was used."""
        if pose.provenance == "fixes" or not self.filter.start(pose):
            return False
        self.note_evidence(basis, pose.time_ns)
        return True

    def note_evidence(self, basis: IndependentBasis, time_ns: int) -> None:
        """Note that the position was observed at a time."""
        self._evidence = Evidence(basis, time_ns, self.filter.travelled_m)

    def match(
        self,
        time_ns: int,
        pose: tuple[float, float, float],
        covariance: Floats,
        *,
        unique: bool,
        overlay_lag: OverlayLag = _NO_LAG,
        predicted_here: bool = True,
    ) -> MatchUpdate:
        """Update by a scan match that converged, see `PoseFilter.match`.

        Not `predicted_here`: it was predicted from another pose.
        """
        result = self.filter.match(
            time_ns, pose, covariance, unique=unique, overlay_lag=overlay_lag, restart=not predicted_here
        )
        if result.accepted and largest_variance(covariance) <= DEGENERATE_SIGMA_M**2:
            self.note_evidence("scan_match", time_ns)
        return result

    def update_height(
        self,
        time_ns: int,
        residual_m: float,
        slope: tuple[float, float],
        *,
        variance_m2: float,
        extra: Sequence[float] = (),
    ) -> HeightUpdate:
        """Update by a height [m] at a past place, less the one expected there by this position.

        `residual = slope · (place − estimate there) + extra · (extra states) + noise`, with the road's slope (east,
        north) there, the partial derivatives `extra` by the extra states, and the variance of the noise. The place is
        the vehicle's reference point carried to the present by the driven track; a lever arm to it turns with the yaw
        and is left out, as it changes the height by slope × lever × yaw error only. Whether it is evidence of the
        position is for the caller to decide (`note_evidence`): a flat road is none.
        """
        if self.evidence is None:
            return HeightUpdate("no_pose")
        now, then = self.filter.time_ns, self.filter.track.at(time_ns)
        here = None if now is None else self.filter.track.at(now)
        if now is None or then is None or here is None:
            return HeightUpdate("ahead" if now is None or time_ns > now else "too_old")
        if now - time_ns > _HEIGHT_MAX_AGE_NS:
            return HeightUpdate("too_old")
        state = self.state
        frame = float(state.x[YAW]) - here.yaw_rad
        since = rotated(frame, here.east_m - then.east_m, here.north_m - then.north_m)
        h = state.rows(1)
        h[0, EAST], h[0, NORTH] = slope
        h[0, YAW] = slope[0] * since[1] - slope[1] * since[0]
        h[0, state.extra] = extra
        innovation = np.array([residual_m - float(h[0, state.extra] @ state.x[state.extra])])
        variance = float((h @ state.p @ h.T)[0, 0]) + variance_m2
        nis = float(innovation[0]) ** 2 / variance
        if nis > _HEIGHT_GATE:
            return HeightUpdate("outside_gate", nis)
        state.update_joseph(h, innovation, np.array([[variance_m2]]))
        return HeightUpdate("accepted", nis)
