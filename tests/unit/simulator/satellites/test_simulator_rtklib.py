"""RTKLIB reads what is simulated and behaves as on the road; many more runs: `python -m support.canyon_statistics`."""

import numpy as np
import pytest

from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from camber.simulator.satellites.observations import simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER
from camber.simulator.satellites.track import AntennaTrack, static_track
from support.canyon_statistics import BASE_M, FRAME, canyon_statistics
from support.rtklib_runs import RNX2RTKP, run_rtklib

pytestmark = pytest.mark.skipif(RNX2RTKP is None, reason="rnx2rtkp is not installed (Debian: rtklib)")


@pytest.mark.parametrize(("seed", "hour"), [(1, 2), (2, 13), (3, 23)])
def test_in_the_open_rtklib_fixes_nearly_every_epoch_within_two_centimetres(tmp_path, seed, hour):
    begin = gps_ns_from_gpst(CalendarTime(2026, 5, 2, hour, 59, 0))  # over a full hour: sets change
    n = 100
    s = np.arange(n, dtype=np.float64)
    velocity = np.tile([8.0, 3.0, 0.1], (n, 1))
    place = np.array([-300.0, 0.0, 60.0]) + s[:, None] * velocity
    time_ns = begin + np.arange(n, dtype=np.int64) * NS_PER_SECOND
    track = AntennaTrack(time_ns=time_ns, antenna_m=place, antenna_velocity_m_s=velocity)
    true = true_ephemerides(begin, int(track.time_ns[-1]), seed)
    rover = simulate_signals(track, FRAME, true, ROVER, seed, "rover").epochs()
    base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, seed, "base").epochs()
    broadcast = broadcast_ephemerides(true, seed)
    solved = run_rtklib(tmp_path, rover, base, broadcast, FRAME, time_ns, track.antenna_m, BASE_M)
    assert len(solved.time_ns) == n
    assert np.mean(solved.fixed) >= 0.99
    assert np.quantile(solved.horizontal_m[solved.fixed], 0.95) <= 0.02
    assert np.max(solved.horizontal_m[solved.fixed]) < 0.1
    # All four systems take part: a system that RTKLIB cannot read would leave far fewer.
    assert np.min(solved.satellites) >= 20


def test_in_a_street_canyon_rtklib_fixes_some_epochs_and_some_of_them_wrongly():
    pooled = canyon_statistics(range(1, 5), 1)
    figures = pooled.figures()
    # Four runs scatter widely: the bounds are those of "neither open sky nor a tunnel".
    assert pooled.epochs == 480
    assert 0.1 < figures["fixed_share"] < 0.8
    assert 0.005 < figures["wrong_share_of_fixes"] < 0.4
