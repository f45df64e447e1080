"""Kernels that learn their scale and shape while the chain warms up (Robbins, Monro 1951; Haario, Saksman, Tamminen 2001).

1. After each step move the log of the scale by (k + 1)^-0.6 (acceptance - target), k steps after the shape was last changed.
2. Gather mean and covariance over windows that double in length; at the end of each, the covariance, drawn a little towards the old
   shape, gives the new one, and the scale starts anew.
3. After the last step of learning nothing changes any more, so that what follows is a Markov chain.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from motes.core import checks, linalg
from motes.core.record import record, replace, static
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, State, Tunable, Wrapper

FIRST_WINDOW = 32
PRIOR_DRAWS = 5.0
"""The old shape counts as much as so many draws."""


@record
class Learned:
    """What the kernel has learned.

    Attributes:
        log_scale: of the steps, `()`.
        factor: L of the density's covariance L L', `(x, x)`.
        own: steps so far, `()`; fewer than the chain's where the kernel is one of a `Mix`.
        since: steps since the shape was changed, `()`.
        mean: of the positions since then, `(x,)`.
        scatter: sum of their squared deviations from it, `(x, x)`.
        inner: state of the inner kernel.
    """

    log_scale: jax.Array
    factor: jax.Array
    own: jax.Array
    since: jax.Array
    mean: jax.Array
    scatter: jax.Array
    inner: Any


@record
class Adaptive(Wrapper):
    """A kernel that is tuned during the first steps of a chain, each chain on its own.

    Source: Robbins, Monro 1951, A stochastic approximation method; Haario, Saksman, Tamminen 2001, An adaptive Metropolis algorithm.

    Example:
        >>> kernel = mo.mcmc.Adaptive(mo.mcmc.RandomWalkMetropolis())
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        kernel: `RandomWalkMetropolis`, `MALA`, `HMC` or `NUTS`; its own scale and factor do not count.
        steps: how long it learns; not longer than the burn-in, since draws made meanwhile do not have the right law.
        target: acceptance probability; the kernel's own if not given.
    """

    kernel: Any
    steps: int = static(default=1_000)
    target: float | None = static(default=None)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: naming the one that cannot be used.
        """
        if not (isinstance(self.kernel, Kernel) and isinstance(self.kernel, Tunable)):
            checks.refuse("Adaptive kernel", "RandomWalkMetropolis, MALA, HMC or NUTS", type(self.kernel).__name__)
        checks.positive_integer("Adaptive steps", self.steps)
        if self.target is not None and not 0 < self.target < 1:
            checks.refuse("Adaptive target", "a probability between 0 and 1", self.target)

    def around(self, kernel_state: Any, position: Position) -> Learned:
        """Start with a scale for the standard normal density."""
        x = ravel_pytree(position)[0]
        first = jnp.log(jnp.asarray(self.kernel.first_scale(x.shape[0]), x.dtype))
        none, nothing = jnp.zeros((), x.dtype), jnp.zeros_like(x)
        return Learned(first, jnp.eye(x.shape[0], dtype=x.dtype), jnp.int32(0), none, nothing, jnp.outer(nothing, nothing), kernel_state)

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make a step and learn from it."""
        known: Learned = state.kernel_state
        kernel = self.kernel.tuned(jnp.exp(known.log_scale), known.factor)
        after, info = kernel.step(key, log_density, replace(state, kernel_state=known.inner), t)
        x = ravel_pytree(after.position)[0]
        accepted = info.accepted[0].astype(x.dtype)
        kernel_state = jax.lax.cond(t < self.steps, lambda: self._learned(known, x, accepted, t), lambda: known)
        return replace(after, kernel_state=replace(kernel_state, inner=after.kernel_state)), info

    def _learned(self, known: Learned, x: jax.Array, accepted: jax.Array, t: Any) -> Learned:
        size = x.shape[0]
        target = self.kernel.target(size) if self.target is None else self.target
        n = known.since + 1
        off = x - known.mean
        mean = known.mean + off / n
        scatter = known.scatter + jnp.outer(off, x - mean)
        log_scale = known.log_scale + n**-0.6 * (accepted - target)
        own = known.own + 1
        gathered = replace(known, log_scale=log_scale, own=own, since=n, mean=mean, scatter=scatter)

        def reshaped() -> Learned:
            old = jnp.matmul(known.factor, known.factor.T, precision=jax.lax.Precision.HIGHEST)
            cov = linalg.symmetric((scatter + PRIOR_DRAWS * old) / (n + PRIOR_DRAWS))
            first = jnp.log(jnp.asarray(self.kernel.first_scale(size), x.dtype))
            return Learned(first, linalg.cholesky(cov), own, jnp.zeros_like(n), jnp.zeros_like(x), jnp.zeros_like(scatter), known.inner)

        # windows end at 32, 64, 128, ... steps, and none so late that the scale could not settle
        ends = (own >= FIRST_WINDOW) & (own & (own - 1) == 0) & (t + 1 <= 0.8 * self.steps)
        return jax.lax.cond(ends, reshaped, lambda: gathered)
