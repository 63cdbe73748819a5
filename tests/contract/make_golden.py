"""Write the golden files: one well-filled example of every message, as bytes and as readable values.

    make golden

A version that stands in `golden/released.txt` is never written again: it has been sent, and must still decode. Of the
others only those are written whose bytes no longer are what this version makes of them: a further word of a field
changes which one the example draws, and nothing else.
"""

from __future__ import annotations

import json
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from pydantic import BaseModel

from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode
from support.messages import build, message_classes

GOLDEN = Path(__file__).parent / "golden"
SOURCE, SEQUENCE = "golden", 42


def released() -> set[str]:
    """Schema names of versions that have been released."""
    return set((GOLDEN / "released.txt").read_text().split())


def example(cls: type[Message]) -> Message:
    """The example of a class: the same every time."""
    return build(cls, Random(cls.schema_name()), filled=True)


def readable(value: Any) -> Any:
    """The values of a message as JSON can hold them, exactly."""
    if isinstance(value, BaseModel):
        return {name: readable(item) for name, item in value.__dict__.items()}
    if isinstance(value, np.ndarray):
        return {"dtype": value.dtype.str, "shape": list(value.shape), "values": value.ravel().tolist()}
    if isinstance(value, dict):
        return {key: readable(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [readable(item) for item in value]
    return value


def _is_current(name: str, cls: type[Message]) -> bool:
    path = GOLDEN / f"{name}.bin"
    try:
        message = decode(cls, path.read_bytes()).message
        values = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    except (OSError, ValueError, DecodeError):
        return False
    same_bytes = encode(message, source=SOURCE, sequence=SEQUENCE) == path.read_bytes()
    return same_bytes and bool(readable(message) == values)


def main() -> None:
    """Write what is not released, and remove what is neither released nor a message any more."""
    kept = released()
    classes = {cls.schema_name(): cls for cls in message_classes()}
    for path in GOLDEN.glob("camber.*"):
        if path.stem not in kept | classes.keys():
            path.unlink()
    for name in classes.keys() - kept:
        if _is_current(name, classes[name]):
            continue
        message = example(classes[name])
        (GOLDEN / f"{name}.bin").write_bytes(encode(message, source=SOURCE, sequence=SEQUENCE))
        text = json.dumps(readable(message), indent=1, ensure_ascii=False)
        (GOLDEN / f"{name}.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
