"""Fuzzing of one decoder: it raises only documented errors, results do not depend on chunks, memory does not grow."""

from __future__ import annotations

import dataclasses
import gc
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, Protocol

import numpy as np
from pydantic import BaseModel

from fuzz.mutation import cut_up, damaged

MOST_GROWTH_BYTES = 64 << 20
_WARM_UP_SHARE = 0.3
_LOOK_EVERY = 50


class StreamDecoder(Protocol):
    """A decoder of a stream."""

    def feed(self, data: bytes) -> list[Any]: ...

    def finish(self) -> list[Any]: ...


@dataclass(frozen=True)
class Target:
    """A decoder of a stream (`stream` makes one), or a reader of a whole (`read`), which may raise `refusal`.

    `corpus` makes valid inputs, each a list of contents; `sealed` adds frame and checksum to a content, so that damage
    within a content passes them.
    """

    name: str
    corpus: Callable[[Random], list[list[bytes]]]
    stream: Callable[[], StreamDecoder] | None = None
    read: Callable[[bytes], object] | None = None
    refusal: type[Exception] | tuple[type[Exception], ...] = ()
    sealed: Callable[[bytes], bytes] = bytes


class Broken(AssertionError):  # noqa: N818 (a finding)
    """A decoder fails; `data` is the input that shows it."""

    def __init__(self, what: str, data: bytes) -> None:
        super().__init__(what)
        self.data = data


def attack(target: Target, seconds: float, seed: int) -> int:
    """Feed damaged input for a time; return the number of inputs. Raises Broken."""
    random = Random(seed)
    corpus = target.corpus(random)
    for contents in corpus:
        _must_read(target, b"".join(map(target.sealed, contents)))
    lasting = target.stream() if target.stream is not None else None
    began = time.monotonic()
    count, warm_bytes = 0, None
    while (passed_s := time.monotonic() - began) < seconds:
        data = _made(random, target, corpus)
        _hold(random, target, data)
        if lasting is not None:
            _guarded(target, data, lambda data=data: lasting.feed(data))
        count += 1
        if count % _LOOK_EVERY == 0 and passed_s > _WARM_UP_SHARE * seconds:
            gc.collect()
            warm_bytes = warm_bytes if warm_bytes is not None else resident_bytes()
            grown = resident_bytes() - warm_bytes
            if grown > MOST_GROWTH_BYTES:
                limit = f"expected {MOST_GROWTH_BYTES >> 20} at most"
                raise Broken(f"memory grew by {grown >> 20} MiB, {limit}", data)
    return count


def check(target: Target, data: bytes, seed: int = 0) -> None:
    """Check one input, for those that once broke a decoder. Raises Broken."""
    _hold(Random(seed), target, data)


def _must_read(target: Target, data: bytes) -> None:
    if target.stream is not None:
        decoder = target.stream()
        assert decoder.feed(data) + decoder.finish(), f"{target.name}: no result of valid input"
    else:
        assert target.read is not None
        target.read(data)


def _made(random: Random, target: Target, corpus: Sequence[Sequence[bytes]]) -> bytes:
    kind = random.random()
    if kind < 0.03:
        return random.randbytes(random.choice((0, 1, 10, 1000)))
    contents = list(random.choice(corpus))
    others = random.choice(corpus)
    if kind < 0.6:  # within some contents
        for _ in range(random.choice((1, 1, 3))):
            place = random.randrange(len(contents))
            contents[place] = damaged(random, contents[place], others)
    if random.random() < 0.3:
        random.shuffle(contents)
    parts = [_sealed(target, content) for content in contents]
    return b"".join(parts) if kind < 0.5 else damaged(random, b"".join(parts), parts)


def _sealed(target: Target, content: bytes) -> bytes:
    try:
        return target.sealed(content)
    except ValueError:  # too long for a frame
        return content


def _hold(random: Random, target: Target, data: bytes) -> None:
    if target.stream is None:
        assert target.read is not None
        read = target.read
        _guarded(target, data, lambda: read(data))
        return
    whole = _guarded(target, data, lambda: _played(target, [data]))
    pieces = cut_up(random, data)
    if _guarded(target, data, lambda: _played(target, pieces)) != whole:
        raise Broken(f"pieces of {[len(piece) for piece in pieces][:50]} bytes give other results", data)


def _guarded(target: Target, data: bytes, call: Callable[[], object]) -> object:
    try:
        return call()
    except target.refusal:
        return None
    except Exception as error:
        raise Broken(f"{type(error).__name__}: {error}", data) from error


def _played(target: Target, pieces: Sequence[bytes]) -> object:
    """Return the results of a decoder and its counters."""
    assert target.stream is not None
    decoder = target.stream()
    results = [result for piece in pieces for result in decoder.feed(piece)]
    results += decoder.finish()
    return plain(results), counted(decoder)


def counted(decoder: Any) -> dict[str, Any]:
    """Return the counters of a decoder and of the decoders in it."""
    public = {name: getattr(decoder, name) for name in dir(decoder) if not name.startswith("_")}
    counters = {name: value for name, value in public.items() if isinstance(value, int | dict)}
    within = {name: value for name, value in public.items() if type(value).__module__.startswith("camber.")}
    return counters | {f"{name}.{k}": v for name, value in within.items() for k, v in counted(value).items()}


def plain(value: Any) -> Any:
    """Return values, arrays and classes in a form that compares bit by bit; NaN equals itself."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, BaseModel):
        return type(value).__name__, {name: plain(item) for name, item in value.__dict__.items()}
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return type(value).__name__, [plain(getattr(value, field.name)) for field in fields]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return repr(value)


def resident_bytes() -> int:
    """Return the resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
