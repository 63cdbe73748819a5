"""Parameters of the localizer's filter: sensors, links, anchors and scan matches."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from camber.localizer.filter.odometry import MotionModel


@dataclass(frozen=True, slots=True, kw_only=True)
class AccelerationModel:
    """Error of an inertial unit's forward acceleration: noise, and a Gauss-Markov process of bias and levelling."""

    noise_m_s_sqrt_s: float = 1e-3
    error_sigma_m_s2: float = 0.3
    error_time_s: float = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseModel:
    """Antenna: x forward, y left of the vehicle's reference point. Gates are chi-square.

    Numbers without a comment are chosen; the consistency tests (NEES) of `tests/unit/localizer/filter` and the
    drives of `support.localization_statistics` and `support.tunnel_statistics` check what follows from them.
    """

    motion: MotionModel = field(default_factory=MotionModel)
    acceleration: AccelerationModel = field(default_factory=AccelerationModel)
    antenna_x_m: float = 0.0
    antenna_y_m: float = 0.0
    anchor_sigma_floor_m: float = 0.05
    anchor_common_sigma_m: float = 0.04
    anchor_common_time_s: float = 30.0
    anchor_gate: float = 18.42  # chi-square, 2 degrees of freedom, 99.99 %
    anchored_for_s: float = 1.0
    anchor_max_age_s: float = 5.0
    recover_after_anchors: int = 5
    recover_after_s: float = 0.8
    match_gate: float = 21.11  # chi-square, 3 degrees of freedom, 99.99 %
    slip_gate: float = 11.34  # the same, 99 %: beyond it wheel slip is tested
    match_sure_m: float = 1.5  # a less precise pose needs a unique match
    match_sure_rad: float = math.radians(5.0)
    match_max_age_s: float = 1.0
    match_fresh_s: float = 0.5
    match_sigma_floor_m: float = 0.01
    match_sigma_floor_rad: float = math.radians(0.03)
    match_common_sigma_m: float = 0.02
    match_common_sigma_rad: float = math.radians(0.03)
    match_common_length_m: float = 15.0
    match_renewed_m: float = 5.0  # this far apart two matches see different things
    match_renewed_s: float = 20.0
    recover_after_matches: int = 5
    recover_after_m: float = 10.0
    unmodelled_drift: float = 0.005  # undetected error of dead reckoning, relative to the distance
    unmodelled_turn_rad: float = math.radians(1.0)
    support_after_matches: int = 5
    support_after_m: float = 5.0
    support_after_s: float = 5.0
    support_sigma_m: float = 0.1
    support_sigma_rad: float = math.radians(0.5)
    holds_for_s: float = 2.0  # how long an accepted source holds the pose against another one
    slip_sigma_m_s: float = 1.5
    slip_memory_s: float = 1.0
    slip_window_s: float = 0.5
    wheel_hop_s: float = (
        0.09  # period of a wheel on its tyre: on a bump its speed swings by 1 m/s about the vehicle's
    )
    slip_above_m_s: float = 2.0
    max_acceleration_m_s2: float = 4.5
    max_braking_m_s2: float = 9.0
    max_calm_change_m_s2: float = 3.5  # slipping wheels that change faster continue or cease to slip
    slip_recovered_m_s: float = 1.0
    slip_state_sigma_m_s: float = 3.0
    slip_state_time_s: float = 20.0
    slip_ends_after_s: float = 1.0
    slip_unobserved_s: float = 15.0
    locked_time_s: float = 1.0  # a vehicle on locked wheels loses two thirds of its speed in it
    locked_for_s: float = 3.0
    max_yaw_sigma_rad: float = 0.5
    restart_sigma_m: float = 20.0
    lost_sigma_m: float = 500.0
    couple_links: bool = True
    couple_every_m: float = 5.0
    couple_rotation_every_s: float = 1.0
    road_noise_m: float = 0.1
    lane_sigma_m: float = 4.0
    lane_wander_m_sqrt_m: float = 0.1
    lane_turn_sigma_m: float = 2.0
    deviation_length_m: float = 40.0  # a link runs straight between vertices some 50 m apart
    link_shift_share: float = 0.5  # of a link's sigma: a quarter of its variance is the neighbourhood's
    link_shift_length_m: float = 2000.0
    memory_cell_m: float = 25.0
    memory_cells: int = 100
    new_road_rad: float = math.radians(20.0)
    parallel_sigma_rad: float = math.radians(5.0)
    parallel_max_rad: float = math.radians(25.0)
    bend_clearance_m: float = 12.0
    bend_max_sigma_m: float = 30.0
    coupling_gate: float = 9.0
    lane_change_after_rejections: int = 3
