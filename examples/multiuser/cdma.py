"""Eight users send bits at once over one channel, told apart by their spreading codes: the world, and detectors of all their bits."""

from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo

USERS, CHIPS = 8, 16
WORDS = jnp.asarray(list(product((-1.0, 1.0), repeat=USERS)))
"""All that the users can send, `(256, users)`."""
EXPONENTS = (1.0, 0.5, 0.2, 0.05)
PLAIN = mo.mcmc.Repeat(mo.mcmc.DiscreteGibbs((-1, 1)), len(EXPONENTS))
"""As many sweeps as the other makes in all its replicas."""
TEMPERED = mo.mcmc.ParallelTempering(mo.mcmc.DiscreteGibbs((-1, 1)), EXPONENTS)
DRAWS, BURN_IN = 200, 40


class Received(NamedTuple):
    """What a receiver knows of one bit of each user, or of many such bits with their axis first.

    Attributes:
        filtered: outputs of the filters that are matched to the codes, `(users,)`.
        correlations: of the codes, `(users, users)`.
        variance: of the noise of a matched filter, where the energy of a bit is 1, `()`.
    """

    filtered: jax.Array
    correlations: jax.Array
    variance: jax.Array

    def log_density(self, bits: jax.Array) -> jax.Array:
        """Log of the probability of bits `(users,)`, each -1 or 1, up to a constant."""
        return (bits @ self.filtered - 0.5 * bits @ self.correlations @ bits) / self.variance


def sent(key: Any, decibels: float, words: int) -> tuple[jax.Array, Received]:
    """Draw what users send, `(words, users)`, and what is received of it at an energy of a bit over N0, dB.

    Codes are drawn anew for every word; all users are in step, and equally strong.
    """
    keys = jax.random.split(key, 3)
    bits = jax.random.rademacher(keys[0], (words, USERS), jnp.float32)
    codes = jax.random.rademacher(keys[1], (words, CHIPS, USERS), jnp.float32) / CHIPS**0.5
    variance = 0.5 * 10 ** (-decibels / 10)
    chips = jnp.einsum("wcu,wu->wc", codes, bits) + variance**0.5 * jax.random.normal(keys[2], (words, CHIPS))
    correlations = jnp.einsum("wcu,wcv->wuv", codes, codes)
    return bits, Received(jnp.einsum("wcu,wc->wu", codes, chips), correlations, jnp.full(words, variance))


def decorrelated(given: Received) -> jax.Array:
    """Undo the correlations, `(words, users)`, as far as codes are linearly independent."""
    inverse = np.linalg.pinv(np.asarray(given.correlations, float), rcond=1e-5, hermitian=True)
    return np.einsum("wuv,wv->wu", inverse, given.filtered)


def least_squares(given: Received) -> jax.Array:
    """Estimate the bits with the least mean square error (MMSE) of all linear detectors, `(words, users)`."""
    loaded = np.asarray(given.correlations, float) + np.asarray(given.variance, float)[:, None, None] * np.eye(USERS)
    return np.linalg.solve(loaded, np.asarray(given.filtered)[..., None])[..., 0]


@jax.jit
def enumerated(given: Received) -> tuple[jax.Array, jax.Array]:
    """Return the most probable word, `(words, users)`, and the mean of each bit given what was received, of all 256 words."""

    def one(given: Received) -> tuple[jax.Array, jax.Array]:
        log_weights = jax.vmap(given.log_density)(WORDS)
        return WORDS[jnp.argmax(log_weights)], jax.nn.softmax(log_weights) @ WORDS

    return jax.lax.map(one, given, batch_size=1_000)


def sampled(key: Any, given: Received, kernel: Any, draws: int = DRAWS, burn_in: int = BURN_IN) -> mo.montecarlo.Estimate:
    """Estimate the mean of each bit by a Markov chain for each word that starts where matched filters point to."""

    def one(held: tuple[jax.Array, Received]) -> mo.montecarlo.Estimate:
        key, given = held
        start = jnp.where(given.filtered > 0, 1.0, -1.0)
        return mo.montecarlo.chain_expectation(key, lambda bits: bits, kernel, given.log_density, start, draws, burn_in)

    keys = jax.random.split(key, len(given.filtered))
    return jax.jit(lambda rows: jax.lax.map(one, rows, batch_size=min(1_000, len(keys))))((keys, given))
