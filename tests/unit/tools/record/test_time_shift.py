"""A message moved in time: its instants move, its durations do not."""

from __future__ import annotations

from random import Random

import pytest

from camber.schemas.base import Message
from camber.schemas.channels import CHANNELS
from camber.schemas.gnss import Fix
from camber.tools.record.time_shift import instants, moved
from support.messages import build

MESSAGES = sorted({channel.message for channel in CHANNELS}, key=lambda cls: cls.__name__)


@pytest.mark.parametrize("cls", MESSAGES, ids=lambda cls: cls.__name__)
def test_moved_and_moved_back_every_message_is_what_it_was(cls: type[Message]) -> None:
    message = build(cls, Random(cls.schema_name()), filled=True)
    later = moved(message, 3_000_000)
    assert later.time_ns == message.time_ns + 3_000_000
    assert moved(later, -3_000_000) == message


def test_every_instant_is_moved_and_no_duration() -> None:
    fields = [(cls.__name__, name) for cls in MESSAGES for name in cls.model_fields]
    named = {f"{cls}.{name}" for cls, name in fields if name.endswith(("time_ns", "since_ns"))}
    result = {f"{cls.__name__}.{name}" for cls in MESSAGES for name in instants(cls)}
    # How long a lock has held is a duration.
    assert named - result <= {"Observations.lock_time_ns", "UploadBatch.positioning_time_ns"}
    assert {"Fix.continuous_since_ns", "Pose.anchor_time_ns"} <= result


def test_a_fix_is_called_by_its_new_epoch() -> None:
    fix = build(Fix, Random(1), filled=True)
    assert moved(fix, 5_000_000).fix_id == fix.fix_id + 5


def test_only_whole_milliseconds() -> None:
    with pytest.raises(ValueError, match="whole milliseconds"):
        moved(build(Fix, Random(1), filled=True), 1)
