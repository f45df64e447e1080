"""Discrete AdaBoost of thresholds (Freund, Schapire 1997): many weak votes make one strong one.

1. Each feature gets a threshold between the means of both classes, nearer to the class that is spread less.
2. The one with the smallest weighted error is taken, with a vote that grows as the error falls.
3. Examples that it gets wrong weigh more in the next round.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

ROUNDS = 20
"""Thresholds of an ensemble."""
SUREST = 0.01
"""Error below which no vote grows any more."""


class Ensemble(NamedTuple):
    """Votes: number of the feature, threshold, side (1 or -1) on which the target lies, and weight, each `(20,)`; weights sum to 1."""

    chosen: jax.Array
    threshold: jax.Array
    side: jax.Array
    weight: jax.Array

    @classmethod
    def of(cls, memory: Any) -> "Ensemble":
        """Return the one that a memory holds."""
        return cls(*(memory[name] for name in cls._fields))

    def score(self, values: jax.Array) -> jax.Array:
        """Return from -1 to 1 how much examples look like the target, `(m,)`, by the values of the chosen features `(20, m)`."""
        return self.weight @ _votes(values, self.threshold, self.side)


def boosted(values: jax.Array, target: jax.Array, weights: jax.Array) -> Ensemble:
    """Choose an ensemble.

    Args:
        values: of all features of examples, `(k, m)`.
        target: whether an example shows the target, `(m,)`.
        weights: of the examples, `(m,)`; 0 leaves one out. Both classes count alike.
    """
    label = jnp.where(target, 1.0, -1.0).astype(values.dtype)
    classes = jnp.stack([target, ~target], axis=1)
    begin = weights / jnp.where(target, jnp.sum(weights * target), jnp.sum(weights * ~target)) / 2
    both = jnp.concatenate([values, values**2])

    def choose(weights: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        moments = both @ (weights[:, None] * classes) / (weights @ classes)
        mean, square = moments[: len(values)], moments[len(values) :]
        spread = jnp.sqrt(jnp.maximum(square - mean**2, 1e-8))
        threshold = (mean[:, 0] * spread[:, 1] + mean[:, 1] * spread[:, 0]) / jnp.sum(spread, axis=1)
        side = jnp.where(mean[:, 0] > mean[:, 1], 1.0, -1.0).astype(values.dtype)
        error = (1 - _votes(values, threshold, side) @ (weights * label)) / 2
        best = jnp.argmin(error)
        share = jnp.clip(error[best], SUREST, 0.5)
        vote = jnp.log((1 - share) / share) / 2
        weights = weights * jnp.exp(-vote * label * _votes(values[best], threshold[best], side[best]))
        return weights / jnp.sum(weights), (best.astype(jnp.int32), threshold[best], side[best], vote)

    _, (chosen, threshold, side, vote) = jax.lax.scan(choose, begin, None, length=ROUNDS)
    return Ensemble(chosen, threshold, side, vote / jnp.maximum(jnp.sum(vote), 1e-6))


def _votes(values: jax.Array, threshold: jax.Array, side: jax.Array) -> jax.Array:
    return jnp.where(values > threshold[..., None], 1.0, -1.0).astype(values.dtype) * side[..., None]
