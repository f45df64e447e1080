"""A voice that is nobody's, and a walk: bursts like syllables, voiced and unvoiced, with pauses between phrases.

It has what matters to delays (a broad spectrum that changes, harmonics, pauses) and says nothing.
"""

import numpy as np
from scipy.signal import lfilter

VOWELS = ((730, 1090, 2440), (270, 2290, 3010), (300, 870, 2240), (530, 1840, 2480), (570, 840, 2410))
"""First three formants, Hz (Peterson, Barney 1952)."""
HIGHER = (3500, 4500)
"""Formants that all vowels share, Hz."""
BREADTHS = (80, 100, 140, 200, 250)
"""Breadths of formants, Hz."""
UNVOICED = 0.25
"""Share of syllables that are noise."""
MARGIN = 0.5
"""Meters that the speaker keeps from walls."""


def voice(rng: np.random.Generator, seconds: float, rate: int) -> np.ndarray:
    """Return samples of phrases of 1 to 2.5 seconds with pauses of 0.3 to 1 second."""
    found, count = [], 0
    while count < seconds * rate:
        phrase = [syllable(rng, rate, pitch) for pitch in rng.uniform(90, 220) * np.linspace(1.1, 0.85, rng.integers(5, 12))]
        found += [*phrase, np.zeros(int(rate * rng.uniform(0.3, 1.0)))]
        count = sum(map(len, found))
    return np.concatenate(found)[: int(seconds * rate)]


def syllable(rng: np.random.Generator, rate: int, pitch: float) -> np.ndarray:
    """Return a syllable: pulses of a pitch, Hz, through a vowel's formants, or noise with more of the high frequencies."""
    length = int(rate * rng.uniform(0.12, 0.28))
    if rng.uniform() < UNVOICED:
        sound = 0.3 * np.diff(rng.normal(size=length + 1))
    else:
        turns = np.cumsum(pitch / rate * (1 + 0.03 * np.sin(2 * np.pi * 5 * np.arange(length) / rate)))
        # the pulses of the glottis fall by 6 dB an octave, what lips radiate included
        sound = lfilter([1], [1, -np.exp(-2 * np.pi * 200 / rate)], np.diff(np.floor(turns), prepend=0) + 0.02 * rng.normal(size=length))
        for middle, breadth in zip(VOWELS[rng.integers(len(VOWELS))] + HIGHER, BREADTHS, strict=True):
            radius = np.exp(-np.pi * breadth / rate)
            poles = [1, -2 * radius * np.cos(2 * np.pi * middle / rate), radius**2]
            sound = lfilter([sum(poles)], poles, sound)
    return rng.uniform(0.5, 1.0) * np.hanning(length) ** 0.5 * sound / sound.std()


def walk(rng: np.random.Generator, size: np.ndarray, step: float, steps: int) -> np.ndarray:
    """Return places `(steps, 2)`, so many seconds apart, of somebody who walks from place to place at 0.4 to 1 m/s and stands there."""
    place, found = rng.uniform(MARGIN, size[:2] - MARGIN), []
    while len(found) < steps:
        goal = rng.uniform(MARGIN, size[:2] - MARGIN)
        count = 1 + int(np.linalg.norm(goal - place) / (rng.uniform(0.4, 1.0) * step))
        found += [*(place + (goal - place) * np.linspace(0, 1, count)[:, None]), *[goal] * int(rng.uniform(0.2, 1.5) / step)]
        place = goal
    # nobody turns on the spot
    smooth = np.hanning(round(0.8 / step))
    track = np.pad(found[:steps], ((len(smooth) // 2, len(smooth) - 1 - len(smooth) // 2), (0, 0)), mode="edge")
    return np.stack([np.convolve(axis, smooth / smooth.sum(), "valid") for axis in track.T], axis=1)
