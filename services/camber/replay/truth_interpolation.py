"""The truth between its epochs."""

import numpy as np
import numpy.typing as npt

from camber.formats.drive.truth_csv import TruthTable
from camber.geodesy.angles import wrap_pi_array
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.base import Float64, Int64

LONGEST_GAP_NS = 1_000_000_000
"""Between epochs further apart than this nothing is known."""


def interpolate_truth(truth: TruthTable, time_ns: Int64) -> tuple[TruthTable, npt.NDArray[np.bool_]]:
    """The truth at times (n,) that need no order, and which of them (n,) bool are known.

    The table has a row for each *known* time only, in the order asked for. Linear between epochs at most one second
    apart: at 5 Hz and 3 m/s² that misses up to 15 mm. At an epoch it is the epoch. `fix_state` belongs to epochs and is
    left out.
    """
    asked = np.asarray(time_ns, dtype=np.int64)
    if len(truth) == 0:
        raise ValueError("truth has no epochs, expected at least one")
    after = np.searchsorted(truth.time_ns, asked, side="left")
    inside = after < len(truth)
    exact = inside & (truth.time_ns[np.minimum(after, len(truth) - 1)] == asked)
    i1 = np.clip(after, 0, len(truth) - 1)
    i0 = np.where(exact, i1, np.maximum(i1 - 1, 0))
    gap_ns = truth.time_ns[i1] - truth.time_ns[i0]
    known = exact | (inside & (after > 0) & (gap_ns <= LONGEST_GAP_NS))
    i0, i1, asked, gap_ns = i0[known], i1[known], asked[known], gap_ns[known]
    share = np.where(gap_ns > 0, (asked - truth.time_ns[i0]) / np.maximum(gap_ns, 1), 0.0)

    def between(values: Float64) -> Float64:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[i0] + weight * (values[i1] - values[i0]))

    def angle(values: Float64) -> Float64:
        return wrap_pi_array(values[i0] + share * wrap_pi_array(values[i1] - values[i0]))

    table = TruthTable(
        time_ns=asked,
        latitude_rad=between(truth.latitude_rad),
        longitude_rad=angle(truth.longitude_rad),
        height_m=between(truth.height_m),
        roll_rad=angle(truth.roll_rad),
        pitch_rad=angle(truth.pitch_rad),
        yaw_rad=angle(truth.yaw_rad),
        velocity_enu_m_s=between(truth.velocity_enu_m_s),
    )
    return table, known


def plane_of(truth: TruthTable) -> LocalFrame:
    """The frame for lengths along this drive: at its first epoch, height zero."""
    return LocalFrame(float(truth.latitude_rad[0]), float(truth.longitude_rad[0]), 0.0)
