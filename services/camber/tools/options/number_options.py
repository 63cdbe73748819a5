"""Numbers as options of tools: each option states its bounds, and what is beyond them gets one line that names them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, TypeVar

N = TypeVar("N", int, float)


def number_from(least: float, most: float, unit: str = "") -> Callable[[str], float]:
    """The `type` of an option: a number from `least` to `most`, both included; NaN is none. `unit` ends its line."""
    return _bounded(float, least, most, f"a number from {least:g} to {most:g} {unit}".rstrip())


def whole_from(least: int, most: int) -> Callable[[str], int]:
    """The `type` of an option: a whole number from `least` to `most`, both included."""
    return _bounded(int, least, most, f"a whole number from {least} to {most}")


def each_of(*types: Callable[[str], float]) -> type[argparse.Action]:
    """The `action` of an option of several numbers, where each has a `type` of its own."""

    class _EachOf(argparse.Action):
        def __call__(self, _: object, namespace: argparse.Namespace, values: Any, __: object = None) -> None:
            try:
                found = tuple(read(text) for read, text in zip(types, values, strict=True))
            except argparse.ArgumentTypeError as error:
                raise argparse.ArgumentError(self, str(error)) from None
            setattr(namespace, self.dest, found)

    return _EachOf


def _bounded(read: Callable[[str], N], least: float, most: float, expected: str) -> Callable[[str], N]:
    def bounded(text: str) -> N:
        try:
            value = read(text)
        except ValueError:
            value = None
        if value is None or not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}")
        return value

    return bounded


# How long a tool waits.
SECONDS = number_from(0.001, 3600.0, "s")
# Of a surface, of a release: what a column of maps and stores holds.
NUMBER = whole_from(0, 2**63 - 1)
# Of all that is random: what a scenario takes.
SEED = NUMBER
LATITUDE, LONGITUDE = number_from(-90.0, 90.0, "°"), number_from(-180.0, 180.0, "°")
# Above the ellipsoid, of places with roads.
HEIGHT = number_from(-1000.0, 10_000.0, "m")
# σ of a height.
HEIGHT_SIGMA = number_from(0.001, 10.0, "m")
# As many as a machine may have.
PROCESSES = whole_from(1, 1024)
