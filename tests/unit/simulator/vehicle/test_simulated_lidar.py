from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from camber.simulator.injected_faults import BlockedLidar, SymmetricScene
from camber.simulator.scene import Floats, Material, Shapes, Trajectory
from camber.simulator.vehicle.beam_pattern import BEAMS_32, BEAMS_64, PATTERNS, BeamPattern
from camber.simulator.vehicle.body import CAR
from camber.simulator.vehicle.lidar import Scan, SimulatedLidar
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.traffic import RoadUser, Traffic
from camber.simulator.world.ray_tracing import ShapeTracer
from support.simulated_paths import flat, path_over

START_NS = 1_400_000_000 * 1_000_000_000
ROAD_M = 40.0
EXACT = dataclasses.replace(BEAMS_32, range_sigma_m=0.0, range_step_m=1e-7)
FEWER = dataclasses.replace(EXACT, columns=360)

GROUND = np.array(
    [
        [[-300.0, -300.0, ROAD_M], [300.0, -300.0, ROAD_M], [300.0, 300.0, ROAD_M]],
        [[-300.0, -300.0, ROAD_M], [300.0, 300.0, ROAD_M], [-300.0, 300.0, ROAD_M]],
    ]
)
WALL_EAST_M = 60.0
WALL = (WALL_EAST_M + 2.0, 0.0, ROAD_M, 2.0, 100.0, 20.0, 0.0)
POLES = [(12.0, 6.0, ROAD_M, 0.15, 8.0), (30.0, -5.0, ROAD_M, 0.2, 8.0)]


def place() -> ShapeTracer:
    return ShapeTracer(Shapes.of(boxes=[WALL], cylinders=POLES, triangles=GROUND))


def standing(east_m: float = 0.0, yaw_rad: float = 0.0) -> PoseTrack:
    """A sensor 2 m above the road for half a second."""
    time_ns = START_NS + 10_000_000 * np.arange(51, dtype=np.int64)
    position = np.tile([east_m, 0.0, ROAD_M + 2.0], (51, 1))
    angles = np.tile([0.0, 0.0, yaw_rad], (51, 1))
    return PoseTrack(time_ns=time_ns, position_m=position, angles_rad=angles)


def turning() -> tuple[Trajectory, PoseTrack]:
    """At 8 m/s through a curve of 35 m, the wall ahead at first."""
    curvature = np.where(np.arange(220) < 80, 0.0, 1.0 / 35.0)
    path = path_over(flat, np.convolve(np.pad(curvature, 20, "edge"), np.ones(41) / 41, "valid"))
    trajectory = drive(path, CAR, start_ns=START_NS)
    return trajectory, PoseTrack.of(trajectory, CAR, CAR.lidar)


def scans(track: PoseTrack, pattern: BeamPattern = EXACT, **more: Any) -> list[Scan]:
    lidar = SimulatedLidar(**{"pattern": pattern, "track": track, "tracer": place(), "seed": 1} | more)
    return list(lidar.scans())


def in_world(track: PoseTrack, scan: Scan, *, at_once: bool = False) -> Floats:
    """The points by the true poses at their times, or all by the pose at the sweep's end."""
    offset_ns = scan.sweep.offset_ns.astype(np.int64) * (not at_once)
    position, rotation = track.at(scan.sweep.time_ns + offset_ns)
    return position + np.einsum("nij,nj->ni", rotation, scan.sweep.points_m.astype(np.float64))


def points(scan: Scan, material: Material) -> Floats:
    return scan.sweep.points_m[scan.material == material].astype(np.float64)


def off_the_surfaces(world: Floats, material: np.ndarray) -> Floats:
    """How far points are from the surface that they are of, in closed form."""
    off = np.abs(world[:, 2] - ROAD_M)
    off = np.where(material == Material.BUILDING, np.abs(world[:, 0] - WALL_EAST_M), off)
    pole = np.min([np.abs(np.hypot(world[:, 0] - p[0], world[:, 1] - p[1]) - p[3]) for p in POLES], axis=0)
    return np.where(material == Material.POLE, pole, off)


