"""Compile the engine before the first epoch, by solving two synthetic epochs of rover and base.

The machine code is cached on disk; with a filled cache this takes a second. `python -m camber.gnss.warm_up` fills it
for an image.
"""

from __future__ import annotations

from contextlib import AbstractContextManager

import numpy as np

from camber.compiled.decorator import require_numba
from camber.compiled.parallel_compilation import compiled_in_parallel
from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    SPEED_OF_LIGHT_M_S,
    Ephemeris,
    Floats,
    ObservationEpoch,
    signal_number,
)
from camber.formats.receiver.mixed_stream import MixedDecoder
from camber.formats.rtcm.writer import format_observations
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.ambiguity.fixed_solution import chi2_limit
from camber.gnss.candidates.satellite_subsets import subset_candidates
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.observations.satellite_states import (
    enu_from_ecef_rotation,
    geodetic,
    ranges,
    states_at_transmission,
)
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from camber.gnss.position.small_algebra import form, inner

READER_FUNCTIONS, ENGINE_FUNCTIONS, SUBSET_FUNCTIONS, CARRIED_FUNCTIONS = 10, 15, 5, 2
"""Compiled functions that Python calls: of `compile_readers`, of the engine, in addition for subsets and for carried
ambiguities."""
FUNCTIONS = 26
"""Those of the service with all of it: the readers share some with the engine."""

_COMPILED_IN_PARALLEL = frozenset(
    {
        "gnss.ambiguity.fixed_solution.estimate",
        "gnss.position.epoch_solution.difference_epoch",
        "gnss.velocity.doppler_velocity._velocity",
    }
)
"""By a second process at the first run. Chosen: half of the time of the engine, 18 of 36 s of a processor."""

# A synthetic sky: 30 GPS satellites, two signals, all above 17°.
_TIME_NS = 1_400_000_000 * NS_PER_SECOND
_PLANES, _PER_PLANE = 6, 5
_SIGNALS = ("1C", "2L")
_LOWEST_SINE = 0.3  # 17°
_NO_PERTURBATION = (
    "inclination_rate_rad_s", "ascending_node_rate_rad_s", "perigee_rad", "mean_motion_difference_rad_s",
    "cuc", "cus", "crc_m", "crs_m", "cic", "cis",
)  # fmt: skip
_BASE_ECEF_M = np.array(ecef_from_geodetic_scalar(0.6, 2.4, 50.0))


def warm_up(*, subsets: bool = True, carried: bool = False) -> Solution:
    """Compile the engine, in two processes where that is needed; a synthetic solution.

    `subsets`: also what re-estimates it; `carried`: also what carries ambiguities.
    """
    with engine_compiled_in_parallel():
        return _solve_synthetic_epochs(subsets=subsets, carried=carried)


def engine_compiled_in_parallel() -> AbstractContextManager[None]:
    """Within, a second process compiles half of the engine where it is not on disk."""
    return compiled_in_parallel("camber.gnss.warm_up", _COMPILED_IN_PARALLEL)


def _solve_synthetic_epochs(*, subsets: bool, carried: bool) -> Solution:
    """Solve synthetic epochs through all stages; the solution of the last. `subsets`: re-estimate it, too."""
    settings = EngineSettings(ambiguities="carried" if carried else "single_epoch")
    rover = _BASE_ECEF_M + np.array([10.0, 20.0, 1.0]) @ enu_from_ecef_rotation(*geodetic(_BASE_ECEF_M)[:2])
    engine = Engine(settings, _BASE_ECEF_M)
    for ephemeris in _constellation():
        engine.add_ephemeris(ephemeris)
    solution = Solution(time_ns=_TIME_NS, quality="none", reason="")
    for second in range(2):
        time_ns = _TIME_NS + second * NS_PER_SECOND
        engine.add_base(_epoch(engine.ephemerides, _BASE_ECEF_M, time_ns))
        solution = engine.solve(_epoch(engine.ephemerides, rover, time_ns))
    if subsets:
        subset_candidates(solution, settings.fix_criteria(), "all", most_trials=4)
        # What `subset_agreement` calls where there are several systems.
        form(_BASE_ECEF_M, np.eye(3))
        inner(_BASE_ECEF_M, _BASE_ECEF_M)
        chi2_limit(3, settings.fix_criteria().residual_quantile)
    return solution


