"""What is impossible is refused with a line that names the field, its value and what was expected."""

import numpy as np
import pytest

from camber.map_update.admission import AdmissionLimits, Refusal, check
from camber.map_update.contribution import (
    OBSERVATION,
    QUALITIES,
    VERDICTS,
    Contribution,
    from_batch,
    from_upload,
)
from camber.schemas.fleet import ElevationUpload, UploadBatch

NOW_NS = 1_400_000_000 * 1_000_000_000
LIMITS = AdmissionLimits(datums=["WGS84", "JGD2011"], future_limit_s=60.0, most_records=10)
UPLOAD = {
    "time_ns": NOW_NS - 5,
    "vehicle": "v1",
    "upload_id": "u1",
    "fix_id": 7,
    "fix_quality": "fixed",
    "verdict": "erroneous",
    "latitude_rad": 0.61,
    "longitude_rad": 2.39,
    "road_height_m": 41.25,
    "road_height_sigma_m": 0.05,
    "antenna_height_m": 1.7,
    "position_covariance_enu_m2": (1.0, 0.1, 0.2, 1.5, 0.3, 2.0),
    "datum": "WGS84",
    "epoch_year": 2024.5,
    "map_version": 3,
    "surface_id": 99,
}


def batch(records=4, **changes) -> UploadBatch:
    columns = {
        "positioning_time_ns": np.full(records, NOW_NS - 5),
        "fix_id": np.arange(records),
        "fix_quality": np.zeros(records, np.uint8),
        "surface_id": np.arange(records),
        "verdict": np.full(records, 2, np.uint8),
        "latitude_rad": np.full(records, 0.61),
        "longitude_rad": np.full(records, 2.39),
        "horizontal_sigma_m": np.full(records, 0.03),
        "road_height_m": np.linspace(40.0, 41.0, records),
        "road_height_sigma_m": np.full(records, 0.05),
        "antenna_height_m": np.full(records, 1.7),
    }
    heading = {"time_ns": NOW_NS, "vehicle": "v1", "batch_id": "b1", "datum": "WGS84", "epoch_year": 2024.5}
    heading["map_version"] = 3
    return UploadBatch(**{**heading, **columns, **changes})


def refusal(contribution: Contribution, limits: AdmissionLimits = LIMITS) -> Refusal | None:
    (result,) = check([contribution], NOW_NS, limits)
    return result


def refusal_of_upload(**changes):
    return refusal(from_upload(ElevationUpload(**{**UPLOAD, **changes})))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_an_upload_is_taken_in_whatever_the_verdict_was(verdict):
    # Uploads of confirmed heights alone would hide what has changed on the road.
    assert refusal_of_upload(verdict=verdict) is None


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("datum", "Tokyo", "expected one of JGD2011, WGS84"),
        ("time_ns", NOW_NS + 60_000_000_001, f"to {NOW_NS + 60_000_000_000}"),
        ("road_height_m", -600.5, "expected -600.0 to 7000.0"),
        ("road_height_m", 7000.5, "expected -600.0 to 7000.0"),
        ("road_height_sigma_m", 0.0, "expected 0.001 to 10.0"),
        ("road_height_sigma_m", 10.5, "expected 0.001 to 10.0"),
        ("antenna_height_m", -0.1, "expected 0.0 to 20.0"),
        ("antenna_height_m", 20.5, "expected 0.0 to 20.0"),
    ],
)
def test_an_impossible_upload_is_refused_by_field_value_and_expectation(field, value, expected):
    found = refusal_of_upload(**{field: value})
    assert found is not None
    assert found.code == field
    assert f"{field} {value}, " in found.text
    assert expected in found.text


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("time_ns", NOW_NS + 60_000_000_000),
        ("road_height_m", -600.0),
        ("road_height_m", 7000.0),
        ("road_height_sigma_m", 0.001),
        ("road_height_sigma_m", 10.0),
        ("antenna_height_m", 0.0),
        ("antenna_height_m", 20.0),
    ],
)
def test_the_bounds_themselves_are_possible(field, value):
    assert refusal_of_upload(**{field: value}) is None


def test_latitude_and_longitude_zero_are_no_position_but_one_of_them_may_be():
    found = refusal_of_upload(latitude_rad=0.0, longitude_rad=0.0)
    assert found is not None
    assert found.code == "position"
    assert refusal_of_upload(latitude_rad=0.0) is None
    assert refusal_of_upload(longitude_rad=0.0) is None


def test_a_possible_batch_is_taken_in():
    assert refusal(from_batch(batch())) is None


