"""The parity of a message, which judges it: 24 bits that a polynomial makes of the others (ICAO Annex 10, volume IV).

Squitters (formats 11, 17, 18) tell their address, and their parity stands alone, of format 11 with the code of an interrogator laid over
it. Answers lay their address over the parity: of these are right those whose address a squitter has told.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_POLYNOMIAL = 0x1FFF409
_SQUITTERS, _ALL_CALL = (17, 18), 11
_ANSWERS = (0, 4, 5, 16, 20, 21)
_CODES = 80
"""Codes of interrogators."""


class Verdict(NamedTuple):
    """What the parity says of a message.

    Attributes:
        kind: its format.
        bits: those of the message, `(56,)` or `(112,)`.
        address: of the aircraft; what is laid over the parity of an answer.
        certain: whether the parity alone shows that the message is right.
    """

    kind: int
    bits: np.ndarray
    address: int
    certain: bool


def number(bits: Sequence[int] | np.ndarray) -> int:
    """Return what bits spell, the highest first."""
    return int("".join("1" if bit else "0" for bit in bits), 2)


def remainder(bits: np.ndarray) -> int:
    """Return what is left of a message by the polynomial: 0 where the parity, its last 24 bits, is that of the others."""
    left = number(bits)
    for place in range(len(bits) - 1, 23, -1):
        if left >> place & 1:
            left ^= _POLYNOMIAL << (place - 24)
    return left


def with_parity(bits: Sequence[int] | np.ndarray, overlay: int = 0) -> np.ndarray:
    """Return a message with its 24 bits of parity, over which something may be laid."""
    parity = remainder(np.concatenate([bits, np.zeros(24, int)])) ^ overlay
    return np.concatenate([bits, [(parity >> place) & 1 for place in range(23, -1, -1)]]).astype(int)


def is_long(bits: np.ndarray) -> bool:
    """Tell by the format whether a message has 112 bits, not 56."""
    return number(bits[:5]) >= 16


def judged(bits: np.ndarray) -> Verdict | None:
    """Judge 112 bits, of which a short message takes the first half; None of what is no message."""
    kind = number(bits[:5])
    own = bits if is_long(bits) else bits[: len(bits) // 2]
    if kind in _ANSWERS:
        return Verdict(kind, own, remainder(own), certain=False)
    right = remainder(own) < _CODES if kind == _ALL_CALL else kind in _SQUITTERS and remainder(own) == 0
    return Verdict(kind, own, number(own[8:32]), certain=True) if right else None
