"""Twenty thousand uploads through two roles of map_update, JetStream and PostgreSQL, each of which is killed."""

import pytest

from support.databases import needs_nats, needs_postgres
from support.killed_uploads import run

UPLOADS = 20_000
SEED = 7


@pytest.mark.slow
@needs_nats
@needs_postgres
def test_what_is_acknowledged_is_stored_once_through_kills_of_all_that_store(tmp_path):
    """A million, and ten kills of each: `python -m support.killed_uploads`."""
    result = run(tmp_path, uploads=UPLOADS, kills=1, seed=SEED, shards=[""])
    assert result.problems == []
    assert (result.acknowledged, result.stored, result.observations) == (UPLOADS,) * 3
    assert {"postgres", "nats"} < set(result.kills)
    assert sum(result.kills.values()) == 3
    assert not [who for who in result.kills if who.endswith(" ended")], "nobody ended but who was killed"
