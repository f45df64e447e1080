"""The usual detector: magnitudes alone, as the program dump1090 has it: a bit is one where its first half is the stronger."""

import numpy as np

from motes.applications.mode_s.messages import Message, right
from motes.applications.mode_s.parity import judged
from motes.applications.mode_s.preambles import BITS, HEAD, LONGEST


def detected(samples: np.ndarray) -> list[Message]:
    """Return the right messages that magnitudes alone give of complex samples `(t,)`."""
    size = np.abs(samples)
    starts = _preambles(size)
    halves = size[starts[:, None] + HEAD + np.arange(2 * BITS)].reshape(-1, BITS, 2)
    found = ((int(start), judged(bits)) for start, bits in zip(starts, halves[..., 0] > halves[..., 1], strict=True))
    return right((start, verdict) for start, verdict in found if verdict is not None)


def _preambles(size: np.ndarray) -> np.ndarray:
    """Return the samples at which magnitudes rise and fall as the four pulses do, with silence between and after them."""
    count = max(len(size) - LONGEST + 1, 0)
    at = [size[k : k + count] for k in range(15)]
    rising = ((1, 0), (1, 2), (3, 2), (3, 0), (4, 0), (5, 0), (6, 0), (8, 7), (8, 9), (6, 9))
    fits = np.logical_and.reduce([at[low] < at[high] for low, high in rising])
    level = (at[0] + at[2] + at[7] + at[9]) / 6
    return np.flatnonzero(fits & np.logical_and.reduce([at[k] < level for k in (4, 5, 11, 12, 13, 14)]))
