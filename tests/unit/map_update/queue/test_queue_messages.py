"""What went into the queue comes out of it, and nothing else does."""

import numpy as np
import pytest

from camber.map_update.admission import Refusal
from camber.map_update.queue.queue_messages import (
    QueuedContribution,
    QueueMessageError,
    pack_contributions,
    pack_outcomes,
    unpack_contributions,
    unpack_outcomes,
)
from camber.map_update.stores.upload_deduplication import Outcome
from support.contributions import contribution, random_batch


def contributions() -> list[QueuedContribution]:
    rng = np.random.default_rng(4)
    refusal = Refusal("datum", "datum Tokyo, expected WGS84")
    return [
        QueuedContribution(random_batch("b1", 20, rng), None),
        QueuedContribution(contribution("u1", datum="Tokyo"), refusal),
        QueuedContribution(random_batch("b2", 3, rng), None),
    ]


def test_contributions_survive_a_round_trip():
    sent = contributions()
    reply, received = unpack_contributions(pack_contributions("_INBOX.a1.7", sent))
    assert reply == "_INBOX.a1.7"
    assert [item.refusal for item in received] == [item.refusal for item in sent]
    for got, was in zip(received, sent, strict=True):
        assert got.contribution.name == was.contribution.name
        assert got.contribution.digest() == was.contribution.digest()


def test_outcomes_survive_a_round_trip():
    outcomes = [Outcome("stored"), Outcome("duplicate"), Outcome("refused", Refusal("datum", "datum Tokyo"))]
    assert unpack_outcomes(pack_outcomes(outcomes)) == outcomes


def test_rows_that_are_not_finite_are_rejected():
    sent = contribution("u1")
    sent.observations["road_height_m"] = np.nan
    with pytest.raises(QueueMessageError, match="finite"):
        unpack_contributions(pack_contributions("_INBOX.a", [QueuedContribution(sent, None)]))


@pytest.mark.parametrize("vehicle", ["", "a b", "a\0b", "x" * 65])
def test_an_invalid_name_is_rejected(vehicle):
    with pytest.raises(QueueMessageError, match="vehicle"):
        unpack_contributions(
            pack_contributions("_INBOX.a", [QueuedContribution(contribution("u1", vehicle=vehicle), None)])
        )


@pytest.mark.parametrize(
    "damage", [b"", b"\0\0\0\0", b"\xff\xff\xff\xff", b"\1\0\0\0\x90", b"\x05\0\0\0\x93\x02\xa1a\x90"]
)
def test_other_bytes_are_a_message_error(damage):
    with pytest.raises(QueueMessageError):
        unpack_contributions(damage)
    with pytest.raises(QueueMessageError):
        unpack_outcomes(damage)
    with pytest.raises(QueueMessageError):
        unpack_contributions(pack_contributions("_INBOX.a", contributions())[:-1])
