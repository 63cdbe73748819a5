"""What goes to the fleet: road heights free of the map, whatever the verdict, in batches named by their contents."""

import numpy as np
import pytest

from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst
from camber.integrity.checks.height_model import RoadPoint
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.uploads import MOST_ROWS, UploadBatcher, batch_of, decimal_year, upload_for
from camber.map_update.contribution import QUALITIES, VERDICTS
from camber.schemas.antenna import HeightByMethod
from support.judging import ROAD_M, antenna, at, fix, pose, road

SIGMA = TrueSigma(scale=4.0, horizontal_m=0.05, vertical_m=0.05)
POINT = RoadPoint(elevation_m=ROAD_M, sigma_m=0.03, surface_id=7)
EVERY_S = 5.0  # 25 epochs, and START_NS is on the grid


def judgement(epoch=0, verdict="confirmed", **changes):
    fields = {"pose": pose(epoch), "antenna": antenna(epoch), "road": POINT, "fix": fix(epoch)} | changes
    return FixJudgement(verdict=verdict, reason="none", **fields)


def upload(epoch=0, **changes):
    result = upload_for(judgement(epoch, **changes), "car", SIGMA)
    assert result is not None
    return result


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_uploaded_with_its_value(verdict):
    assert upload(verdict=verdict).verdict == verdict


def test_the_height_is_the_fix_less_the_antenna_and_owes_nothing_to_the_map():
    result = upload(fix=fix(up_m=0.5), road=RoadPoint(elevation_m=99.0, sigma_m=0.03, surface_id=8))
    assert result.road_height_m == pytest.approx(ROAD_M + 0.5)
    assert result.road_height_sigma_m == pytest.approx((16 * 1e-4 + 0.05**2 + 0.02**2) ** 0.5)
    assert result.position_covariance_enu_m2[0] == pytest.approx(16 * 2.5e-5 + 0.05**2)
    assert result.surface_id == 8
    assert result.map_version == 3
    assert result.epoch_year == pytest.approx(2023.5, abs=0.1)


@pytest.mark.parametrize(
    ("gpst", "year"),
    [
        ((2024, 1, 1), 2024.0),
        ((2024, 1, 31), 2024 + 30 / 366),
        ((2023, 7, 2), 2023 + 182 / 365),
        ((2023, 12, 31), 2023 + 364 / 365),
    ],
    ids=str,
)
def test_the_epoch_is_the_decimal_year_to_two_days(gpst, year):
    result = decimal_year(gps_ns_from_gpst(CalendarTime(*gpst, 0, 0, 0, 0)))
    assert result == pytest.approx(year, abs=2 / 365, rel=0.0)
    assert result == year or gpst[1:] != (1, 1)


def test_an_antenna_may_be_as_low_as_it_likes():
    assert upload(antenna=antenna(height_m=0.0)).antenna_height_m == 0.0
    assert upload(antenna=antenna(height_m=0.4)).road_height_m == pytest.approx(ROAD_M + 1.4)


def test_the_height_is_free_of_what_was_learnt_against_the_map():
    assert upload(correction_m=0.1).road_height_m == upload().road_height_m


def test_the_antenna_height_of_scan_matching_depends_on_the_map_so_the_surest_other_method_is_sent():
    methods = (("ranging", 1.83, 0.03), ("scan_matching", 1.7, 0.01), ("stroke", 1.81, 0.015))
    others = tuple(
        HeightByMethod(way=method, height_m=height, sigma_m=sigma) for method, height, sigma in methods
    )
    result = upload(antenna=antenna(way="scan_matching", height_m=1.7, others=others))
    assert result.antenna_height_m == 1.81
    assert result.road_height_m == pytest.approx(ROAD_M + 1.8 - 1.81)
    assert result.road_height_sigma_m == pytest.approx((16 * 1e-4 + 0.05**2 + 0.015**2) ** 0.5)


def test_the_same_fix_has_the_same_id_and_another_has_not():
    assert upload().upload_id == upload(verdict="erroneous").upload_id
    assert len({upload(k).upload_id for k in range(50)}) == 50


def test_a_later_release_gives_a_fix_the_same_id():
    assert upload().upload_id == "1373090000000000000-136f6cc5e3351f5d"


