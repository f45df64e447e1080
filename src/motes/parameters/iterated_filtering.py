"""Iterated filtering (Ionides, Nguyen, Atchade, Stoev, King 2015): the parameters with the largest likelihood.

1. Let each particle carry parameters that walk at random while the filter runs.
2. Start again with the parameters of the last particles, and smaller steps.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.progress import tracked
from motes.core.types import KeyLike
from motes.filters import keep
from motes.filters.particle import ParticleFilter
from motes.filters.run import run
from motes.parameters.augmented import augmented
from motes.parameters.posterior import Parametric
from motes.resampling.schemes import Systematic
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside

HALVED_AFTER = 0.25
"""Share of the rounds after which steps are half as long."""


class Iterated(NamedTuple):
    """What `iterated_filtering` gives.

    Attributes:
        theta: mean of the last particles' parameters, `(p,)`.
        means: after each round, `(rounds, p)`; still drifting means more rounds are wanted.
        spread: standard deviations of the particles' parameters after each round, `(rounds, p)`.
        log_likelihood: of the walking model in each round, `(rounds,)`.
    """

    theta: np.ndarray
    means: np.ndarray
    spread: np.ndarray
    log_likelihood: np.ndarray


def iterated_filtering(key: KeyLike, given: Parametric, n: int, deviations: Any, rounds: int = 40) -> Iterated:
    """Climb to the maximum of the likelihood with n particles.

    Args:
        key: JAX key or integer seed.
        given: a `parameters.Posterior` or `PathPosterior`; its prior draws the first parameters and counts no further.
        n: particles.
        deviations: of a step of the walk in the first round, `()` or `(p,)`: about a fiftieth of how far parameters may be off.
        rounds: passes through the measurements.

    Raises:
        MotesError: an argument cannot be used.
        CollapseError: no particle explains a measurement.
    """
    if not isinstance(given, Parametric):
        checks.refuse("iterated_filtering given", "a mo.parameters.Posterior", type(given).__name__)
    for name, value in (("n", n), ("rounds", rounds)):
        checks.positive_integer(f"iterated_filtering {name}", value)
    first = jnp.broadcast_to(checks.as_float("iterated_filtering deviations", deviations), (given.size,))
    if not bool((first > 0).all()):
        checks.refuse("iterated_filtering deviations", "positive numbers", first.tolist())
    key, beside = random.as_key(key), Beside(given)
    thetas = given.prior.sample(random.child(key, random.INITIAL), n)
    results = []
    for turn in tracked(range(rounds), "iterated filtering", None):
        walk = first * 0.5 ** (turn / (HALVED_AFTER * rounds))
        thetas, likelihood, collapsed = _round(random.step_key(key, turn), given, thetas, walk, beside)
        if bool(collapsed):
            checks.refuse("iterated_filtering given", "parameters that explain the measurements", f"a collapse in round {turn}",
                          "Use more particles, or a prior that fits.", checks.CollapseError)
        results.append((np.asarray(thetas.mean(axis=1)), np.asarray(thetas.std(axis=1)), float(likelihood)))
    means, spread, likelihoods = (np.array(column) for column in zip(*results, strict=True))
    return Iterated(means[-1], means, spread, likelihoods)


@jitted
def _round(
    key: jax.Array, given: Parametric, thetas: jax.Array, deviations: jax.Array, beside: Beside
) -> tuple[jax.Array, jax.Array, jax.Array]:
    size, n = thetas.shape
    model = augmented(given, thetas, random.child(key, random.WORLD), deviations)
    history = run(random.child(key, random.FILTER), ParticleFilter(n=n), model, given.ys, given.inputs, keep.nothing)
    ancestors = Systematic().ancestors(random.child(key, random.RESAMPLE), history.state.log_weights, n)
    return history.state.particles[:size, ancestors], history.log_likelihood, jnp.any(history.info.collapsed)
