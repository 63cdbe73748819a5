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
from support.contributions import NOW_NS, UPLOAD, batch, upload

LIMITS = AdmissionLimits(datums=["WGS84", "JGD2011"], future_limit_s=60.0, most_records=10)


def refusal(contribution: Contribution, limits: AdmissionLimits = LIMITS) -> Refusal | None:
    (result,) = check([contribution], NOW_NS, limits)
    return result


def refusal_of_upload(**changes):
    return refusal(from_upload(upload(**changes)))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_an_upload_is_accepted_whatever_the_verdict_was(verdict):
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
        # The bounds themselves are possible.
        ("time_ns", NOW_NS + 60_000_000_000, None),
        ("road_height_m", -600.0, None),
        ("road_height_m", 7000.0, None),
        ("road_height_sigma_m", 0.001, None),
        ("road_height_sigma_m", 10.0, None),
        ("antenna_height_m", 0.0, None),
        ("antenna_height_m", 20.0, None),
    ],
)
def test_an_impossible_upload_is_refused_by_field_value_and_expectation(field, value, expected):
    result = refusal_of_upload(**{field: value})
    if expected is None:
        assert result is None
    else:
        assert result.code == field
        assert f"{field} {value}, " in result.text
        assert expected in result.text


def test_latitude_and_longitude_zero_are_no_position_but_one_of_them_may_be():
    assert refusal_of_upload(latitude_rad=0.0, longitude_rad=0.0).code == "position"
    assert refusal_of_upload(latitude_rad=0.0) is None
    assert refusal_of_upload(longitude_rad=0.0) is None


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
    assert refusal(from_batch(good)) is None
    column = getattr(good, field).copy()
    column[2] = value
    result = refusal(from_batch(good.model_copy(update={field: column})))
    assert result.code == code
    assert result.text.startswith(f"record 2: {code} {value}, expected ")


@pytest.mark.parametrize("records", [0, 11])
def test_a_batch_has_at_least_one_record_and_at_most_the_limit(records):
    assert refusal(from_batch(batch(records))) == ("records", f"{records} records, expected 1 to 10")


def test_every_field_of_an_upload_is_in_its_contribution():
    contribution = from_upload(upload())
    row = dict(zip(OBSERVATION.names or (), contribution.observations[0].tolist(), strict=True))
    assert VERDICTS[row.pop("verdict")] == UPLOAD["verdict"]
    assert QUALITIES[row.pop("fix_quality")] == UPLOAD["fix_quality"]
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
def test_the_digest_depends_on_every_field(field):
    other = {
        "verdict": "unknown",
        "datum": "JGD2011",
        "fix_quality": "float",
        "position_covariance_enu_m2": (1.0, 0.1, 0.2, 1.5, 0.3, 2.1),
        "latitude_rad": np.nextafter(0.61, 1.0).item(),
        "longitude_rad": np.nextafter(2.39, 0.0).item(),
    }
    changed = other[field] if field in other else UPLOAD[field] + 1
    digest = from_upload(upload()).digest()
    assert digest == from_upload(upload()).digest()
    assert digest != from_upload(upload(**{field: changed})).digest()


def test_a_group_is_checked_as_each_of_it():
    tokyo, high = from_upload(upload(datum="Tokyo")), from_upload(upload(road_height_m=8000.0))
    good = [from_upload(upload()), from_batch(batch())]
    for group in (good, [*good, tokyo], [high, *good, tokyo], [from_batch(batch(11)), *good], []):
        assert check(group, NOW_NS, LIMITS) == [refusal(one) for one in group]


@pytest.mark.parametrize(("age_s", "accepted"), [(86_400.0, True), (86_400.1, False)])
def test_records_older_than_the_limit_are_refused(age_s, accepted):
    limits = LIMITS.model_copy(update={"oldest_upload_days": 1.0})
    times = np.array([NOW_NS, NOW_NS - round(age_s * 1e9), NOW_NS, NOW_NS])
    result = refusal(from_batch(batch(positioning_time_ns=times)), limits)
    if accepted:
        assert result is None
    else:
        assert result.code == "time_ns"
        assert result.text.startswith(f"record 1: time_ns {times[1]}, expected {NOW_NS - 86_400 * 10**9} to ")
