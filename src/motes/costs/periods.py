"""The sampling period of a particle filter on parallel processing elements, in the model of Bolic, Djuric, Hong 2005.

M particles in K elements: sampling and weighing are pipelined, M / K cycles, and so is resampling, which must wait for the last weight;
L is the latency of the pipeline and L_c that of the exchange: T = (2 M / K + L + L_c) T_clk. Of one element there is no exchange.
"""

import math
import sys

import numpy as np

from motes.core import checks


def sampling_period(particles: int, elements: int = 1, latency: float = 0.0, exchange_latency: float = 0.0, clock: float = 1.0) -> float:
    """Least time between measurements, (2 M / K + L + L_c) T_clk.

    Source: Bolic, Djuric, Hong 2005, Resampling algorithms and architectures for distributed particle filters.

    Example:
        >>> mo.sampling_period(1024, elements=4, latency=50, exchange_latency=20)
        582.0
        >>> mo.sampling_period(1024, latency=50)
        2098.0

    Args:
        particles: M, of all elements together.
        elements: K.
        latency: L, cycles until the first particle has gone through.
        exchange_latency: L_c, cycles of the exchange; those of a ring (RNA) are the same at each step, those of proportional allocation
            (RPA) up to about M / K. One element has none.
        clock: seconds of a cycle; 1 for the answer in cycles.

    Raises:
        MotesError: a number is not a possible one.
    """
    checks.positive_integer("sampling_period particles", particles)
    checks.positive_integer("sampling_period elements", elements)
    return (2 * particles / elements + _waiting("sampling_period", elements, latency, exchange_latency, clock)) * clock


def elements_for_period(period: float, particles: int, latency: float = 0.0, exchange_latency: float = 0.0, clock: float = 1.0) -> int:
    """Return the least number of elements that keeps a sampling period; the inverse of `sampling_period`, whose arguments these are.

    Args:
        period: seconds between measurements (cycles where clock is 1).
        particles: M.
        latency: L.
        exchange_latency: L_c.
        clock: seconds of a cycle.

    Raises:
        MotesError: no number of elements does.
    """
    checks.above_zero("elements_for_period period", period)
    numbers = (latency, exchange_latency, clock)
    if sampling_period(particles, 1, *numbers) <= period:
        return 1
    left = period / clock - _waiting("elements_for_period", 2, *numbers)
    if left <= 0:
        least = (latency + exchange_latency) * clock
        checks.refuse("elements_for_period period", f"more than {least:.3g}, the latencies alone", f"{period:.3g}")
    found = max(2, math.ceil(2 * particles / left))
    # by what is rounded it may be one too many, or too few
    if found > 2 and sampling_period(particles, found - 1, *numbers) <= period:
        return found - 1
    return found + (sampling_period(particles, found, *numbers) > period)


def particles_for_period(period: float, elements: int = 1, latency: float = 0.0, exchange_latency: float = 0.0, clock: float = 1.0) -> int:
    """Return the largest number of particles, a multiple of that of elements, that keeps a sampling period; see `elements_for_period`.

    Args:
        period: seconds between measurements (cycles where clock is 1).
        elements: K.
        latency: L.
        exchange_latency: L_c.
        clock: seconds of a cycle.

    Raises:
        MotesError: not even one particle for each element does.
    """
    checks.positive_integer("particles_for_period elements", elements)
    checks.above_zero("particles_for_period period", period, sys.float_info.max)
    numbers = (latency, exchange_latency, clock)
    each = math.floor((period / clock - _waiting("particles_for_period", elements, *numbers)) / 2)
    # by what is rounded it may be one too few, or too many
    if each >= 0 and sampling_period((each + 1) * elements, elements, *numbers) <= period:
        each += 1
    elif each >= 1 and sampling_period(each * elements, elements, *numbers) > period:
        each -= 1
    if each < 1:
        least = sampling_period(elements, elements, *numbers)
        checks.refuse("particles_for_period period", f"at least {least:.3g}, what one particle in each element takes", f"{period:.3g}")
    return each * elements


def _waiting(asked_by: str, elements: int, latency: float, exchange_latency: float, clock: float) -> float:
    """Return the cycles in which nothing is begun."""
    for name, value in (("latency", latency), ("exchange_latency", exchange_latency)):
        if isinstance(value, bool) or not (isinstance(value, (int, float, np.number)) and 0 <= value < math.inf):
            checks.refuse(f"{asked_by} {name}", "a number of cycles, at least 0", repr(value))
    checks.above_zero(f"{asked_by} clock", clock)
    return latency + (exchange_latency if elements > 1 else 0)
