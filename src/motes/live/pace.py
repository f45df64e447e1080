"""The time that a step may take: how many particles fit it, and a smaller number where steps keep running late."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from motes.core import settings
from motes.core.checks import MotesError
from motes.core.record import replace
from motes.costs.measure import StepTime
from motes.filters.interface import Filter
from motes.filters.stream import Stream
from motes.live.counts import LOG

SHARE = 0.5
"""Of the budget that the usual step is to take: the rest is for those that take longer, and for what comes in and goes out."""
TRIED = (500, 8_000)
"""Particles with which steps are timed."""
STEPS, WARM = 40, 3
"""Steps that are timed, and those before them."""
FEWEST, MOST = 32, 1_000_000
LANES = 16
LOOKED_AT = 200
"""Steps over which it is judged whether they run late."""
LATE = 0.1
"""Share of them that may."""
SMALLER = 2
"""By how much a number of particles becomes smaller."""


def timed(filter: Filter, begin: Callable[[Filter], Stream], y: Any, u: Any) -> float:
    """Return the median seconds of a step of a stream."""
    stream = begin(replace(filter, on_collapse="predict"))
    taken = []
    stream.update(y)
    for _ in range(WARM + STEPS):
        began = time.perf_counter()
        stream.predict(u)
        info = stream.update(y)
        jax.block_until_ready((info, stream.mean))
        taken.append(time.perf_counter() - began)
    return float(np.median(taken[WARM:]))


def fitting(filter: Filter, begin: Callable[[Filter], Stream], y: Any, u: Any, budget: float) -> Filter:
    """Return a filter with as many particles as a budget allows on this machine: a line through the times of steps of a stream.

    Args:
        filter: whose number of particles is sought.
        begin: begins a stream of a filter.
        y: a measurement.
        u: inputs of a step.
        budget: seconds.
    """
    try:
        times = tuple((n, timed(filter.with_particles(n), begin, y, u)) for n in TRIED)
        if times[-1][1] <= times[0][1]:
            # what a step takes besides hides what particles take: as many as were tried, where that fits
            n = TRIED[-1] if times[-1][1] <= SHARE * budget else TRIED[0]
            told = dict(times)[n]
        else:
            line = StepTime.fitted(times)
            n = int(min(max(line.particles(SHARE * budget), FEWEST), MOST))
            n -= n % LANES if n > LANES else 0
            told = line.seconds(n)
    except MotesError as reason:
        LOG.warning("budget: %s; it begins with %d particles.", str(reason).rstrip("."), filter.fixed_count)
        return filter
    LOG.info("budget %.3g ms: %d particles, whose step takes %.3g ms.", 1e3 * budget, n, 1e3 * told)
    return filter.with_particles(n)


class Pace:
    """Watches over the times of steps, and has a smaller size compiled ahead."""

    def __init__(self, budget: float, compiled: Callable[[Filter], None]):
        """Watch over a budget, seconds.

        Args:
            budget: seconds.
            compiled: compiles the steps of a filter; called by a thread.
        """
        self.budget, self._compiled = budget, compiled
        self._last: deque[bool] = deque(maxlen=LOOKED_AT)
        self._warned = False
        self._next: Filter | None = None
        self._thread: threading.Thread | None = None

    def ahead(self, filter: Filter) -> None:
        """Have the next smaller size of a filter compiled, in a thread of its own."""
        n = filter.fixed_count
        self._next = self._thread = None
        self._last.clear()
        self._warned = False
        if n is not None and n // SMALLER >= FEWEST:
            self._next = filter.with_particles(n // SMALLER)
            self._thread = threading.Thread(target=self._work, args=(self._next, settings.in_force()), daemon=True)
            self._thread.start()

    def _work(self, filter: Filter, in_force: settings.Settings) -> None:
        with settings.enforced(in_force):
            self._compiled(filter)

    def taken(self, seconds: float) -> Filter | None:
        """Note the time of a step; return a smaller filter where steps keep running late and it is ready."""
        compiling = self._thread is not None and self._thread.is_alive()
        # what the compiler disturbs is not the filter's fault
        if compiling:
            return None
        self._last.append(seconds > self.budget)
        if len(self._last) < LOOKED_AT or sum(self._last) <= LATE * LOOKED_AT:
            return None
        share = 100 * sum(self._last) / LOOKED_AT
        self._last.clear()
        if not self._warned:
            self._warned = True
            LOG.warning("budget: %.0f percent of the last %d steps took longer than %.3g ms%s.", share, LOOKED_AT, 1e3 * self.budget,
                        "; fewer particles are taken if it goes on" if self._next is not None else "")  # fmt: skip
            return None
        return self._next
