"""From sound to delays: frames, and each pair's cross-correlation by phase alone (GCC-PHAT: Knapp, Carter 1976)."""

from typing import NamedTuple

import numpy as np

FRAME = 0.032
"""Seconds."""
BAND = (200.0, 4000.0)
"""Hz."""
UNIT = 1 / 16_000
"""Seconds that delays are counted in: samples of 16 kHz, whatever the rate of a recording."""
STEPS = 4
"""Lags that are tried in one unit."""
PEAKS = 3
SILENT, FADES = 18.0, 3.0
"""A frame is silent where it is so many decibels below the loudest so far, which is forgotten by so many a second."""
RECENT = 1 / 16
"""Share of a frame in the running mean of correlations."""


class Heard(NamedTuple):
    """What is made of a recording, by frames.

    Attributes:
        correlation: of each pair over lags, 1 where all phases fit, `(t, pairs, lags)`.
        recent: running mean of those that are not silent, this one included.
        sound: whether the frame is not silent, bool `(t,)`.
    """

    correlation: np.ndarray
    recent: np.ndarray
    sound: np.ndarray


def correlated(recording: np.ndarray, rate: int, longest: int) -> Heard:
    """Cut a recording into frames and correlate the channels of each pair.

    Args:
        recording: samples `(s, channels)`, two channels for each pair.
        rate: samples per second.
        longest: largest lag, units.
    """
    size = round(FRAME * rate)
    count, channels = len(recording) // size, recording.shape[1]
    frames = recording[: count * size].reshape(count, size, channels).transpose(0, 2, 1) * np.hanning(size)
    frequencies = np.fft.rfftfreq(2 * size, 1 / rate)
    inside = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    spectra = np.fft.rfft(frames, 2 * size)[..., inside]
    cross = spectra[:, 1::2] * spectra[:, ::2].conj()
    phases = cross / np.maximum(np.abs(cross), np.finfo(float).tiny)
    lags = np.arange(-longest * STEPS, longest * STEPS + 1) * UNIT / STEPS
    # a transform at the lags that a pair can have, which the rate of the recording does not change
    turns = np.exp(2j * np.pi * frequencies[inside][:, None] * lags)
    correlation = ((phases @ turns).real / inside.sum()).astype(np.float32)
    sound = sounding((np.abs(spectra) ** 2).mean(axis=(1, 2)))
    return Heard(correlation, running_mean(correlation, sound), sound)


def sounding(power: np.ndarray) -> np.ndarray:
    """Tell of the power of frames `(t,)` which are not silent."""
    level = 10 * np.log10(np.maximum(power, np.finfo(float).tiny))
    faded = FADES * FRAME * np.arange(len(level))
    return (power > 0) & (level > np.maximum.accumulate(level + faded) - faded - SILENT)


def running_mean(correlation: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Return the running mean of correlations `(t, pairs, lags)` over frames with sound."""
    mean, found = np.zeros_like(correlation[0]), np.empty_like(correlation)
    for step, frame in enumerate(correlation):
        if sound[step]:
            mean = mean + RECENT * (frame - mean)
        found[step] = mean
    return found


def peaks(correlation: np.ndarray) -> np.ndarray:
    """Return the lags of the largest local maxima of correlations `(..., lags)`, units, `(..., PEAKS)`; NaN where there are fewer."""
    ends = np.full((*correlation.shape[:-1], 1), -np.inf, correlation.dtype)
    padded = np.concatenate([ends, correlation, ends], axis=-1)
    top = (correlation >= padded[..., :-2]) & (correlation > padded[..., 2:])
    height = np.where(top, correlation, -np.inf)
    best = np.argsort(-height, axis=-1)[..., :PEAKS]
    there = np.isfinite(np.take_along_axis(height, best, -1))
    return np.where(there, (best - correlation.shape[-1] // 2) / STEPS, np.nan).astype(np.float32)
