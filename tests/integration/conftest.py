"""Fixtures of the tests of streams."""

import threading
from collections.abc import Iterator

import pytest

from support.streams import Reader, wait_for


@pytest.fixture
def reader() -> Reader:
    return Reader()


@pytest.fixture
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    wait_for(lambda: set(threading.enumerate()) <= before, within_s=5.0)
