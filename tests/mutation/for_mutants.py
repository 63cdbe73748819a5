"""Where mutants live this is `conftest.py`: fewer examples, and an end to what never ends.

Properties take most of the time of a mutant that nobody notices, and what many examples would notice few do. A mutant
whose loop does not end is noticed by the first test that waits for it, by processor time: a busy machine notices none.
"""

import signal
from collections.abc import Iterator
from types import FrameType

import pytest
from hypothesis import Phase, settings

_LONGEST_S = 15.0  # tests that are not slow take three at most

settings.register_profile(
    "mutation", max_examples=20, derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate)
)
settings.load_profile("mutation")


def _end(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"a test took more than {_LONGEST_S} s of the processor")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Raises in the test every second from then on, for hypothesis tries once more what has failed."""
    signal.signal(signal.SIGPROF, _end)
    signal.setitimer(signal.ITIMER_PROF, _LONGEST_S, 1.0)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
