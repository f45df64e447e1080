"""Kernels that learn their scale and shape while the chain warms up (Robbins, Monro 1951; Haario, Saksman, Tamminen 2001).

1. After each step take the position into mean and covariance of the present window; windows double in length.
2. Move the log of the scale by (k + 1)^-0.6 (acceptance - target), k steps after the shape was last changed.
3. At the end of a window its covariance, drawn a little towards the old shape, gives the new shape, and the scale starts anew.
4. After the last step of learning nothing changes any more, so that what follows is a Markov chain.
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
        steps: made so far, `()`; fewer than the chain's where the kernel is one of a `Mix`.
        in_window: steps since the shape was changed, `()`.
        mean: of the positions since then, `(x,)`.
        scatter: sum of their squared deviations from it, `(x, x)`.
        inner: state of the inner kernel.
    """

    log_scale: jax.Array
    factor: jax.Array
    steps: jax.Array
    in_window: jax.Array
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
        if self.target is not None:
            checks.probability("Adaptive target", self.target)

    def around(self, kernel_state: Any, position: Position) -> Learned:
        """Start with a scale for the standard normal density."""
        x = ravel_pytree(position)[0]
        first = jnp.log(jnp.asarray(self.kernel.initial_scale(x.shape[0]), x.dtype))
        none, nothing = jnp.zeros((), x.dtype), jnp.zeros_like(x)
        return Learned(first, jnp.eye(x.shape[0], dtype=x.dtype), jnp.int32(0), none, nothing, jnp.outer(nothing, nothing), kernel_state)

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make a step and learn from it."""
        learned: Learned = state.kernel_state
        kernel = self.kernel.tuned(jnp.exp(learned.log_scale), learned.factor)
        after, info = kernel.step(key, log_density, replace(state, kernel_state=learned.inner), t)
        x = ravel_pytree(after.position)[0]
        accepted = info.accepted[0].astype(x.dtype)
        # 1. to 3. learn; 4. or no more
        kernel_state = jax.lax.cond(t < self.steps, lambda: self._learned(learned, x, accepted, t), lambda: learned)
        return replace(after, kernel_state=replace(kernel_state, inner=after.kernel_state)), info

    def _learned(self, learned: Learned, x: jax.Array, accepted: jax.Array, t: Any) -> Learned:
        size = x.shape[0]
        target = self.kernel.target(size) if self.target is None else self.target
        # 1. mean and covariance
        n = learned.in_window + 1
        off = x - learned.mean
        mean = learned.mean + off / n
        scatter = learned.scatter + jnp.outer(off, x - mean)
        # 2. scale
        log_scale = learned.log_scale + n**-0.6 * (accepted - target)
        steps = learned.steps + 1
        gathered = replace(learned, log_scale=log_scale, steps=steps, in_window=n, mean=mean, scatter=scatter)

        # 3. shape
        def new_shape() -> Learned:
            old = jnp.matmul(learned.factor, learned.factor.T, precision=jax.lax.Precision.HIGHEST)
            cov = linalg.symmetric((scatter + PRIOR_DRAWS * old) / (n + PRIOR_DRAWS))
            first = jnp.log(jnp.asarray(self.kernel.initial_scale(size), x.dtype))
            return Learned(first, linalg.cholesky(cov), steps, jnp.zeros_like(n), jnp.zeros_like(x), jnp.zeros_like(scatter), learned.inner)

        # windows end at 32, 64, 128, ... steps, and none so late that the scale could not settle
        ends = (steps >= FIRST_WINDOW) & (steps & (steps - 1) == 0) & (t + 1 <= 0.8 * self.steps)
        return jax.lax.cond(ends, new_shape, lambda: gathered)