def compile_readers() -> None:
    """Compile the search for frames and the decoder of a base's observations, which any live stream needs."""
    require_numba()
    decoder = MixedDecoder("warm up", _TIME_NS)
    decoder.feed(b"\xb5\x62")
    ephemerides = EphemerisStore()
    for ephemeris in _constellation():
        ephemerides.add(ephemeris)
    for frame in format_observations(_epoch(ephemerides, _BASE_ECEF_M, _TIME_NS), station_id=1):
        decoder.feed(frame)


def _constellation() -> list[Ephemeris]:
    """The nominal GPS constellation: near-circular orbits in six planes."""
    turn = 2.0 * np.pi
    return [
        Ephemeris(
            satellite=ord("G") * 256 + 1 + plane * _PER_PLANE + place,
            toe_ns=_TIME_NS,
            toc_ns=_TIME_NS,
            transmission_ns=_TIME_NS,
            iode=1,
            clock=(1e-5, 0.0, 0.0),
            sqrt_a=5153.6,
            eccentricity=0.002,
            inclination_rad=0.96,
            ascending_node_rad=turn * plane / _PLANES,
            mean_anomaly_rad=turn * (place / _PER_PLANE + plane / (_PLANES * _PER_PLANE)),
            accuracy_m=1.0,
            health=0,
            other={"tgd_s": 0.0},
            **dict.fromkeys(_NO_PERTURBATION, 0.0),
        )
        for plane in range(_PLANES)
        for place in range(_PER_PLANE)
    ]


def _epoch(ephemerides: EphemerisStore, antenna_ecef_m: Floats, time_ns: int) -> ObservationEpoch:
    """Error-free observations in two bands of a receiver with a perfect clock."""
    satellites = np.array([e.satellite for e in _constellation()], np.int64)
    rows = ephemerides.rows_at(time_ns, satellites)
    code_m = np.full(satellites.size, 2.2e7)
    for _ in range(3):
        states = states_at_transmission(ephemerides.table, rows, time_ns, code_m)
        distance_m, direction = ranges(states.position_m, antenna_ecef_m)
        code_m = distance_m - SPEED_OF_LIGHT_M_S * states.clock_s
    latitude, longitude, _ = geodetic(antenna_ecef_m)
    up = np.flatnonzero(direction @ enu_from_ecef_rotation(latitude, longitude)[2] > _LOWEST_SINE)
    rate_m_s = (states.velocity_m_s * direction).sum(axis=1)
    carriers = [CARRIER_OF_BAND_HZ["G"][signal[0]] for signal in _SIGNALS]
    count = up.size * len(_SIGNALS)
    return ObservationEpoch(
        time_ns=time_ns,
        satellite=np.tile(satellites[up], len(_SIGNALS)),
        signal=np.repeat([signal_number(signal) for signal in _SIGNALS], up.size),
        pseudorange_m=np.tile(code_m[up], len(_SIGNALS)),
        carrier_phase_cycles=np.concatenate([code_m[up] * hz / SPEED_OF_LIGHT_M_S for hz in carriers]),
        doppler_hz=np.concatenate([-rate_m_s[up] * hz / SPEED_OF_LIGHT_M_S for hz in carriers]),
        cn0_dbhz=np.full(count, 45.0),
        lock_time_s=np.full(count, 10.0),
        loss_of_lock=np.zeros(count, np.bool_),
        half_cycle=np.zeros(count, np.bool_),
    )


if __name__ == "__main__":
    warm_up(carried=True)
    compile_readers()
