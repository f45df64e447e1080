"""Plain Monte Carlo: averages over draws of a law, and integrals over a box (Robert, Casella 2004, chapter 3)."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.types import KeyLike
from motes.laws.law import as_law
from motes.montecarlo.estimate import Estimate, values_at, warned


def expectation(key: KeyLike, function: Any, law: Any, n: int) -> Estimate:
    """Estimate the mean of a function of a random vector from n draws.

    Args:
        key: JAX key or integer seed.
        function: of one point `(x,)`, to a number or a vector `(m,)`.
        law: with `sample`.
        n: number of draws, at least 2.

    Raises:
        MotesError: an argument cannot be used.
    """
    points = as_law("expectation law", law).sample(random.as_key(key), _at_least_two("expectation", n))
    return _mean("expectation", values_at(function, points))


def integral(key: KeyLike, function: Any, low: Any, high: Any, n: int) -> Estimate:
    """Estimate the integral of a function over a box from n uniform points: its volume times the mean.

    Args:
        key: JAX key or integer seed.
        function: of one point `(x,)`, to a number or a vector `(m,)`.
        low: corner of the box, `(x,)`.
        high: opposite corner, `(x,)`.
        n: number of points, at least 2.

    Raises:
        MotesError: an argument cannot be used, or the box is empty or infinite.
    """
    low, high = (jnp.atleast_1d(checks.as_float(f"integral {name}", value)) for name, value in (("low", low), ("high", high)))
    checks.shape("integral high", high, low.shape, "(as low)")
    for name, value in (("low", low), ("high", high)):
        checks.finite(f"integral {name}", value, "Map an infinite range to a finite one, or use importance_sampling.")
    if checks.is_concrete((low, high)) and not bool((high > low).all()):
        checks.refuse("integral high", "numbers above low", f"{high.tolist()} above {low.tolist()}")
    sides = high - low
    points = low[:, None] + sides[:, None] * random.uniform(random.as_key(key), (low.shape[0], _at_least_two("integral", n)), low.dtype)
    return _mean("integral", jnp.prod(sides) * values_at(function, points))


def _at_least_two(asked_by: str, n: Any) -> int:
    checks.positive_integer(f"{asked_by} n", n)
    if n < 2:
        checks.refuse(f"{asked_by} n", "at least 2 points (an error is estimated)", n)
    return int(n)


def _mean(asked_by: str, values: jax.Array) -> Estimate:
    n = values.shape[-1]
    nothing = jnp.full((), jnp.nan, values.dtype)
    error = jnp.std(values, axis=-1, ddof=1) / n**0.5
    return warned(Estimate(jnp.mean(values, axis=-1), error, n, jnp.asarray(float(n)), nothing, nothing, nothing), asked_by)
