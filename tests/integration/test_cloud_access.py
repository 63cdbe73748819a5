"""Access rules on the router of the cloud: real processes, TLS on the loopback, one attempt a row.

A row is allowed or denied as docs/security.md states, and a denied publisher or query gets a report: Zenoh
does not give one, so Camber asks for an echo, notices a question that nobody answers, or is not let in at all.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zenoh

from camber.runtime.access_probe import AccessProbe, can_publish
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ServiceSettings
from camber.tools.operate.doctor_connection_checks import check_bus
from camber.tools.security.certificate_authority import Authority
from support.fleet_routers import (
    Certificates,
    joined,
    make_certificates,
    router,
    tls_endpoint,
    unchecked,
)
from support.running import CLOCK, wait_until

NOTHING_S = 0.4
ENDS_WITHIN_S = 2.0
"""How long nothing must arrive; what is allowed takes a hundredth of it."""
V = "camber/v1/car-1"
W = "camber/v1/car-2"
F = "camber/v1/fleet"


class Row(NamedTuple):
    who: str
    action: str
    key: str
    allowed: bool

    def __str__(self) -> str:
        return f"{self.who} {'may' if self.allowed else 'may not'} {self.action} {self.key}"


RULES = """
car-1      may      publish    car-1/integrity/verdict car-1/integrity/position
car-1      may      subscribe  fleet/release
car-1      may      ask        fleet/car-1/upload fleet/car-1/upload_batch fleet/map/root fleet/map/blob
car-1      may      answer     car-1/integrity/health
# What stays in a vehicle
car-1      may_not  publish    car-1/vehicle/sweep car-1/gnss/fix
car-1      may_not  subscribe  car-1/integrity/verdict
car-1      may_not  answer     car-1/map_server/tile
# A vehicle under the name of another, or of the cloud
car-1      may_not  publish    car-2/integrity/verdict */integrity/verdict fleet/release
car-1      may_not  subscribe  car-2/integrity/verdict **
car-1      may_not  ask        fleet/car-2/upload fleet/car-2/upload_batch fleet/*/upload_batch car-2/integrity/health
car-1      may_not  answer     car-2/integrity/health fleet/map/root fleet/map/blob
car-1      may_not  answer     fleet/car-2/upload_batch fleet/*/upload_batch
car-2      may      publish    car-2/integrity/verdict
car-2      may_not  publish    car-1/integrity/position
car-2      may_not  ask        fleet/car-1/upload_batch
# The service of the fleet
map_update may      publish    fleet/release
map_update may      ask        fleet/map_update/health
map_update may      answer     fleet/*/upload fleet/*/upload_batch fleet/map/root fleet/map_update/health
map_update may_not  publish    car-1/integrity/verdict
map_update may_not  subscribe  car-1/integrity/verdict
map_update may_not  ask        car-1/integrity/log_level
# Who only reads
consumer   may      subscribe  car-1/integrity/verdict */integrity/position
consumer   may_not  publish    car-1/integrity/verdict fleet/release
consumer   may_not  subscribe  car-1/gnss/fix
consumer   may_not  ask        fleet/car-1/upload_batch car-1/integrity/health
consumer   may_not  answer     fleet/map/root
# Who looks after them
operator   may      ask        car-1/integrity/health car-2/gnss/log_level
operator   may_not  publish    car-1/integrity/verdict
operator   may_not  ask        fleet/car-1/upload
# A certificate of the authority that is not, or no more, in the list
revoked    may_not  publish    revoked/integrity/verdict
revoked    may_not  subscribe  fleet/release
revoked    may_not  ask        fleet/revoked/upload_batch
unlisted   may_not  publish    car-1/integrity/verdict
unlisted   may_not  ask        fleet/map/root
unlisted   may_not  answer     fleet/map/root
"""
ROWS = [
    Row(who, action, key if key == "**" else f"camber/v1/{key}", rule == "may")
    for line in RULES.splitlines()
    if line and not line.startswith("#")
    for who, rule, action, *keys in [line.split()]
    for key in keys
]


class Fleet(NamedTuple):
    certificates: Certificates
    endpoint: str
    sessions: dict[str, zenoh.Session]
    echoes: dict[tuple[str, str], str]

    def session(self, who: str) -> zenoh.Session:
        if who not in self.sessions:
            self.sessions[who] = joined(self.certificates.settings(who, self.endpoint))
        return self.sessions[who]

    def echo(self, who: str, name: str) -> str:
        if (who, name) not in self.echoes:
            settings = self.certificates.settings(who, self.endpoint)
            self.echoes[who, name] = can_publish(settings, name, timeout_s=20.0)
        return self.echoes[who, name]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp("fleet")
    certificates, endpoint = make_certificates(folder), tls_endpoint()
    with router(certificates.cloud_file(endpoint)), ExitStack() as stack:
        result = Fleet(certificates, endpoint, {}, {})
        stack.callback(lambda: [session.close() for session in result.sessions.values()])
        result.session("cloud")
        yield result


class Got:
    """What has come, and that something has."""

    def __init__(self) -> None:
        self.came = threading.Event()

    def sample(self, _: zenoh.Sample) -> None:
        self.came.set()

    def query(self, query: zenoh.Query) -> None:
        self.came.set()
        with query:
            # A query on a wildcard by one that must not ask: the reply is on a key of its own.
            query.reply(str(query.key_expr), b"answer")


def published(
    publishing: zenoh.Session, subscribing: zenoh.Session, key: str, subscribed: str | None = None
) -> bool:
    """Does what one publishes reach the other? Both ways in which one can: with a publisher, and without."""
    got = Got()
    subscriber = subscribing.declare_subscriber(subscribed or key, got.sample)
    publisher = publishing.declare_publisher(key)
    deadline = time.monotonic() + NOTHING_S
    while not got.came.is_set() and time.monotonic() < deadline:
        publisher.put(b"payload")
        publishing.put(key, b"payload")
        got.came.wait(0.05)
    publisher.undeclare()
    subscriber.undeclare()
    return got.came.is_set()


def answered(asker: zenoh.Session, answerer: zenoh.Session, key: str) -> bool:
    """Does a question come through, and the answer back?"""
    got = Got()
    queryable = answerer.declare_queryable(key, got.query)
    deadline, replies = time.monotonic() + NOTHING_S, 0
    while not replies and time.monotonic() < deadline:
        replies = sum(reply.ok is not None for reply in asker.get(key, payload=b"?", timeout=1.0))
        time.sleep(0.0 if replies else 0.05)
    queryable.undeclare()
    assert got.came.is_set() == bool(replies), "a question was let in, but not its answer out"
    return bool(replies)


def test_there_are_rows_of_every_kind() -> None:
    assert len(ROWS) == len(set(ROWS)) >= 30
    assert {(row.action, row.allowed) for row in ROWS} == {
        (action, allowed) for action in ("publish", "subscribe", "ask", "answer") for allowed in (True, False)
    }


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_a_row(fleet: Fleet, row: Row) -> None:
    session, everyone = fleet.session(row.who), fleet.session("cloud")
    done = {
        "publish": lambda: published(session, everyone, row.key),
        "subscribe": lambda: published(
            everyone, session, row.key if row.key != "**" else f"{W}/gnss/fix", subscribed=row.key
        ),
        "ask": lambda: answered(session, everyone, row.key),
        "answer": lambda: answered(everyone, session, row.key),
    }[row.action]()
    assert done == row.allowed


# A denied subscriber publishes nothing. What a vehicle publishes within itself ends at its router: no mistake.
REPORTED = [row for row in ROWS if not row.allowed and row.action != "subscribe" and not (
    row.who == "car-1" and row.key.startswith(V))]  # fmt: skip


@pytest.mark.parametrize("row", REPORTED, ids=str)
def test_a_denied_publisher_or_query_gets_a_report(fleet: Fleet, row: Row) -> None:
    if row.action == "ask":
        asked_s = time.monotonic()
        assert list(fleet.session(row.who).get(row.key, payload=b"?", timeout=30.0)) == []
        assert time.monotonic() - asked_s < 20.0, "at once, not by a timeout"
    else:
        assert fleet.echo(row.who, row.key.split("/")[2]) == "denied"


@pytest.mark.parametrize(
    ("who", "name"),
    [("car-1", "car-1"), ("car-2", "car-2"), ("map_update", "fleet"), ("consumer", "consumer")],
)
def test_publishing_in_the_name_of_the_certificate_is_permitted(fleet: Fleet, who: str, name: str) -> None:
    assert fleet.echo(who, name) == "permitted"


def test_a_service_in_a_wrong_name_says_so_in_its_health(fleet: Fleet) -> None:
    watch = AccessProbe(fleet.certificates.settings("car-1", fleet.endpoint), "car-2", again_s=600.0)
    result: list[str] = []
    wait_until(
        lambda: result.extend(watch.problems()) or result, timeout_s=30.0, why="no problem was reported"
    )
    assert "car-1 says as car-2: not in its access list" in result[0]
    right = AccessProbe(fleet.certificates.settings("car-1", fleet.endpoint), "car-1")
    time.sleep(2.0)
    assert right.problems() == []


def test_the_doctor_says_whose_certificate_is_in_no_access_list(fleet: Fleet) -> None:
    def problems(who: str, vehicle: str) -> list[str]:
        zenoh_settings = fleet.certificates.settings(who, fleet.endpoint)
        result = check_bus(ServiceSettings(vehicle=vehicle, zenoh=zenoh_settings))
        return [finding.text for finding in result if finding.state == "problem"]

    assert problems("car-1", "car-1") == []
    (problem,) = problems("revoked", "revoked")
    assert "revoked says as revoked: not in its access list" in problem
    assert len(problems("car-1", "car-2")) == 1


def test_an_upload_in_anothers_name_has_no_receipt_and_a_reason(fleet: Fleet) -> None:
    settings = ServiceSettings(vehicle="car-2", zenoh=fleet.certificates.settings("car-1", fleet.endpoint))
    got = Got()
    queryable = fleet.session("cloud").declare_queryable(f"{F}/*/upload_batch", got.query)
    session = open_session(settings.zenoh, timeout_s=10.0)
    with closing(Bus(session, settings, "integrity", CLOCK)) as bus:
        with pytest.raises(QueryFailed, match="denied") as failed:
            bus.ask_bytes("upload_batch", b"x")
        assert failed.value.reason == "absent"
        assert not got.came.is_set()
    queryable.undeclare()


@pytest.mark.parametrize("who", ["expired", "other authority"])
def test_a_certificate_that_is_not_valid_is_not_let_in(fleet: Fleet, who: str) -> None:
    settings = fleet.certificates.settings(who, fleet.endpoint)
    assert not_let_in(unchecked(settings))
    with pytest.raises(BusError, match="expired" if who == "expired" else "not signed by"):
        open_session(settings, timeout_s=5.0)


def test_without_a_certificate_nobody_is_let_in(fleet: Fleet) -> None:
    settings = fleet.certificates.settings("car-1", fleet.endpoint)
    assert not_let_in(unchecked(settings.model_copy(update={"tls_certificate": None})))


@pytest.mark.parametrize("mode", ["peer", "router"])
def test_another_mode_gives_no_more_rights(fleet: Fleet, mode: str) -> None:
    session = unchecked(fleet.certificates.settings("car-1", fleet.endpoint), mode=mode)
    assert session is not None
    with session:
        time.sleep(0.5)
        assert published(session, fleet.session("cloud"), f"{V}/integrity/verdict")
        assert not published(session, fleet.session("cloud"), f"{W}/integrity/verdict")
        assert not published(fleet.session("car-2"), session, f"{W}/integrity/verdict")
        assert not answered(session, fleet.session("cloud"), f"{F}/car-2/upload_batch")
        assert not answered(fleet.session("car-2"), session, f"{F}/map/root")


def test_a_link_ends_with_its_certificate_and_begins_again_with_a_new_one(tmp_path: Path) -> None:
    """The clock of the test is the machine's: a certificate of a few seconds."""
    certificates, endpoint = make_certificates(tmp_path), tls_endpoint()
    with router(certificates.cloud_file(endpoint, "--vehicle", "brief")):
        now, authority = datetime.now(UTC), Authority(certificates.folder)
        authority.issue("brief", "vehicle", days=timedelta(seconds=8) / timedelta(days=1), now=now)
        with joined(certificates.settings("brief", endpoint)) as session:
            wait_until(
                lambda: not list(session.info.routers_zid()), timeout_s=30.0, why="the link outlived it"
            )
            assert datetime.now(UTC) - now >= timedelta(seconds=7)
            time.sleep(2.0)
            assert not list(session.info.routers_zid()), "it was let in again"
            # The files are read anew for each link: nothing has to be started again.
            authority.issue("brief", "vehicle", days=1, now=datetime.now(UTC), renew=True)
            wait_until(
                lambda: list(session.info.routers_zid()), timeout_s=20.0, why="it was not let in again"
            )


def not_let_in(session: Any) -> bool:
    """No session, or one whose link has ended at once and does not come back."""
    if session is None:
        return True
    with session:
        time.sleep(ENDS_WITHIN_S)
        return not list(session.info.routers_zid())