def test_each_point_is_where_its_beam_looked_and_on_a_surface() -> None:
    scan = scans(standing())[0]
    assert min(np.bincount(scan.material)[[Material.ROAD, Material.BUILDING, Material.POLE]]) > 100
    assert off_the_surfaces(in_world(standing(), scan), scan.material).max() < 1e-4
    sweep = scan.sweep
    beam_of = {int(t): k for k, t in enumerate(EXACT.offsets_ns())}
    rays = EXACT.directions()[[beam_of[int(t)] for t in sweep.offset_ns]]
    points_m = sweep.points_m.astype(np.float64)
    np.testing.assert_allclose(points_m / np.linalg.norm(points_m, axis=1)[:, None], rays, atol=1e-6)
    assert (np.diff(sweep.offset_ns) > 0).all()


def test_motion_during_the_sweep_is_seen_and_undone_by_the_true_motion() -> None:
    trajectory, track = turning()
    worst_m, seen_m = 0.0, 0.0
    for scan in scans(track, FEWER):
        off_m = off_the_surfaces(in_world(track, scan), scan.material)
        at_once_m = off_the_surfaces(in_world(track, scan, at_once=True), scan.material)
        worst_m = max(worst_m, float(off_m.max()))
        seen_m = max(seen_m, float(np.percentile(at_once_m, 99.0)))
    assert trajectory.speed_m_s.max() > 7.0
    assert worst_m < 0.01
    assert seen_m > 0.3


def test_moving_traffic_hides_what_is_beyond_it_and_moves_during_the_sweep() -> None:
    path = path_over(flat, np.zeros(400))
    ahead = RoadUser(path=path, start_m=20.0, speed_m_s=12.0)
    traffic = Traffic.of([ahead], START_NS, START_NS + 1_000_000_000)
    with_it, without = scans(standing(), traffic=traffic), scans(standing())
    for turn, scan in enumerate(with_it):
        box = points(scan, Material.VEHICLE)
        offset = scan.sweep.offset_ns[scan.material == Material.VEHICLE]
        assert len(box) > 40
        back_m = 20.0 - 2.2 + 12.0 * (0.1 * (turn + 1) + offset / 1e9)
        on_back = np.abs(box[:, 2] - (1.5 - 2.0)) > 1e-3  # not on its roof
        np.testing.assert_allclose(box[on_back, 0], back_m[on_back], atol=1e-3)
        assert np.abs(box[:, 1]).max() <= 0.9 + 1e-3
        # What both see in the same direction has only come nearer.
        both = np.intersect1d(scan.sweep.offset_ns, without[turn].sweep.offset_ns, return_indices=True)[1:]
        now, before = (
            np.linalg.norm(s.sweep.points_m[k], axis=1)
            for s, k in zip((scan, without[turn]), both, strict=True)
        )
        assert (now <= before + 1e-5).all()


def test_traffic_stops_at_the_end_of_its_path() -> None:
    path = path_over(flat, np.zeros(40))
    user = RoadUser(path=path, start_m=5.0, speed_m_s=10.0, left_m=1.5)
    traffic = Traffic.of([user], START_NS, START_NS + 5_000_000_000)
    first, last = traffic.between(START_NS + 250_000_000, START_NS + 4_000_000_000)
    np.testing.assert_allclose(first[0], [7.5, 1.5, ROAD_M, 0.0], atol=1e-6)
    np.testing.assert_allclose(last[0], [9.75, 1.5, ROAD_M, 0.0], atol=1e-6)


def test_ranges_scatter_as_in_the_pattern_and_are_quantised() -> None:
    pattern = dataclasses.replace(BEAMS_64, range_sigma_m=0.03, range_step_m=0.01)
    scan = scans(standing(), pattern)[0]
    road = points(scan, Material.ROAD)
    away = np.linalg.norm(road, axis=1)
    rays = road / away[:, None]
    error = away - 2.0 / -rays[:, 2]
    assert len(error) > 10_000
    assert error.std() == pytest.approx(0.03, rel=0.05)
    assert abs(error.mean()) < 0.002
    np.testing.assert_allclose(away / 0.01, np.round(away / 0.01), atol=2e-3)