@pytest.mark.parametrize(
    "changes",
    [
        {"pose": None},
        {"road": None},
        {"antenna": None},
        {"road": RoadPoint(elevation_m=ROAD_M, sigma_m=0.03)},
        {"pose": pose(road=road(map_version=None))},
        {"fix": fix(quality="float")},
        {"fix": fix(covariance_enu_m2=None)},
        {"fix": fix(covariance_enu_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 101.0))},
        {"antenna": antenna(sigma_m=None)},
        {"antenna": antenna(height_m=None)},
        {"antenna": antenna(height_m=-0.5)},
        {"antenna": antenna(way="scan_matching")},
    ],
    ids=str,
)
def test_what_no_fusion_can_use_stays_here(changes):
    assert upload_for(judgement(**changes), "car", SIGMA) is None


def test_a_batch_has_a_row_for_each_in_order():
    uploads = [upload(k, verdict=verdict) for k, verdict in enumerate(VERDICTS)]
    batch = batch_of(uploads)
    assert batch.time_ns == uploads[-1].time_ns
    assert (batch.vehicle, batch.datum, batch.map_version) == ("car", "WGS84", 3)
    assert batch.positioning_time_ns.tolist() == [at(k) for k in range(4)]
    assert [VERDICTS[v] for v in batch.verdict] == list(VERDICTS)
    for name in ("latitude_rad", "longitude_rad", "road_height_m", "road_height_sigma_m", "antenna_height_m"):
        assert getattr(batch, name).tolist() == [getattr(u, name) for u in uploads]
    assert batch.surface_id.tolist() == [7] * 4
    assert batch.fix_id.tolist() == [u.fix_id for u in uploads]
    assert [QUALITIES[q] for q in batch.fix_quality] == ["fixed"] * 4
    assert batch.epoch_year == uploads[0].epoch_year


def test_the_horizontal_sigma_of_a_row_is_that_of_the_worst_direction():
    slanted = fix(covariance_enu_m2=(1e-4, 5e-5, 0.0, 1e-4, 0.0, 1e-4))
    (sigma_m,) = batch_of([upload(fix=slanted)]).horizontal_sigma_m
    assert sigma_m == pytest.approx((16 * 1.5e-4 + 0.05**2) ** 0.5)


def test_the_id_of_a_batch_is_made_of_its_contents():
    ids = [
        batch_of([upload(0), upload(1)]).batch_id,
        batch_of([upload(0), upload(1)]).batch_id,
        batch_of([upload(1)]).batch_id,
        batch_of([upload(0), upload(1, verdict="erroneous")]).batch_id,
    ]
    assert ids[0] == ids[1]
    assert len(set(ids)) == 3


@pytest.mark.parametrize(
    "uploads",
    [
        [],
        [upload(), upload(1, pose=pose(1, road=road(map_version=4)))],
        [upload(), upload(1, fix=fix(1, datum="ITRF2020"))],
    ],
    ids=["none", "map versions", "datums"],
)
def test_what_does_not_go_together_is_refused(uploads):
    with pytest.raises(ValueError, match="expected one"):
        batch_of(uploads)


def collected(uploads):
    collector = UploadBatcher(EVERY_S)
    batches = [*(collector.add(one) for one in uploads), collector.take()]
    return [len(batch.surface_id) for batch in batches if batch is not None]


def test_a_stretch_of_time_makes_a_batch():
    assert collected([upload(k) for k in range(60)]) == [25, 25, 10]


def test_a_batch_is_full_at_64_rows():
    assert collected([upload(k / 10) for k in range(150)]) == [MOST_ROWS, MOST_ROWS, 22]


def test_a_new_map_begins_a_new_batch():
    new_map = [upload(k, pose=pose(k, road=road(map_version=4))) for k in (2, 3)]
    assert collected([upload(0), upload(1), *new_map]) == [2, 2]


def test_each_upload_is_in_exactly_one_batch():
    collector, rows = UploadBatcher(EVERY_S), []
    for k in range(200):
        batch = collector.add(upload(k / 4))
        rows += batch.positioning_time_ns.tolist() if batch is not None else []
        due = collector.due(at(k / 4))
        rows += due.positioning_time_ns.tolist() if due is not None else []
    last = collector.take()
    assert np.array_equal([*rows, *last.positioning_time_ns], [at(k / 4) for k in range(200)])


def test_a_batch_is_due_when_its_stretch_is_over():
    collector = UploadBatcher(EVERY_S)
    assert collector.due(at(100)) is None
    collector.add(upload(0))
    assert collector.due(at(24)) is None
    assert collector.due(at(25)) is not None
    assert collector.due(at(50)) is None
    assert collector.take() is None
