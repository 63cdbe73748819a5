"""Memory that was freed goes back to the system: arrays of some megabytes that come and go leave holes."""

from __future__ import annotations

import ctypes


def return_freed_memory() -> bool:
    """Ask the C library's allocator to give back what it holds for nobody; whether it can be asked (glibc can).

    Takes milliseconds, with a heap of some 100 MB in pieces up to 20.
    """
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        return False
    trim(ctypes.c_size_t(0))
    return True
