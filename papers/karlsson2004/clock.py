"""Times taken in turns, so that a neighbor on the machine disturbs all filters alike, and numbers of particles that take the same time."""

from collections.abc import Iterable
from typing import NamedTuple

from printed import PLAIN
from scenario import STEPS, make_filter, model

import motes as mo

WITHIN = 0.05
"""Times that differ by less than this share are equal."""

Point = tuple[str, int]
"""A partition and its number of particles."""


class Matched(NamedTuple):
    """Numbers of particles with the same time per step, and the seconds that were measured last."""

    sizes: dict[str, int]
    seconds: dict[str, float]


def in_turns(points: Iterable[Point], turns: int) -> dict[Point, float]:
    """Measure the seconds of a step for each partition and number of particles: the least of so many turns, of several runs each.

    The data are those of the long range, where the weights of few particles do not all vanish; a step takes as long on any data.
    """
    radar = model("long")
    ys = mo.simulate(0, radar, STEPS)[1]
    least = dict.fromkeys(points, float("inf"))
    for _ in range(turns):
        for name, n in least:
            least[name, n] = min(least[name, n], mo.seconds_per_step(make_filter(name, n), radar, ys))
    return least


def matched(partitions: tuple[str, ...], n: int, turns: int, attempts: int) -> Matched:
    """Find the numbers of particles whose steps take as long as those of the plain filter with n, by measuring, correcting, and again.

    All are measured anew in each attempt; the times that are returned are those of the numbers that are returned. Where not all are within
    5 percent in any attempt, the times of the last one show by how much it is off.
    """
    sizes = dict.fromkeys(partitions, n)
    for attempt in range(attempts):
        times = in_turns(sizes.items(), turns)
        seconds = {name: times[name, size] for name, size in sizes.items()}
        shares = {name: seconds[name] / seconds[PLAIN] for name in sizes}
        if all(abs(share - 1) < WITHIN for share in shares.values()) or attempt == attempts - 1:
            break
        sizes = {name: size if abs(shares[name] - 1) < WITHIN / 2 else round(size / shares[name]) for name, size in sizes.items()}
    return Matched(sizes, seconds)