@pytest.mark.parametrize(
    ("field", "value", "code"),
    [
        ("positioning_time_ns", 0, "time_ns"),
        ("positioning_time_ns", 2**63 - 1, "time_ns"),
        ("surface_id", -1, "surface_id"),
        ("fix_id", -1, "fix_id"),
        ("horizontal_sigma_m", 10.5, "horizontal_sigma_m"),
        ("latitude_rad", 1.6, "latitude_rad"),
        ("longitude_rad", -3.2, "longitude_rad"),
        ("road_height_m", 8000.0, "road_height_m"),
        ("road_height_sigma_m", -1.0, "road_height_sigma_m"),
        ("antenna_height_m", 50.0, "antenna_height_m"),
    ],
)
def test_one_impossible_record_refuses_its_batch_and_is_named(field, value, code):
    good = batch()
    column = getattr(good, field).copy()
    column[2] = value
    found = refusal(from_batch(good.model_copy(update={field: column})))
    assert found is not None
    assert found.code == code
    assert found.text.startswith(f"record 2: {code} {value}, expected ")


@pytest.mark.parametrize("records", [0, 11])
def test_a_batch_has_at_least_one_record_and_at_most_the_limit(records):
    found = refusal(from_batch(batch(records)))
    assert found is not None
    assert (found.code, found.text) == ("records", f"{records} records, expected 1 to 10")


def test_every_field_of_an_upload_is_in_its_contribution():
    upload = ElevationUpload(**UPLOAD)
    contribution = from_upload(upload)
    row = dict(zip(OBSERVATION.names or (), contribution.observations[0].tolist(), strict=True))
    assert VERDICTS[row.pop("verdict")] == upload.verdict
    assert QUALITIES[row.pop("fix_quality")] == upload.fix_quality
    # Of [[1, 0.1], [0.1, 1.5]] by hand: (2.5 + sqrt(0.5² + 4 · 0.1²)) / 2.
    assert row.pop("horizontal_sigma_m") == pytest.approx(((2.5 + 0.29**0.5) / 2) ** 0.5)
    heading = {name: getattr(contribution, name) for name in contribution.__slots__ if name != "observations"}
    assert heading.pop("kind") == "upload"
    assert {**row, **heading} == {
        ("id" if name == "upload_id" else name): value
        for name, value in UPLOAD.items()
        if name not in ("verdict", "fix_quality")
    }


def test_every_column_of_a_batch_is_in_its_contribution():
    source = batch()
    contribution = from_batch(source)
    for name in OBSERVATION.names or ():
        column = getattr(source, "positioning_time_ns" if name == "time_ns" else name)
        assert np.array_equal(contribution.observations[name], column)
    assert (contribution.vehicle, contribution.kind, contribution.id) == ("v1", "batch", "b1")
    assert (contribution.datum, contribution.map_version, contribution.epoch_year) == ("WGS84", 3, 2024.5)


@pytest.mark.parametrize("field", sorted(set(UPLOAD) - {"vehicle", "upload_id"}))
def test_any_other_content_has_another_digest_and_the_same_content_the_same(field):
    other = {
        "verdict": "unknown",
        "datum": "JGD2011",
        "fix_quality": "float",
        "position_covariance_enu_m2": (1.0, 0.1, 0.2, 1.5, 0.3, 2.1),
        "latitude_rad": np.nextafter(0.61, 1.0).item(),
        "longitude_rad": np.nextafter(2.39, 0.0).item(),
    }
    changed = other[field] if field in other else UPLOAD[field] + 1
    first = from_upload(ElevationUpload(**UPLOAD))
    assert first.digest() == from_upload(ElevationUpload(**UPLOAD)).digest()
    assert first.digest() != from_upload(ElevationUpload(**{**UPLOAD, field: changed})).digest()


def test_a_group_is_judged_as_each_of_it():
    tokyo = from_upload(ElevationUpload(**{**UPLOAD, "datum": "Tokyo"}))
    high = from_upload(ElevationUpload(**{**UPLOAD, "road_height_m": 8000.0}))
    good = [from_upload(ElevationUpload(**UPLOAD)), from_batch(batch())]
    for group in (good, [*good, tokyo], [high, *good, tokyo], [from_batch(batch(11)), *good], []):
        assert check(group, NOW_NS, LIMITS) == [refusal(one) for one in group]


@pytest.mark.parametrize(("age_s", "accepted"), [(86_400.0, True), (86_400.1, False)])
def test_records_older_than_the_limit_are_refused(age_s, accepted):
    limits = LIMITS.model_copy(update={"oldest_upload_days": 1.0})
    times = np.array([NOW_NS, NOW_NS - round(age_s * 1e9), NOW_NS, NOW_NS])
    found = refusal(from_batch(batch(positioning_time_ns=times)), limits)
    assert (found is None) == accepted
    if found is not None:
        assert found.code == "time_ns"
        assert found.text.startswith(f"record 1: time_ns {times[1]}, expected {NOW_NS - 86_400 * 10**9} to ")
