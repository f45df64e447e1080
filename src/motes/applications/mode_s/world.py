"""A made-up recording: aircraft that tell who and where they are, in the noise of a receiver that samples twice a microsecond."""

from typing import NamedTuple

import numpy as np

from motes.applications.mode_s.messages import LETTERS, compacted
from motes.applications.mode_s.parity import with_parity
from motes.applications.mode_s.preambles import HEAD, LONGEST, PULSES
from motes.applications.mode_s.recording import RATE
from motes.core import checks

NOISE = 3.0
"""Root mean square of the noise of a sample, in steps of the receiver."""
LATEST = 0.3
"""Samples by which pulses begin after a sample at most: half-way between two of them a bit is told by its difference from the last alone,
and 15 dB do not do."""
MOST_AIRCRAFT = 1000
OFFSET = 60e3
"""Standard deviation of the carriers about 1 090 MHz, hertz."""
GAP = 600
"""Samples of silence between messages, on average beyond the shortest."""
EDGE = 0.05
"""Share of a pulse that a receiver's filter moves into each of the samples beside it."""


class World(NamedTuple):
    """A recording, and what was sent.

    Attributes:
        samples: complex, `(t,)`.
        sent: the first sample of each message, and its bits.
    """

    samples: np.ndarray
    sent: tuple[tuple[int, np.ndarray], ...]


def received(seed: int, aircraft: int, seconds: float, snr: float) -> World:
    """Make a recording.

    Args:
        seed: of all that is drawn.
        aircraft: number of them.
        seconds: length.
        snr: energy of a pulse over the noise of a sample, dB.

    Raises:
        MotesError: a number cannot be used.
    """
    checks.positive_integer("aircraft", aircraft)
    if aircraft > MOST_AIRCRAFT:
        checks.refuse("aircraft", f"at most {MOST_AIRCRAFT}", aircraft)
    if not 0.002 <= seconds <= 60:
        checks.refuse("seconds", "between 0.002 and 60", seconds)
    if not -30 <= snr <= 100:
        checks.refuse("snr", "between -30 and 100 dB", snr)
    rng = np.random.default_rng(seed)
    addresses = rng.choice(2**24 - 2, aircraft, replace=False) + 1
    height = NOISE * 10 ** (snr / 20)
    turns, shifts = 2 * np.pi * OFFSET / RATE * rng.standard_normal(aircraft), rng.uniform(0, LATEST, aircraft)
    says = [_sayings(rng, int(address)) for address in addresses]
    count = int(seconds * RATE)
    samples = NOISE / np.sqrt(2) * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
    sent, at, number = [], 20, 0
    while at + LONGEST + 4 < count:
        # an aircraft tells its address before it answers
        who = number % aircraft
        bits = says[who][number // aircraft % len(says[who])]
        wave = _rendered(bits, shifts[who])
        phase = rng.uniform(0, 2 * np.pi) + turns[who] * np.arange(len(wave))
        samples[at : at + len(wave)] += height * wave * np.exp(1j * phase)
        # what the filter smears begins one sample before the first pulse
        sent.append((at + 1, bits))
        number, at = number + 1, at + len(wave) + 8 + int(rng.exponential(GAP))
    return World(np.round(samples.real) + 1j * np.round(samples.imag), tuple(sent))


def _rendered(bits: np.ndarray, shift: float) -> np.ndarray:
    """Return the heights of a message's samples, the first of them one before its first pulse, whose energy is one."""
    halves = np.zeros(HEAD + 2 * len(bits))
    halves[list(PULSES)] = 1
    halves[HEAD::2], halves[HEAD + 1 :: 2] = bits, 1 - bits
    pulse = np.convolve([1 - shift, shift], [EDGE, 1 - 2 * EDGE, EDGE])
    return np.convolve(halves, pulse / np.linalg.norm(pulse))


def _sayings(rng: np.random.Generator, address: int) -> list[np.ndarray]:
    """Return what an aircraft sends, in turn."""
    name = "".join(rng.choice(list("ABCDEFGHKLMNPRSTUVW"), 3)) + f"{rng.integers(1, 9999)}"
    altitude, squawk = int(rng.integers(40, 480)) * 4 + 40, rng.integers(0, 8, 4)
    latitude, longitude = rng.uniform(-60, 60), rng.uniform(-179, 179)
    told = [_bits(LETTERS.index(letter), 6) for letter in name.ljust(8)]
    speeds = [bit for size in rng.integers(50, 400, 2) for bit in (*_bits(int(rng.integers(0, 2)), 1), *_bits(int(size), 10))]
    fields = [
        [*_bits(4, 5), *_bits(0, 3), *np.concatenate(told)],
        *([*_bits(11, 5), *_bits(0, 3), *_height(altitude), 0, is_odd, *_bits(y, 17), *_bits(x, 17)]
          for is_odd, y, x in (compacted(latitude, longitude, 0), compacted(latitude, longitude, 1))),
        [*_bits(19, 5), *_bits(1, 3), *_bits(0, 5), *speeds, *_bits(0, 21)],
    ]  # fmt: skip
    own = _bits(address, 24)
    squitters = [with_parity(np.array([*_bits(17, 5), *_bits(5, 3), *own, *each])) for each in fields]
    call = with_parity(np.array([*_bits(11, 5), *_bits(5, 3), *own]))
    thirteen = _height(altitude)
    answers = [with_parity(np.array([*_bits(4, 5), *_bits(0, 14), *thirteen[:6], 0, *thirteen[6:]]), address),
               with_parity(np.array([*_bits(5, 5), *_bits(0, 14), *_identity(squawk)]), address),
               with_parity(np.array([*_bits(20, 5), *_bits(0, 14), *thirteen[:6], 0, *thirteen[6:], *rng.integers(0, 2, 56)]), address)]
    return [call, squitters[0], squitters[1], answers[0], squitters[2], answers[1], squitters[3], answers[2]]


def _bits(value: int, count: int) -> list[int]:
    return [(value >> place) & 1 for place in range(count - 1, -1, -1)]


def _height(steps: int) -> list[int]:
    """Spell an altitude of so many steps of 25 feet above -1 000 in 12 bits, the eighth of which says that these are the steps."""
    eleven = _bits(steps, 11)
    return [*eleven[:7], 1, *eleven[7:]]


def _identity(digits: np.ndarray) -> list[int]:
    """Spell four octal digits in 13 bits; see `messages`."""
    a, b, c, d = ([int(digit) >> place & 1 for place in range(3)] for digit in digits)
    return [c[0], a[0], c[1], a[1], c[2], a[2], 0, b[0], d[0], b[1], d[1], b[2], d[2]]
