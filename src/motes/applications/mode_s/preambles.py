"""Where a message begins: the four pulses of a preamble, with their timing, amplitude, phase and frequency.

A message begins with pulses of half a microsecond, one sample, at 0, 1, 3.5 and 4.5 microseconds, and its bits follow from 8 on: a pulse
in the first half of a microsecond is a one, in the second a zero. Pulses begin between two samples: a share of the energy of each falls
into the next sample. For each of seven such shares the pulses are fitted with a complex amplitude that turns at a frequency found by a
Fourier transform of the 16 samples; a preamble is where the fit explains more of the energy than it does one sample before and after.
"""

from typing import NamedTuple

import numpy as np

PULSES = (0, 2, 7, 9)
"""Samples in which the pulses of a preamble begin."""
HEAD, BITS = 16, 112
LONGEST = HEAD + 2 * BITS + 1
"""Samples of a preamble and a long message, and one that the last pulse may reach into."""
SHIFTS = np.linspace(0.0, 0.85, 7)
"""Where pulses begin, in samples after the one that they are counted by."""
TURNS = 128
"""Frequencies that are tried."""
LEAST = 12.0
"""Energy of the pulses below which nothing is decoded, in units of the noise's power: 4.8 dB a pulse."""


class Preambles(NamedTuple):
    """What was found, one row each.

    Attributes:
        sample: the first sample of the preamble.
        shift: see `SHIFTS`.
        amplitude: complex, of a pulse at the first sample.
        turn: of the phase, radians a sample.
        share: of the energy of the 16 samples, what is explained.
        excess: power of what is not explained, a sample.
    """

    sample: np.ndarray
    shift: np.ndarray
    amplitude: np.ndarray
    turn: np.ndarray
    share: np.ndarray
    excess: np.ndarray


def noise_power(samples: np.ndarray) -> float:
    """Return the power of the noise a sample, from the median magnitude: most samples are of noise alone."""
    return float(np.median(np.abs(samples)) ** 2 / np.log(2))


def find(samples: np.ndarray, least_share: float) -> Preambles:
    """Find preambles.

    Args:
        samples: complex, `(t,)`.
        least_share: see `Settings`.
    """
    count, least = max(len(samples) - LONGEST + 1, 0), LEAST * noise_power(samples)
    power = np.abs(samples) ** 2
    total = np.convolve(power, np.ones(HEAD), "valid")[:count]
    # a fit explains no more than lies in the samples that its pulses reach
    reached = sum(power[k : k + count] + power[k + 1 : k + 1 + count] for k in PULSES)
    strong = np.flatnonzero((reached > least_share * total) & (reached > least))
    fits = [_explained(samples[strong[:, None] + np.arange(HEAD)], shift) for shift in SHIFTS]
    energy = np.stack([fit[0] for fit in fits])
    best, rows = energy.argmax(axis=0), np.arange(len(strong))
    amplitude, turn = (np.stack([fit[place] for fit in fits])[best, rows] for place in (1, 2))
    energy = energy[best, rows]
    share = np.zeros(count + 2)
    share[strong + 1] = energy / np.maximum(total[strong], np.finfo(np.float32).tiny)
    here = share[strong + 1]
    kept = (here > least_share) & (energy > least) & (here >= share[strong]) & (here >= share[strong + 2])
    excess = (total[strong] - energy) / HEAD
    return Preambles(*(column[kept] for column in (strong, SHIFTS[best], amplitude, turn, here, excess)))


def pulses(shift: float) -> np.ndarray:
    """Return how much of each of the 16 samples the pulses of a preamble fill."""
    filled = np.zeros(HEAD)
    for k in PULSES:
        filled[k] += 1 - shift
        filled[k + 1] += shift
    return filled


def _explained(windows: np.ndarray, shift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit pulses of one shift to windows `(k, 16)`: energy explained, complex amplitude, turn of the phase."""
    filled = pulses(shift)
    spectrum = np.fft.fft(windows * filled, TURNS, axis=1)
    at = np.abs(spectrum).argmax(axis=1)
    peak = spectrum[np.arange(len(windows)), at]
    turn = 2 * np.pi * np.where(at < TURNS // 2, at, at - TURNS) / TURNS
    return np.abs(peak) ** 2 / np.sum(filled**2), peak / np.sum(filled**2), turn
