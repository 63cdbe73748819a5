"""The queue between workers: divided by shards, answered after the commit, lost without loss."""

import asyncio
import shutil
import threading
from collections import Counter
from contextlib import ExitStack, closing, contextmanager

import pytest

from camber.map_update.admission import Refusal
from camber.map_update.queue import nats_queue
from camber.map_update.queue.nats_queue import QueueReceiver, QueueSender
from camber.map_update.queue.queue_messages import QueuedContribution, QueueError, pack_contributions
from camber.map_update.stores.shards import Shards
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import Outcome
from support.contributions import NOW_NS, contribution
from support.databases import NatsServer, needs_nats, running
from support.running import wait_until

pytestmark = needs_nats

QUARTERS = Shards(["0", "1", "2", "3"])
WHOLE = Shards([""])


@pytest.fixture
def server():
    with running(NatsServer()) as server:
        yield server


def open_sender(server, shards=WHOLE, limit_s=5.0):
    return closing(QueueSender(server.address, shards, limit_s=limit_s))


class Worker(threading.Thread):
    """Takes what is of a shard and commits it, as the service does."""

    def __init__(self, server, shard, path):
        super().__init__()
        self.server, self.shard, self.path = server, shard, path
        self.over = threading.Event()
        self.fails = 0
        self.rounds = 0

    def run(self):
        with (
            closing(QueueReceiver(self.server.address, self.shard, limit_s=5.0)) as receiver,
            closing(SqliteStore(self.path)) as store,
        ):
            while not self.over.is_set():
                try:
                    self.round(receiver, store)
                except QueueError:
                    self.over.wait(0.05)

    def round(self, receiver, store):
        deliveries = receiver.take(0.05)
        if not deliveries:
            return
        if self.fails:
            self.fails -= 1
            receiver.redeliver(deliveries)
            return
        self.rounds += 1
        queued = [item for delivery in deliveries for item in delivery.contributions]
        refusals = {id(item.contribution): item.refusal for item in queued}
        outcomes = iter(
            store.commit([item.contribution for item in queued], NOW_NS, lambda c: refusals[id(c)])
        )
        receiver.acknowledge(deliveries, [[next(outcomes) for _ in d.contributions] for d in deliveries])


@contextmanager
def storing(server, folder, *shards):
    with ExitStack() as ends:
        workers = {}
        for shard in shards:
            worker = workers[shard] = Worker(server, shard, folder / f"{shard}.sqlite")
            worker.start()
            ends.callback(worker.join)
            ends.callback(worker.over.set)
        yield workers


def sent(sender, *contributions, refused=None):
    """What became of each; the queue is asked again while it is not there."""
    queued = [QueuedContribution(c, refused) for c in contributions]

    def received():
        try:
            outcomes = sender.send(queued)
        except QueueError:
            return None
        return None if None in outcomes else [outcome.status for outcome in outcomes]

    return wait_until(received, timeout_s=30.0, why="no answer from the queue")


def test_what_is_sent_is_answered_after_its_commit_and_again_it_is_a_duplicate(server, tmp_path):
    with open_sender(server) as sender, storing(server, tmp_path, "world"):
        uploads = [contribution(f"u{n}") for n in range(300)]
        assert Counter(sent(sender, *uploads)) <= Counter({"stored": 300, "duplicate": 300})
        assert sent(sender, *uploads) == ["duplicate"] * 300
        assert sent(sender, contribution("u0", height_m=41.0)) == ["refused"]
    with closing(SqliteStore(tmp_path / "world.sqlite")) as store:
        assert store.counts() == (300, 300)


def test_what_its_receiver_refuses_is_refused_unless_it_is_known(server, tmp_path):
    refusal = Refusal("datum", "datum Tokyo, expected WGS84")
    with open_sender(server) as sender, storing(server, tmp_path, "world"):
        assert sent(sender, contribution("u1"))[0] in ("stored", "duplicate")
        assert sent(sender, contribution("u1"), contribution("u2"), refused=refusal) == [
            "duplicate",
            "refused",
        ]
        assert sent(sender, contribution("u2"))[0] in ("stored", "duplicate")