def test_returns_are_lost_with_range_and_by_incidence() -> None:
    rays = EXACT.directions()
    truth = -2.0 / np.where(rays[:, 2] < 0.0, rays[:, 2], -1e-9)
    shares = []
    road = np.concatenate([points(s, Material.ROAD) for s in scans(standing(-200.0))])
    measured = np.linalg.norm(road, axis=1)
    for near, far in ((4.0, 15.0), (15.0, 25.0), (25.0, 35.0), (35.0, 50.0), (80.0, 95.0)):
        sent = ((truth >= near) & (truth < far)).sum() * 5
        shares.append(float(((measured >= near) & (measured < far)).sum() / sent))
    assert shares[0] > 0.95
    assert all(a > b for a, b in itertools.pairwise(shares))
    # A wall as far away faces the beams, and is seen.
    wall = [points(s, Material.BUILDING) for s in scans(standing())]
    assert min(map(len, wall)) > 2_000


def test_intensity_separates_materials_and_fits_a_byte() -> None:
    sweep, kind = (scan := scans(standing())[0]).sweep, scan.material
    assert sweep.intensity.min() >= 0.0
    assert sweep.intensity.max() <= 255.0
    wall, road = (sweep.intensity[kind == m].mean() for m in (Material.BUILDING, Material.ROAD))
    assert wall > 3 * road


def test_crowns_of_trees_are_let_into() -> None:
    tracer = ShapeTracer(Shapes.of(crowns=[(10.0, 0.0, ROAD_M + 2.0, 2.0, 2.0)]))
    scan = scans(standing(), tracer=tracer)[0]
    depth = 2.0 - np.linalg.norm(scan.sweep.points_m - [10.0, 0.0, 0.0], axis=1)
    assert depth.min() > -1e-3
    assert 0.05 < np.median(depth) < 0.4


def test_the_same_seed_gives_the_same_bytes_in_any_number_of_threads() -> None:
    track = standing()

    def content(seed: int, threads: int) -> list[bytes]:
        lidar = SimulatedLidar(pattern=BEAMS_32, track=track, tracer=place(), seed=seed)
        made = lidar.scans(threads)
        return [s.sweep.points_m.tobytes() + s.sweep.intensity.tobytes() for s in made]

    one = content(7, 1)
    assert one == content(7, 2) == content(7, 3)
    assert len(one) == 5
    assert all(a != b for a, b in zip(one, content(8, 2), strict=True))
    assert one[0] != one[1]


def test_faults_blind_the_sensor_from_their_onset_to_their_end() -> None:
    blocked = BlockedLidar(kind="blocked_lidar", onset_s=0.2, end_s=0.4, share=0.5)
    alone = SymmetricScene(kind="symmetric_scene", onset_s=0.4)
    made = scans(standing(), faults=(blocked, alone))
    ahead = [float((s.sweep.points_m[:, 0] > 0.01).mean()) for s in made]
    assert min(ahead[:2]) > 0.4
    assert max(ahead[2:4]) == 0.0
    assert set(made[4].material.tolist()) == {int(Material.ROAD)}
    assert ahead[4] > 0.4


@pytest.mark.parametrize("pattern", PATTERNS.values(), ids=lambda p: p.name)
def test_patterns_are_full_turns_of_unit_rays(pattern: BeamPattern) -> None:
    rays, offsets = pattern.directions(), pattern.offsets_ns()
    assert rays.shape == (pattern.rays, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    assert offsets[0] == -pattern.turn_ns
    assert -pattern.turn_ns / pattern.columns < offsets[-1] < 0
    assert (np.diff(offsets) > 0).all()
    assert len(set(pattern.elevation_deg)) == len(pattern.elevation_deg) in (32, 64)
    assert min(pattern.elevation_deg) < -24.0
    first = rays[:: len(pattern.elevation_deg)]
    azimuth = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    assert azimuth[-1] - azimuth[0] == pytest.approx(-2.0 * np.pi, abs=0.01)
