"""What right messages say: address, altitude, callsign, position, speed, squawk (ICAO Doc 9871; RTCA DO-260B)."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from motes.applications.mode_s.parity import Verdict, number

LETTERS = "#ABCDEFGHIJKLMNOPQRSTUVWXYZ##### ###############0123456789######"
ZONES = 15
"""Zones of latitude between the equator and a pole of compact positions."""
APART = 20
"""Samples within which two preambles are of one message."""
TOGETHER = 10.0
"""Seconds within which an even and an odd position belong together."""


class Message(NamedTuple):
    """A message.

    Attributes:
        sample: of its preamble.
        kind: format.
        address: of the aircraft, 24 bits.
        bits: of the message.
        altitude: feet; None where it tells none.
        callsign: or "".
        squawk: four digits, or "".
        compact: position as it is sent: whether it is an odd one, latitude, longitude of 17 bits; None where it tells none.
        velocity: knots to the east and to the north; None where it tells none.
    """

    sample: int
    kind: int
    address: int
    bits: np.ndarray
    altitude: int | None = None
    callsign: str = ""
    squawk: str = ""
    compact: tuple[int, int, int] | None = None
    velocity: tuple[int, int] | None = None

    def __str__(self) -> str:
        """Spell it."""
        told = [f"{self.address:06x}", f"format {self.kind}"]
        told += [self.callsign] * bool(self.callsign) + [f"squawk {self.squawk}"] * bool(self.squawk)
        told += [f"{self.altitude} ft"] * (self.altitude is not None)
        if self.velocity is not None:
            told.append(f"{np.hypot(*self.velocity):.0f} kt")
        return ", ".join(told)


def right(found: Iterable[tuple[int, Verdict]]) -> list[Message]:
    """Return the messages that are right, each once, in the order of their preambles.

    Args:
        found: the first sample of each preamble, and what the parity says.
    """
    verdicts = sorted(found, key=lambda row: row[0])
    known = {verdict.address for _, verdict in verdicts if verdict.certain}
    return once([message(sample, verdict) for sample, verdict in verdicts if verdict.address in known])


def once(messages: Iterable[Message]) -> list[Message]:
    """Return messages in the order of their preambles, of those that two preambles gave the first."""
    kept: list[Message] = []
    for one in sorted(messages, key=lambda one: one.sample):
        if not kept or one.sample - kept[-1].sample > APART:
            kept.append(one)
    return kept


def message(sample: int, verdict: Verdict) -> Message:
    """Return what a message says."""
    bits, kind = verdict.bits, verdict.kind
    plain = Message(sample, kind, verdict.address, bits)
    if kind in (0, 4, 16, 20):
        return plain._replace(altitude=_altitude(bits[19:32], 6))
    if kind in (5, 21):
        return plain._replace(squawk=_squawk(bits[19:32]))
    # of format 18 some codes mean other fields
    return _extended(plain, bits[32:88]) if kind == 17 or (kind == 18 and number(bits[5:8]) not in (3, 4)) else plain


def positions(messages: Iterable[Message], rate: float) -> dict[int, tuple[float, float]]:
    """Return the last latitude and longitude of each aircraft, degrees, that an even and an odd message agree on.

    Args:
        messages: in order.
        rate: samples a second.
    """
    last: dict[tuple[int, int], Message] = {}
    found = {}
    for one in messages:
        if one.compact is None:
            continue
        last[one.address, one.compact[0]] = one
        other = last.get((one.address, 1 - one.compact[0]))
        if other is not None and one.compact[0] != other.compact[0] and one.sample - other.sample < TOGETHER * rate:  # type: ignore[index]
            place = position(one.compact, other.compact)  # type: ignore[arg-type]
            found |= {} if place is None else {one.address: place}
    return found


def position(new: tuple[int, int, int], old: tuple[int, int, int]) -> tuple[float, float] | None:
    """Return latitude and longitude, degrees, of the newer of an even and an odd compact position; None where their zones differ."""
    even, odd = (old, new) if new[0] else (new, old)
    scale = 2.0**17
    zone = np.floor((59 * even[1] - 60 * odd[1]) / scale + 0.5)
    latitudes = [_signed(360 / (4 * ZONES - is_odd) * (zone % (4 * ZONES - is_odd) + each[1] / scale))
                 for is_odd, each in ((0, even), (1, odd))]  # fmt: skip
    if any(abs(latitude) > 90 for latitude in latitudes) or zones_of(latitudes[0]) != zones_of(latitudes[1]):
        return None
    latitude, count = latitudes[new[0]], zones_of(latitudes[new[0]])
    turn = np.floor((even[2] * (count - 1) - odd[2] * count) / scale + 0.5)
    width = max(count - new[0], 1)
    return float(latitude), float(_signed(360 / width * (turn % width + new[2] / scale)))


def compacted(latitude: float, longitude: float, is_odd: int) -> tuple[int, int, int]:
    """Return a position, degrees, as it is sent."""
    width = 360 / (4 * ZONES - is_odd)
    y = int(np.floor(2.0**17 * (latitude % width) / width + 0.5))
    own = width * (y / 2.0**17 + np.floor(latitude / width))
    width = 360 / max(zones_of(own) - is_odd, 1)
    return is_odd, y % 2**17, int(np.floor(2.0**17 * (longitude % width) / width + 0.5)) % 2**17


def zones_of(latitude: float) -> int:
    """Return the number of zones of longitude at a latitude, degrees."""
    if abs(latitude) >= 87:
        return 1 if abs(latitude) > 87 else 2
    if latitude == 0:
        return 59
    inner = 1 - (1 - np.cos(np.pi / (2 * ZONES))) / np.cos(np.radians(latitude)) ** 2
    return int(np.floor(2 * np.pi / np.arccos(inner)))


def _signed(degrees: float) -> float:
    return degrees - 360 if degrees >= 180 else degrees


def _extended(plain: Message, bits: np.ndarray) -> Message:
    """Read the 56 bits of an extended squitter."""
    code = number(bits[:5])
    if 1 <= code <= 4:
        return plain._replace(callsign="".join(LETTERS[number(bits[k : k + 6])] for k in range(8, 56, 6)).strip(" #"))
    if 9 <= code <= 18 or 20 <= code <= 22:
        # those from 20 on tell a height of satellites, in meters
        altitude = _altitude(bits[8:20], None) if code <= 18 else None
        return plain._replace(altitude=altitude, compact=(int(bits[21]), number(bits[22:39]), number(bits[39:56])))
    if code == 19 and number(bits[5:8]) in (1, 2):
        scale, told = (4 if number(bits[5:8]) == 2 else 1), [number(bits[sign + 1 : sign + 11]) for sign in (13, 24)]
        east, north = ((-scale if bits[sign] else scale) * (size - 1) for sign, size in zip((13, 24), told, strict=True))
        return plain._replace(velocity=(east, north) if all(told) else None)
    return plain


def _altitude(bits: np.ndarray, metric: int | None) -> int | None:
    """Read an altitude in steps of 25 feet, of 12 bits, or of 13 with the place of the one that says meters; None of other codes."""
    if metric is not None:
        if bits[metric]:
            return None
        bits = np.delete(bits, metric)
    return 25 * number(np.delete(bits, 7)) - 1000 if bits[7] else None


def _squawk(bits: np.ndarray) -> str:
    """Read an identity of four octal digits, whose bits come mixed: C1 A1 C2 A2 C4 A4 - B1 D1 B2 D2 B4 D4."""
    places = {"A": (1, 3, 5), "B": (7, 9, 11), "C": (0, 2, 4), "D": (8, 10, 12)}
    return "".join(str(sum(int(bits[place]) << k for k, place in enumerate(places[digit]))) for digit in "ABCD")
