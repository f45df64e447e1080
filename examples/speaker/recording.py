"""Recordings of a room: WAV files with a channel for each microphone."""

import struct
import warnings
from pathlib import Path

import numpy as np
from delays import BAND, FRAME
from room import Room
from scipy.io import wavfile

import motes as mo


def read_wav(path: str | Path, room: Room) -> tuple[np.ndarray, int]:
    """Return the samples `(s, channels)` of a WAV file and its rate, any that can carry the band.

    Raises:
        FileError: it is no WAV file, its channels are not the room's, or its rate or length is too low.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wavfile.WavFileWarning)  # chunks beside the sound
            rate, samples = wavfile.read(path)
    except (OSError, ValueError, ArithmeticError, struct.error, UnboundLocalError) as error:  # the reader meets damage in all these ways
        raise mo.FileError(f"{path}: expected a WAV file, got {error}") from None
    samples = np.atleast_2d(samples.T).T
    if samples.shape[1] != room.channels:
        expected = f"{room.channels} channels, two for each of the pairs {', '.join(room.names)}"
        raise mo.FileError(f"{path}: expected {expected}, got {samples.shape[1]}. Describe your room with --room FILE")
    if rate < 2 * BAND[1]:
        raise mo.FileError(f"{path}: expected {2 * BAND[1]:.0f} samples a second at least, got {rate}")
    if len(samples) < FRAME * rate:
        raise mo.FileError(f"{path}: expected a frame of {1000 * FRAME:.0f} ms at least, got {1000 * len(samples) / rate:.0f} ms")
    if not np.isfinite(samples).all():
        raise mo.FileError(f"{path}: expected finite samples, got NaN or infinity")
    samples = samples - (128.0 if samples.dtype == np.uint8 else 0.0)
    if not samples.any():
        raise mo.FileError(f"{path}: expected sound, got silence in all channels")
    return samples, rate
