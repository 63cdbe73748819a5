"""The service acknowledges what is committed, and does not reply to the rest."""

import sqlite3
from contextlib import closing, contextmanager

import pytest

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.service import MapUpdateService
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import FusionStep
from camber.road_map.release import open_release
from camber.runtime.uploads.received_upload import ReceivedUpload
from camber.schemas.fleet import MapChangesRequest, MapDecision, MapVotesRequest
from support.contributions import NOW_NS, batch
from support.contributions import upload as upload_of
from support.fake_bus import FakeBus
from support.small_map import surface, write


@pytest.fixture
def bus():
    return FakeBus(NOW_NS)


@pytest.fixture
def service(tmp_path, bus):
    with closing(MapUpdateService(MapUpdateSettings(state_dir=tmp_path, busy_s=0.0), bus)) as service:
        yield service


@contextmanager
def locked(folder):
    with closing(sqlite3.connect(folder / "uploads.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield
        other.execute("ROLLBACK")


def upload(upload_id="u1", **changes):
    return upload_of(upload_id=upload_id, **changes)


def asked(service, channel, *questions):
    return service.answers()[channel]([ReceivedUpload(question.vehicle, question) for question in questions])


def test_each_upload_gets_a_receipt_with_its_outcome_in_the_order_sent(service, bus):
    receipts = asked(service, "upload", upload("u1"), upload("u2", datum="Tokyo"), upload("u1"))
    assert [(r.vehicle, r.upload_id, r.status) for r in receipts] == [
        ("v1", "u1", "stored"),
        ("v1", "u2", "refused"),
        ("v1", "u1", "duplicate"),
    ]
    assert receipts[1].reason.startswith("datum Tokyo, expected one of ")
    assert receipts[0].reason == ""
    assert bus.counters == {"stored": 1, "duplicate": 1, "refused": 1, "refused.datum": 1}
    assert bus.text("refused_upload").startswith("v1, u2: datum Tokyo")


def test_a_batch_is_acknowledged_under_its_batch_id(service):
    (first,) = asked(service, "upload_batch", batch())
    (second,) = asked(service, "upload_batch", batch())
    assert (first.upload_id, first.status) == ("b1", "stored")
    assert (second.upload_id, second.status) == ("b1", "duplicate")


def test_an_upload_pruned_from_the_ledger_is_refused_for_its_age(tmp_path, bus):
    settings = MapUpdateSettings(
        state_dir=tmp_path, retention_days=10.0, oldest_upload_days=40.0, future_limit_s=86_400.0
    )
    statuses = []
    with closing(MapUpdateService(settings, bus)) as service, closing(_file(tmp_path)) as fusion:
        for day in (0.0, 39.9, 41.9, 42.1):
            bus.time_ns = NOW_NS + round(day * NS_PER_DAY)
            receipts = asked(service, "upload", upload("u1"), upload("u2"))
            fusion.advance(fusion.progress(), FusionStep(cursor=2))
            service.advance(bus.time_ns)
            statuses.append(([receipt.status for receipt in receipts], bus.counters["pruned"]))
    assert statuses == [
        (["stored"] * 2, 0),
        (["duplicate"] * 2, 0),
        (["duplicate"] * 2, 0),
        (["duplicate"] * 2, 2),
    ]
    assert _file(tmp_path).counts() == (0, 0)
    with closing(MapUpdateService(settings, bus)) as service:
        (receipt,) = asked(service, "upload", upload("u1"))
    assert receipt.status == "refused"
    assert receipt.reason.startswith("record 0: time_ns ")


def _file(folder):
    return SqliteStore(folder / "uploads.sqlite", busy_s=1.0)


@pytest.mark.parametrize("key", ["v2", "*"])
def test_an_upload_under_the_key_of_another_vehicle_is_refused_and_takes_no_id(service, bus, key):
    forged = ReceivedUpload(key, upload("u1", road_height_m=99.0))
    (refused, stored) = service.answers()["upload"]([forged, ReceivedUpload("v1", upload("u2"))])
    assert (refused.status, stored.status) == ("refused", "stored")
    assert refused.reason == f"vehicle v1 was uploaded under the key of {key}, expected the same"
    assert bus.counters["refused.vehicle"] == 1
    assert [r.status for r in asked(service, "upload", upload("u1"))] == ["stored"]


def test_a_forged_upload_alone_needs_no_store(service, tmp_path):
    with locked(tmp_path):
        (refused,) = service.answers()["upload_batch"]([ReceivedUpload("v2", batch())])
    assert refused.status == "refused"


def test_without_a_commit_there_is_no_receipt_and_the_next_group_is_tried_again(service, bus, tmp_path):
    with locked(tmp_path):
        assert asked(service, "upload", upload("u1"), upload("u2")) == [None, None]
        assert not service.healthy()
        assert "uploads.sqlite" in bus.text("store_unavailable")
        assert bus.counters == {"unacknowledged": 2}
    assert [r.status for r in asked(service, "upload", upload("u1"), upload("u2"))] == ["stored", "stored"]
    assert service.healthy()


def test_without_a_valid_clock_nothing_is_refused_or_acknowledged(service, bus):
    bus.time_ns = 0
    assert asked(service, "upload", upload("u1")) == [None]
    assert "time_not_known" in bus.codes()
    bus.time_ns = NOW_NS
    assert [r.status for r in asked(service, "upload", upload("u1"))] == ["stored"]


def test_the_reason_of_a_refusal_is_cut_to_fit_into_a_receipt(tmp_path, bus):
    settings = MapUpdateSettings(state_dir=tmp_path, datums=[f"datum{n:055d}" for n in range(30)])
    with closing(MapUpdateService(settings, bus)) as service:
        (receipt,) = asked(service, "upload", upload())
    assert receipt.status == "refused"
    assert len(receipt.reason) == 512


def test_without_a_readable_reference_uploads_are_stored_and_fusion_starts_once_there_is_one(tmp_path, bus):
    settings = MapUpdateSettings(state_dir=tmp_path, reference=tmp_path / "survey")
    with closing(MapUpdateService(settings, bus)) as service:
        assert [r.status for r in asked(service, "upload", upload("u1"))] == ["stored"]
        assert str(tmp_path / "survey") in bus.text("fusion_stopped")
        assert not service.healthy()
        write(tmp_path / "survey", [surface(5)])
        service.advance(bus.time_ns)
        assert not service.healthy(), "it takes time to read one: not each round"
        bus.time_ns += 60 * 10**9
        service.advance(bus.time_ns)
        assert service.healthy()


def test_changes_of_the_map_are_answered_after_the_first_fusion_and_by_one_that_fuses(tmp_path, bus, service):
    assert "map_changes" not in service.answers()
    write(tmp_path / "survey", [surface(5)])
    settings = MapUpdateSettings(state_dir=tmp_path / "other", reference=tmp_path / "survey")
    with closing(MapUpdateService(settings, bus)) as fusing:
        request = MapChangesRequest(time_ns=bus.time_ns)
        (before,) = fusing.answers()["map_changes"]([request])
        assert (before.status, before.reason) == ("unknown", "nothing has been fused yet")
        bus.publish = lambda *_: b""
        fusing.advance(bus.time_ns)
        (after,) = fusing.answers()["map_changes"]([request])
        assert (after.status, after.held.surface_id.tolist(), after.left_out) == ("known", [], 0)


def test_a_decision_is_refused_where_no_operator_has_a_key(tmp_path, bus):
    write(tmp_path / "survey", [surface(5)])
    decision = MapDecision(
        time_ns=bus.time_ns, action="accept", surface_id=5, offset_m=0.3, who="ann", why="seen on site",
        reference_sha256=open_release(tmp_path / "survey").root.manifest_sha256,
    )  # fmt: skip
    settings = MapUpdateSettings(state_dir=tmp_path, reference=tmp_path / "survey")
    with closing(MapUpdateService(settings, bus)) as service:
        (receipt,) = service.answers()["map_decision"]([decision])
        assert (receipt.status, "operator_keys" in receipt.reason) == ("refused", True)
        assert "ann" not in bus.text("decision_refused")
        count = len(bus.issues)
        (receipt,) = service.answers()["map_decision"](
            [decision.model_copy(update={"reference_sha256": "0" * 64})]
        )
        assert (receipt.status, len(bus.issues)) == ("elsewhere", count)
        (votes,) = service.answers()["map_votes"]([MapVotesRequest(time_ns=bus.time_ns, surface_id=5)])
        assert (votes.status, votes.day.tolist()) == ("known", [])
    bad = MapUpdateSettings(
        state_dir=tmp_path / "bad", reference=tmp_path / "survey", operator_keys=tmp_path / "survey"
    )
    with closing(MapUpdateService(bad, bus)) as service:
        assert "NAME.pub" in bus.text("fusion_stopped")
        (votes,) = service.answers()["map_votes"]([MapVotesRequest(time_ns=bus.time_ns, surface_id=5)])
        assert (votes.status, votes.reason) == ("unknown", "nothing is fused here")


def test_an_invalid_voters_key_is_reported_and_uploads_are_stored(tmp_path, bus):
    write(tmp_path / "survey", [surface(5)])
    (tmp_path / "voters.key").write_bytes(b"")
    settings = MapUpdateSettings(state_dir=tmp_path, reference=tmp_path / "survey")
    with closing(MapUpdateService(settings, bus)) as service:
        assert [r.status for r in asked(service, "upload", upload("u1"))] == ["stored"]
        assert "voters' key" in bus.text("fusion_stopped")


def test_a_voters_key_is_created_atomically_and_once(tmp_path, bus):
    write(tmp_path / "survey", [surface(5)])
    settings = MapUpdateSettings(state_dir=tmp_path, reference=tmp_path / "survey")
    keys = set()
    for _ in range(2):
        with closing(MapUpdateService(settings, bus)):
            keys.add((tmp_path / "voters.key").read_bytes())
    (key,) = keys
    assert len(key) == 32
    assert sorted(tmp_path.glob("voters.key*")) == [tmp_path / "voters.key"]
