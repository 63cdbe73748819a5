"""A second of `make fuzz` for each decoder, and the proof that faults are detected."""

from __future__ import annotations

from random import Random

import pytest

from fuzz.decoders import DECODERS
from fuzz.target import Broken, Target, attack

SECONDS = 1.0
SEED = 20_260_320


@pytest.mark.parametrize("target", DECODERS, ids=lambda target: target.name)
def test_a_decoder_holds_for_any_input(target: Target) -> None:
    count = attack(target, SECONDS, SEED)
    print(f"{target.name}: {count} inputs, seed {SEED}")
    assert count


class Sums:
    """A decoder of lines with one number each, that can be made to fail in several ways."""

    def __init__(self, fault: str = "") -> None:
        self.fault = fault
        self.rest = b""
        self.kept: list[bytes] = []
        self.unreadable = 0

    def feed(self, data: bytes) -> list[int]:
        if self.fault == "leaks" and len(data) > 50:
            self.kept.append(b"x" * (1 << 20))
        if self.fault == "pieces":
            self.rest = b""
        *lines, self.rest = (self.rest + data).split(b"\n")
        return [number for line in lines for number in self.line(line)]

    def finish(self) -> list[int]:
        return []

    def line(self, line: bytes) -> list[int]:
        try:
            return [int(line)]
        except ValueError:
            if self.fault == "raises":
                raise
            self.unreadable += 1
            return []


def sums(fault: str) -> Target:
    def corpus(random: Random) -> list[list[bytes]]:
        return [[b"%d\n" % random.getrandbits(20) for _ in range(20)] for _ in range(3)]

    return Target("sums", corpus, stream=lambda: Sums(fault))


def test_a_decoder_without_a_fault_holds() -> None:
    assert attack(sums(""), 0.5, 1)


@pytest.mark.parametrize(
    ("fault", "message"), [("raises", "ValueError"), ("pieces", "other results"), ("leaks", "memory grew")]
)
def test_an_exception_a_lost_piece_and_a_leak_are_detected(fault: str, message: str) -> None:
    with pytest.raises(Broken, match=message) as broken:
        attack(sums(fault), 60.0, 1)  # ends as soon as it is noticed; a busy machine takes longer
    assert isinstance(broken.value.data, bytes)


def test_a_reader_may_raise_only_its_refusal() -> None:
    def read(data: bytes) -> float:
        return 1.0 / len(data.decode("ascii"))

    target = Target("reader", lambda _: [[b"some text"]], read=read, refusal=UnicodeDecodeError)
    with pytest.raises(Broken, match="ZeroDivisionError"):
        attack(target, 5.0, 1)
