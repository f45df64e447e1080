"""Times taken in turns, so that a neighbor on the machine disturbs all filters alike, and numbers of particles that take the same time."""

from collections.abc import Iterable
from typing import NamedTuple

from printed import PLAIN
from scenario import STEPS, make_filter, model

import motes as mo

WITHIN, CORRECTIONS = 0.05, 3
"""Times that differ by less than this share are equal; how often numbers of particles are corrected that do not have them."""
AROUND = (0.7, 1.0, 1.6)
"""Times are taken at these shares of the plain filter's number of particles."""

Point = tuple[str, int]
"""A partition and its number of particles."""


class Matched(NamedTuple):
    """Numbers of particles with the same time per step, and the seconds that were then measured."""

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
            least[name, n] = min(least[name, n], mo.costs.seconds_per_step(make_filter(name, n), radar, ys))
    return least


def matched(partitions: tuple[str, ...], n: int, turns: int) -> Matched:
    """Find the numbers of particles whose steps take as long as those of the plain filter with n.

    They are read off the lines through three times of each partition, measured, and corrected where they are off by 5 percent: times have
    steps where a block of work is full. What is returned is measured at the numbers that are returned, and shows how well they are met.
    """
    around = tuple(round(n * share) for share in AROUND)
    times = in_turns([(name, size) for name in partitions for size in around], turns)
    lines = {name: mo.costs.StepTime.fitted(tuple((size, times[name, size]) for size in around)) for name in partitions}
    budget = lines[PLAIN].seconds(n)
    sizes = {name: n if name == PLAIN else _even(lines[name].particles(budget)) for name in partitions}
    found = in_turns(sizes.items(), turns)
    for _ in range(CORRECTIONS):
        shares = {name: found[name, size] / found[PLAIN, n] for name, size in sizes.items()}
        if all(abs(share - 1) < WITHIN for share in shares.values()):
            break
        sizes = {name: size if abs(shares[name] - 1) < WITHIN else _even(size / shares[name]) for name, size in sizes.items()}
        found = in_turns(sizes.items(), turns)
    return Matched(sizes, {name: found[name, size] for name, size in sizes.items()})


def _even(n: float) -> int:
    """Odd numbers of particles take up to half as long again on the JAX engine."""
    return 2 * round(n / 2)
