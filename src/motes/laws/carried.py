"""A law with what a filter around another carries beside it."""

from typing import Any

import jax

from motes.core.record import record, replace
from motes.laws.law import Law


@record
class Carried(Law):
    """A law, and what goes with it from step to step; asked for anything it answers as the law does.

    Attributes:
        law: the law.
        beside: tree of arrays.
    """

    law: Any
    beside: Any

    @property
    def weighted(self) -> bool:  # type: ignore[override]
        """Whether the law is made of weighted parts."""
        return self.law.weighted

    @property
    def marks_ancestors(self) -> bool:  # type: ignore[override]
        """Whether the law's parts say where they came from."""
        return self.law.marks_ancestors

    @property
    def log_weights(self) -> jax.Array:
        """Those of the law, normalized, `(n,)`."""
        return self.law.log_weights

    @property
    def ancestors(self) -> jax.Array:
        """Those of the law, `(n,)`."""
        return self.law.ancestors

    def mean(self) -> jax.Array:
        """Mean of the law, `(x,)`."""
        return self.law.mean()

    def cov(self) -> jax.Array:
        """Covariance of the law, `(x, x)`."""
        return self.law.cov()

    def effective_size(self) -> jax.Array:
        """That of the law."""
        return self.law.effective_size()

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points of the law, `(x, n)`."""
        return self.law.sample(key, n)

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density of the law."""
        return self.law.log_prob(value)

    def mode_probabilities(self, count: int = 0) -> jax.Array | None:
        """Probabilities of the modes, `(m,)`; see `Law`."""
        return self.law.mode_probabilities(count)

    def weighted_points(self) -> tuple[jax.Array, jax.Array] | None:
        """Return the points of the law."""
        return self.law.weighted_points()

    def gathered(self, angles: tuple[int, ...]) -> "Carried":
        """Return the same with the law on one branch of the states that are angles."""
        return replace(self, law=self.law.gathered(angles))

    def inflated(self, factor: float) -> "Carried":
        """Return the same with the covariance of the law grown by a factor."""
        return replace(self, law=self.law.inflated(factor))
