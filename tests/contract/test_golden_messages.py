"""The bytes of every message version still decode to the same values, and those encode to the same bytes."""

from __future__ import annotations

import json

import pytest

from camber.schemas.codec import decode, encode, encoding_of
from contract.make_golden import GOLDEN, SEQUENCE, SOURCE, readable, released
from support.messages import message_classes

CLASSES = {cls.schema_name(): cls for cls in message_classes()}
NAMES = sorted(path.name.removesuffix(".bin") for path in GOLDEN.glob("*.bin"))
HINT = "changed on purpose, and not released yet: make golden. Released: give the message a new version"


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_every_message_has_golden_bytes(name: str) -> None:
    assert name in NAMES, "make golden"


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_decode_to_the_same_values(name: str) -> None:
    assert name in CLASSES, (
        f"nothing decodes {name} any more: keep its class, or run make golden if unreleased"
    )
    cls = CLASSES[name]
    received = decode(cls, (GOLDEN / f"{name}.bin").read_bytes(), encoding_of(cls))
    assert (received.source, received.sequence) == (SOURCE, SEQUENCE)
    assert readable(received.message) == json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8")), (
        HINT
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_same_values_encode_to_the_golden_bytes(name: str) -> None:
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    message = decode(CLASSES[name], golden).message
    assert encode(message, source=SOURCE, sequence=SEQUENCE) == golden, HINT


def test_what_was_released_is_still_there() -> None:
    assert released() <= set(NAMES)