def test_a_batch_across_shards_is_stored_in_each_and_acknowledged_once_all_have_it(server, tmp_path):
    batch = contribution("b1", kind="batch", records=10)
    batch.observations["latitude_rad"][3:] *= -1.0
    with open_sender(server, QUARTERS, limit_s=1.5) as sender:
        with storing(server, tmp_path, "1"):
            assert sent(sender, contribution("u1"))[0] in ("stored", "duplicate")
            assert sender.send([QueuedContribution(batch, None)]) == [None]
        with storing(server, tmp_path, "1", "3"):
            assert sent(sender, batch)[0] in ("stored", "duplicate")
            assert sent(sender, batch) == ["duplicate"]
    for shard, rows in (("1", batch.observations[:3]), ("3", batch.observations[3:])):
        with closing(SqliteStore(tmp_path / f"{shard}.sqlite")) as store:
            result = store.observations_after(0, 100)
            entry = [h.id for h in result.entries].index("b1")
            assert result.rows[result.entry_of == entry].tobytes() == rows.tobytes()


def test_nobody_who_stores_means_no_acknowledgement(server):
    with open_sender(server, limit_s=0.3) as sender:
        assert sender.send([QueuedContribution(contribution("u1"), None)]) == [None]


def test_what_could_not_be_stored_comes_again_without_its_sender(server, tmp_path):
    with open_sender(server, limit_s=5.0) as sender, storing(server, tmp_path, "world") as workers:
        assert sent(sender, contribution("u0"))[0] in ("stored", "duplicate")
        workers["world"].fails = 1
        (outcome,) = sender.send([QueuedContribution(contribution("u1"), None)])
        assert outcome is not None
        assert outcome.status == "stored"


@pytest.mark.parametrize("emptied", [False, True], ids=["killed", "killed and emptied"])
def test_a_server_that_is_killed_loses_nothing_acknowledged(server, tmp_path, emptied):
    uploads = [contribution(f"u{n}") for n in range(40)]
    with open_sender(server) as sender, storing(server, tmp_path, "world"):
        sent(sender, *uploads[:20])
        server.end()
        with pytest.raises(QueueError, match=r"nats://127\.0\.0\.1:\d+: "):
            sender.send([QueuedContribution(uploads[20], None)])
        if emptied:
            shutil.rmtree(server.folder / "data")
        server.start()
        sent(sender, *uploads)
        assert sent(sender, *uploads) == ["duplicate"] * 40


def test_what_is_no_message_is_dropped_and_does_not_stop_the_others(server, tmp_path):
    import nats

    async def publish(data):
        client = await nats.connect(server.address)
        await client.jetstream().publish("camber.uploads.world", data)
        await client.close()

    with open_sender(server) as sender, storing(server, tmp_path, "world") as workers:
        assert sent(sender, contribution("u1"))[0] in ("stored", "duplicate")
        asyncio.run(publish(b"no message"))
        asyncio.run(publish(pack_contributions("x", [QueuedContribution(contribution("u2"), None)])[:-7]))
        assert sent(sender, contribution("u3"))[0] in ("stored", "duplicate")
        assert workers["world"].rounds >= 2


def test_a_contribution_beyond_the_servers_limit_is_not_acknowledged_and_the_others_are(server, tmp_path):
    with open_sender(server) as sender, storing(server, tmp_path, "world"):
        assert sent(sender, contribution("u1"))[0] in ("stored", "duplicate")
        huge = contribution("b1", kind="batch", records=120_000)
        outcomes = sender.send([QueuedContribution(contribution("u2"), None), QueuedContribution(huge, None)])
        assert [outcome and outcome.status for outcome in outcomes] == ["stored", None]
        assert sender.too_large == 1


def test_how_many_wait_in_the_server_is_known_where_they_are_taken(server):
    beyond = 16
    large = contribution("u", kind="batch", records=1)
    records = nats_queue._MESSAGE_BYTES // large.observations.nbytes
    messages = nats_queue._IN_FLIGHT + beyond
    with open_sender(server, limit_s=3.0) as sender:
        wait_until(lambda: not raises(lambda: sender.send([])), timeout_s=30.0, why="it is connected")
        batches = [contribution(f"u{n}", kind="batch", records=records) for n in range(messages)]
        assert set(sender.send([QueuedContribution(batch, None) for batch in batches])) == {None}
    with closing(QueueReceiver(server.address, "world", limit_s=5.0)) as receiver:
        assert receiver.waiting is None
        deliveries = wait_until(lambda: taken(receiver), timeout_s=30.0, why="something waits")
        assert receiver.waiting is not None
        assert receiver.waiting >= beyond, "no more than some are given out before they are settled"
        while deliveries:
            receiver.acknowledge(
                deliveries, [[Outcome("stored")] * len(each.contributions) for each in deliveries]
            )
            deliveries = receiver.take(1.0)
        assert receiver.waiting == 0


def raises(work):
    try:
        work()
    except QueueError:
        return True
    return False


def taken(receiver):
    try:
        return receiver.take(0.5)
    except QueueError:
        return []
