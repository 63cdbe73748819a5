"""What holds for all tests."""

import os
import signal

# Before numpy is loaded, here and in every process that tests start: several workers with as many threads of linear
# algebra as processors each wait for one another (an hour of `independent_offset`: 146 s for 8 s).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from hypothesis import settings

# Whoever starts the tests in the background of a shell has Ctrl-C ignored, and so would all processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine takes any time over an example; what must be quick has a benchmark.
settings.register_profile("camber", deadline=None)
settings.load_profile("camber")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first: begun last, one of them would leave the other workers without work."""
    slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: item.path not in slow)
