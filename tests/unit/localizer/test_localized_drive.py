"""Some seconds of a simulated city through the localizer and through the matcher alone: right, and honest about it.

The statistics over many drives are a command: support.localization_statistics.
"""

import numpy as np
import pytest

from support.localization_drives import kept_drive, localized, matched_alone

SEED = 404
SETTLED_S = 3.0


@pytest.fixture(scope="module")
def drive():
    print("seed", SEED)
    return kept_drive("city", SEED, start_s=60.0, duration_s=9.0)


@pytest.fixture(scope="module")
def with_lidar(drive):
    return localized(drive)


def converged(matches):
    return matches.where(np.array([status == "converged" for status in matches.word]))


def test_the_pose_is_within_centimetres_and_its_ellipse_holds(with_lidar):
    poses = with_lidar.poses.since(SETTLED_S)
    assert len(poses.off) >= 60
    assert set(poses.word) == {"scan_match"}
    assert np.median(poses.horizontal_m) <= 0.03
    # The first braking of a drive shows how old the wheels' speed is; until then it is off by that.
    assert np.quantile(poses.horizontal_m, 0.95) <= 0.15
    assert np.degrees(np.quantile(np.abs(poses.off[:, 2]), 0.95)) <= 0.3
    assert np.mean(poses.squared <= 9.21) >= 0.97
    assert np.abs(poses.off[:, 2] / np.sqrt(poses.covariance[:, 2, 2])).max() < 5.0


def test_no_converged_match_is_wrong(with_lidar):
    matches = converged(with_lidar.matches)
    assert len(matches.off) >= 60
    assert matches.horizontal_m.max() < 0.3
    assert np.mean(matches.squared <= 9.21) >= 0.95


def test_the_road_is_never_another_one(with_lidar):
    assert not with_lidar.wrong_level.any()


def test_matches_from_half_a_metre_off_claim_what_they_are_worth(drive):
    matches = converged(matched_alone(drive, every=5))
    assert len(matches.off) >= 10
    assert np.quantile(matches.horizontal_m, 0.5) < 0.05
    assert matches.horizontal_m.max() < 0.3
    assert np.mean(matches.squared <= 9.21) >= 0.9


def test_without_the_lidar_the_same_drive_is_a_metre_off_and_says_so(drive):
    poses = localized(drive, lidar=False).poses
    assert set(poses.word) == {"dead_reckoning"}
    assert poses.covariance[-1, 0, 0] > 0.5**2
    assert np.all(poses.squared <= 13.8)
