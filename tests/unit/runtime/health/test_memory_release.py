"""Freed memory goes back to the system."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np
import pytest

from camber.runtime.health.memory_release import return_freed_memory


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's allocator can be asked")
def test_holes_between_what_is_still_held_are_given_back() -> None:
    pieces = [np.ones(12_000) for _ in range(2000)]  # 96 kB each: from the heap, not mapped for themselves
    held = pieces[::50]
    full = resident_bytes()
    del pieces
    assert return_freed_memory()
    assert full - resident_bytes() > 100e6
    assert len(held) == 40
