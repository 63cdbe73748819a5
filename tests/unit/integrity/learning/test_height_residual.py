"""Residuals for the learning: height and horizontal difference of a fix, their σ, and their reference."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.checks.fix_comparison import FixComparison
from camber.integrity.checks.height_model import RoadPoint
from camber.integrity.judgement import FixJudgement
from camber.integrity.learning.height_residual import base_of, independent_residual_of, key_of, residual_of
from camber.integrity.learning.residuals import ReferenceKey
from camber.schemas.pose import FixesOffset, IndependentPosition
from support.judging import ANTENNA_M, ROAD_M, antenna, at, fix, place, pose, road

COMPARISON = FixComparison(
    difference_m=np.array([0.3, -0.1, 0.15]),
    covariance_m2=np.diag([0.04, 0.09, 0.0025]),
    outcome=0,
    position=0,
    height_m=-0.15,
    height_sigma_m=0.05,
    tolerance_m=0.2,
    acceptance_radius_m=0.5,
    joint_distance2=4.5,
    joint_limit=16.3,
)
SEEN = pose(mode="scan_match", provenance="scan_match", link_id=5, anchor_time_ns=at(-9))


def residual(result=COMPARISON, speed_m_s=10.0, **changes):
    fields = {
        "fix": fix(3, up_m=0.25, base_station="rtcm-7"),
        "pose": SEEN,
        "antenna": antenna(),
        "road": RoadPoint(elevation_m=ROAD_M, sigma_m=0.03, surface_id=8),
    }
    return residual_of(
        FixJudgement(verdict="confirmed", reason="none", **fields | changes), result, speed_m_s
    )


def test_it_has_what_the_heights_along_the_track_of_the_fixes_say():
    offset = FixesOffset(
        begin_time_ns=at(-90),
        end_time_ns=at(2),
        east_north_m=(1.7, -0.2),
        covariance_east_north=(0.04, 0.01, 0.09),
        growth_east_north_m_s=(0.001, 0.002),
        growth_covariance_east_north=(1e-6, 0.0, 2e-6),
    )
    of = residual(pose=SEEN.model_copy(update={"fixes_offset": offset})).track_offset
    assert of is not None
    assert (of.begin_ns, of.end_ns, of.east_north_m) == (at(-90), at(2), (1.7, -0.2))
    assert (of.covariance_m2, of.growth_m_s) == ((0.04, 0.01, 0.09), (0.001, 0.002))
    assert of.growth_covariance == (1e-6, 0.0, 2e-6)
    assert of.is_estimate
    moved = offset.model_copy(update={"steps": 1})
    assert not residual(pose=SEEN.model_copy(update={"fixes_offset": moved})).track_offset.is_estimate
    assert residual().track_offset is None


def test_it_has_since_when_the_fixes_have_not_stepped():
    assert residual(pose=SEEN.model_copy(update={"fix_run_begin_time_ns": at(-90)})).run_begin_ns == at(-90)
    assert residual(pose=SEEN).run_begin_ns is None
    assert residual(pose=None).run_begin_ns is None


def test_it_has_the_heading_of_the_pose():
    assert residual(pose=SEEN.model_copy(update={"yaw_rad": 0.7})).heading_rad == 0.7
    assert residual(pose=None).heading_rad is None


def test_it_has_the_height_difference_without_any_correction():
    of = residual(correction_m=0.2)
    assert of.up_m == pytest.approx(0.25)
    assert of.fix_sigma_m == pytest.approx(math.sqrt(0.05**2 - 0.03**2))
    assert (of.map_sigma_m, of.surface_id) == (0.03, 8)


def test_a_map_that_is_less_sure_than_the_difference_leaves_nothing_to_the_fix():
    assert residual(replace(COMPARISON, height_sigma_m=0.02)).fix_sigma_m == 0.0


def test_it_has_fix_place_speed_and_road():
    of = residual()
    assert (of.time_ns, of.verdict, of.speed_m_s, of.link_id) == (at(3), "confirmed", 10.0, 5)
    assert (of.latitude_rad, of.longitude_rad) == (fix(3).latitude_rad, fix(3).longitude_rad)
    assert of.key == ReferenceKey(antenna="fixed", base="receiver:WGS84:rtcm-7", map_version=3)
    assert residual(pose=None).link_id is None


@pytest.mark.parametrize("changes", [{"road": None}, {"antenna": None}, {"antenna": antenna(height_m=None)}])
def test_without_road_or_antenna_it_has_the_place_only(changes):
    of = residual(**changes)
    assert (of.up_m, of.surface_id) == (None, None)
    assert (of.east_m, of.north_m) == (0.3, -0.1)


@pytest.mark.parametrize(
    ("mode", "provenance", "anchored_ns"),
    [
        ("scan_match", "scan_match", None),
        ("anchored", "given", at(-9)),
        ("dead_reckoning", "confirmed", at(-9)),
        ("scan_match", "confirmed", None),
    ],
)
def test_a_pose_that_owes_nothing_to_this_fix_says_how_far_off_it_is(mode, provenance, anchored_ns):
    of = residual(pose=pose(mode=mode, provenance=provenance, anchor_time_ns=at(-9)))
    assert (of.east_m, of.north_m, of.horizontal_sigma_m) == (0.3, -0.1, pytest.approx(0.3))
    assert of.anchored_ns == anchored_ns


@pytest.mark.parametrize("the_pose", [None, pose(provenance="fixes", anchor_time_ns=at(-9))])
def test_any_other_does_not(the_pose):
    of = residual(pose=the_pose)
    assert (of.east_m, of.north_m, of.horizontal_sigma_m, of.anchored_ns) == (None, None, None, None)
    assert of.up_m is not None


def independent(basis, east_m=0.0, north_m=0.0):
    """Metres from the pose, and less sure than it."""
    latitude_rad, longitude_rad = place(3, east_m, north_m)
    return IndependentPosition(
        basis=basis,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        covariance_east_north=(0.09, 0.01, 0.04),
        evidence_time_ns=at(2),
        distance_m=2.0,
    )


def led_away(basis, **changes):
    """A pose that fixes have led 5 m east and 1 m south of the independent position."""
    changes = {"mode": "anchored", "provenance": "confirmed", "anchor_time_ns": at(2)} | changes
    latitude_rad, longitude_rad = place(3)
    return pose(
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        independent=independent(basis, -5.0, 1.0),
        **changes,
    )


@pytest.mark.parametrize("basis", ["scan_match", "relief", "given"])
def test_the_independent_position_is_compared_wherever_fixes_have_led_the_pose(basis):
    of = residual(pose=led_away(basis), fix=fix(3, covariance_enu_m2=(4e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)))
    assert of.independent == pytest.approx((5.3, -1.1, 0.09, 0.01, 0.04, 0.02), abs=1e-4)
    assert of.evidence_ns == at(2)


def test_of_independent_positions_a_scan_match_counts_by_stretch_too():
    of = residual(pose=led_away("scan_match"))
    assert (of.east_m, of.north_m) == pytest.approx((5.3, -1.1), abs=1e-4)
    assert of.horizontal_sigma_m == pytest.approx(0.304, abs=1e-3)
    assert of.anchored_ns is None
    for basis in ("relief", "given"):
        of = residual(pose=led_away(basis))
        assert (of.east_m, of.north_m, of.horizontal_sigma_m) == (None, None, None)


def test_without_a_covariance_of_the_fix_or_a_place_of_the_pose_nothing_is_usable():
    assert residual(pose=led_away("relief"), fix=fix(3, covariance_enu_m2=None)).known_independent is None
    nowhere = led_away("relief", mode="none").model_copy(update={"latitude_rad": None})
    assert residual(pose=nowhere).independent is None


def test_its_reference_is_known_as_far_as_the_messages_name_it():
    assert base_of(fix()) == "receiver:WGS84:"
    assert base_of(fix(origin="engine", datum="ITRF2020", base_station="b")) == "engine:ITRF2020:b"
    assert key_of("b", None, None) == ReferenceKey(antenna="", base="b", map_version=0)
    assert key_of("b", pose(road=road(map_version=None)), antenna(way=None)) == ReferenceKey(
        antenna="", base="b", map_version=0
    )
    assert key_of("b", pose(road=road(map_version=4)), antenna(way="ranging")) == ReferenceKey(
        antenna="ranging", base="b", map_version=4
    )


def test_the_height_is_that_of_the_antenna_the_fix_and_the_road_there():
    of = residual(
        road=RoadPoint(elevation_m=ROAD_M - 1.0, sigma_m=0.03), antenna=antenna(height_m=ANTENNA_M + 0.5)
    )
    assert of.up_m == pytest.approx(0.75)


def without_comparison(the_pose, epoch=3):
    judgement = FixJudgement(fix=fix(epoch, north_m=0.4), verdict="unknown", reason="pose_too_uncertain")
    return independent_residual_of(judgement, the_pose, antenna(), 10.0)


def test_a_fix_that_was_not_compared_differs_from_the_independent_position_alone():
    of = without_comparison(pose(3, sigma_m=9.0, independent=independent("relief")))
    assert of is not None
    assert of.known_independent is not None
    assert of.known_independent[:2] == pytest.approx((0.0, 0.4), abs=1e-3)
    assert (of.up_m, of.known_horizontal_m, of.verdict) == (None, None, "unknown")
    assert of.key.antenna == "fixed"


def test_a_fix_that_was_not_compared_has_the_link_and_the_map_of_the_pose_and_the_speed():
    there = pose(3, link_id=5, speed_m_s=None, yaw_rad=None, independent=independent("relief"))
    of = without_comparison(there)
    assert of is not None, "the pose is of its time: it need not be moved on"
    assert (of.link_id, of.speed_m_s, of.key.map_version) == (5, 10.0, 3)


def test_without_an_independent_position_at_its_time_a_fix_that_was_not_compared_shows_nothing():
    assert without_comparison(pose(3)) is None
    standing = {"speed_m_s": None, "yaw_rad": None, "independent": independent("relief")}
    assert without_comparison(pose(2, **standing)) is None


def test_its_horizontal_sigma_is_that_of_the_fix_and_of_the_independent_position():
    there = SEEN.model_copy(
        update={
            "independent": independent("scan_match").model_copy(
                update={"covariance_east_north": (0.25, 0.0, 0.09)}
            )
        }
    )
    of = residual(pose=there, fix=fix(3, covariance_enu_m2=(4.0, 0.0, 0.0, 4.0, 0.0, 4.0)))
    assert of.independent[5] > 1.5
    assert of.horizontal_sigma_m == pytest.approx(math.hypot(0.5, of.independent[5]))
