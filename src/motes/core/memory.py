"""Memory that is given back to the system."""

import ctypes
from functools import cache
from typing import Any


def give_back() -> None:
    """Give back what was freed and is still held, where the C library can: after a program was compiled that is a great part of it."""
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Any:
    """Return glibc's `malloc_trim`; None of other libraries."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):
        return None
