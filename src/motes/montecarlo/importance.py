"""Importance sampling (Geweke 1989), from one proposal or several at once (Veach, Guibas 1995)."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.types import KeyLike
from motes.laws.law import as_law
from motes.montecarlo.estimate import Estimate, averaged, densities_at, mixture_log_prob, values_at, warned


def importance_sampling(key: KeyLike, function: Any, log_density: Any, proposal: Any, n: int, normalized: bool = False) -> Estimate:
    """Estimate the mean of a function under a density from draws of another law.

    The estimate is sum w f / sum w with w = p / q, and the mean of w that of the constant that p lacks; where p is normalized, the mean of
    w f, which is unbiased. Warns when the weights' tail is too heavy for the error to be believed.

    Args:
        key: JAX key or integer seed.
        function: of one point `(x,)`, to a number or a vector `(m,)`.
        log_density: a law, or a function of one point; up to a constant unless `normalized`.
        proposal: law with `sample` and `log_prob`, with tails at least as heavy.
        n: number of points, at least 2.
        normalized: whether the density integrates to one.

    Raises:
        MotesError: an argument cannot be used.
    """
    checks.positive_integer("importance_sampling n", n)
    if n < 2:
        checks.refuse("importance_sampling n", "at least 2 points", n)
    law = as_law("importance_sampling proposal", proposal)
    points = law.sample(random.as_key(key), n)
    log_weights = densities_at(log_density, points) - law.log_prob(points)
    return warned(averaged(log_weights, values_at(function, points), normalized), "importance_sampling")


def multiple_importance_sampling(
    key: KeyLike, function: Any, log_density: Any, proposals: Sequence[Any], n: Sequence[int], normalized: bool = False
) -> Estimate:
    """Estimate the mean of a function under a density from draws of several laws, each weighed by the mixture of all (balance heuristic).

    One law that fits a part of the density suffices for that part. The points of each law are a stratum; standard errors, which take all
    for draws of the mixture, are a little too large for that.

    Args:
        key: JAX key or integer seed.
        function: of one point `(x,)`, to a number or a vector `(m,)`.
        log_density: a law, or a function of one point; up to a constant unless `normalized`.
        proposals: laws with `sample` and `log_prob`.
        n: number of points of each.
        normalized: whether the density integrates to one.

    Raises:
        MotesError: an argument cannot be used.
    """
    if not proposals or np.ndim(n) != 1 or len(proposals) != len(n):
        checks.refuse("multiple_importance_sampling n", f"one number for each of the {len(proposals)} proposals", repr(n))
    for count in n:
        checks.positive_integer("multiple_importance_sampling n", count)
    laws = [as_law(f"multiple_importance_sampling proposals[{place}]", one) for place, one in enumerate(proposals)]
    key = random.as_key(key)
    points = jnp.concatenate([law.sample(random.step_key(key, place), n[place]) for place, law in enumerate(laws)], axis=1)
    log_weights = densities_at(log_density, points) - mixture_log_prob(laws, jnp.asarray(n, points.dtype), points)
    return warned(averaged(log_weights, values_at(function, points), normalized), "multiple_importance_sampling")
