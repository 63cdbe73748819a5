"""Numeric command-line options with bounds; a value outside is refused with one line that names the bounds."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, TypeVar

N = TypeVar("N", int, float)


def number_from(least: float, most: float, unit: str = "") -> Callable[[str], float]:
    """Return the `type` of an option: a number from `least` to `most` inclusive, not NaN."""
    return _bounded(float, least, most, f"a number from {least:g} to {most:g} {unit}".rstrip())


def whole_from(least: int, most: int) -> Callable[[str], int]:
    """Return the `type` of an option: an integer from `least` to `most` inclusive."""
    return _bounded(int, least, most, f"a whole number from {least} to {most}")


def each_of(*types: Callable[[str], float]) -> type[argparse.Action]:
    """Return the `action` of an option with several numbers, each of its own `type`."""

    class _EachOf(argparse.Action):
        def __call__(self, _: object, namespace: argparse.Namespace, values: Any, __: object = None) -> None:
            try:
                numbers = tuple(read(text) for read, text in zip(types, values, strict=True))
            except argparse.ArgumentTypeError as error:
                raise argparse.ArgumentError(self, str(error)) from None
            setattr(namespace, self.dest, numbers)

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


# Waiting time of a tool.
SECONDS = number_from(0.001, 3600.0, "s")
# Ids of surfaces and releases: 63 bits, as columns of maps and stores hold them.
NUMBER = whole_from(0, 2**63 - 1)
# Random seed, as a scenario takes it.
SEED = NUMBER
LATITUDE, LONGITUDE = number_from(-90.0, 90.0, "°"), number_from(-180.0, 180.0, "°")
# Ellipsoidal height of roads on earth.
HEIGHT = number_from(-1000.0, 10_000.0, "m")
# σ of a height.
HEIGHT_SIGMA = number_from(0.001, 10.0, "m")
# Chosen: more than any machine has.
PROCESSES = whole_from(1, 1024)
