"""A room with pairs of microphones, and what they hear of a voice that moves in it: image sources (Allen, Berkley 1979)."""

import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from delays import UNIT

import motes as mo

SOUND = 343.0
"""Meters per second."""
ORDER = 10
"""Most reflections of an image source."""
FINER = 4
"""Arrivals are placed to a fraction of a sample: on a grid so many times finer."""
NOISE = -30.0
"""Noise of a microphone, decibels over what it hears of the voice."""


class Room(NamedTuple):
    """A room and its microphones, meters from one corner.

    Attributes:
        size: length, width and height, `(3,)`.
        mouth: height of the speaker's mouth.
        names: of the pairs of microphones.
        microphones: places, `(pairs, 2, 3)`.
    """

    size: np.ndarray
    mouth: float
    names: tuple[str, ...]
    microphones: np.ndarray

    @property
    def longest(self) -> int:
        """Largest delay between the microphones of any pair, units of `delays.py`, rounded up."""
        return int(np.ceil(np.linalg.norm(np.diff(self.microphones, axis=1), axis=-1).max() / SOUND / UNIT))

    @property
    def channels(self) -> int:
        """Number of microphones."""
        return 2 * len(self.names)


def read_room(path: str | Path) -> Room:
    """Read a room from a file such as `room.toml`.

    Raises:
        FileError: there is no such file, or it does not describe a room.
    """
    try:
        told = tomllib.loads(Path(path).read_text())
        size, microphones = np.array(told["size"], float), np.array(list(told["pairs"].values()), float)
        room = Room(size, float(told["mouth"]), tuple(told["pairs"]), microphones)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise mo.FileError(f"{path}: expected a room as in room.toml, got {type(error).__name__}: {error}") from None
    if size.shape != (3,) or microphones.ndim != 3 or microphones.shape[1:] != (2, 3):
        raise mo.FileError(f"{path}: expected a size of 3 numbers and pairs of 2 places of 3 numbers, got other shapes")
    if not ((microphones >= 0) & (microphones <= size)).all() or not 0 < room.mouth < size[2]:
        raise mo.FileError(f"{path}: expected microphones and mouth inside of the room, got some outside")
    return room


def reflected(room: Room, reverberation: float) -> float:
    """Return the share of the pressure that walls send back, of the time in which sound falls by 60 dB, seconds (Sabine's formula)."""
    x, y, z = room.size
    return float(np.sqrt(1 - 0.161 * x * y * z / (2 * (x * y + y * z + z * x) * reverberation)))


def images(room: Room, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return signs `(k, 3)` and offsets `(k, 3)` that make image sources of a source, and their numbers of reflections `(k,)`."""
    count = np.stack(np.meshgrid(*[np.arange(-order, order + 1)] * 3), axis=-1).reshape(-1, 3)
    count = count[np.abs(count).sum(axis=1) <= order]
    odd = count % 2
    return 1 - 2 * odd, (count + odd) * room.size, np.abs(count).sum(axis=1)


def heard(
    room: Room, voice: np.ndarray, path: np.ndarray, rate: int, reverberation: float, order: int = ORDER, seed: int = 0
) -> np.ndarray:
    """Render what microphones hear of a voice.

    Args:
        room: with its microphones.
        voice: samples `(s,)`.
        path: places of the mouth `(b, 2)`, one for each block of `s / b` samples.
        rate: samples per second.
        reverberation: time in which sound falls by 60 dB, seconds.
        order: most reflections.
        seed: of the noise of the microphones.

    Returns:
        Samples `(s, channels)`.
    """
    hop = len(voice) // len(path)
    signs, offsets, bounces = images(room, order)
    strength = reflected(room, reverberation) ** bounces
    microphones = room.microphones.reshape(-1, 1, 3)
    longest = int(rate * (np.abs(offsets).max() + room.size.sum()) * 3**0.5 / SOUND)
    length = 1 << (2 * hop + longest).bit_length()
    window = np.hanning(2 * hop + 1)[:-1]
    padded = np.pad(voice, (hop, hop))
    sound = np.zeros((len(microphones), len(padded) + length))
    first = FINER * length * np.arange(len(microphones))[:, None]
    for block, place in enumerate(np.pad(path, ((0, 1), (0, 0)), mode="edge")):
        piece = padded[block * hop : (block + 2) * hop] * window
        if not piece.any():
            continue
        away = np.linalg.norm(signs * np.append(place, room.mouth) + offsets - microphones, axis=-1)
        arrives = first + np.rint(FINER * rate * away / SOUND).astype(int)
        response = np.bincount(arrives.ravel(), (strength / away).ravel(), FINER * length * len(microphones))
        # of the finer grid's spectrum, what the rate can carry
        spectrum = np.fft.rfft(response.reshape(len(microphones), -1))[:, : length // 2 + 1]
        sound[:, block * hop : block * hop + length] += np.fft.irfft(spectrum * np.fft.rfft(piece, length), length)
    sound = sound[:, hop : hop + len(voice)].T
    level = 10 ** (NOISE / 20) * sound.std()
    return sound + level * np.random.default_rng(seed).normal(size=sound.shape)
