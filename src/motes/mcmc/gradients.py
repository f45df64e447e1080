"""Kernels that follow the gradient of the log density: Langevin and Hamiltonian steps, taken from blackjax (extra `mcmc`).

Roberts, Tweedie 1996 (MALA); Duane et al. 1987 (HMC); Hoffman, Gelman 2014 (NUTS). Steps are made in coordinates z about the present
position, x + L z, in which a density of covariance L L' is round.
"""

from abc import abstractmethod
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.mcmc.interface import Info, Kernel, LogDensity, State, Tunable


@record
class GradientKernel(Kernel, Tunable):
    """A kernel that needs the gradient; wrap it in `Adaptive` rather than choosing its step size.

    Attributes:
        step_size: of a step, `()`.
        factor: L `(x, x)` of the density's covariance L L', or None for the unit matrix.
    """

    step_size: jax.Array | float = 0.1
    factor: jax.Array | None = None

    def __post_init__(self) -> None:
        """Check the step size.

        Raises:
            MotesError: it is not positive.
        """
        checks.above_zero(f"{type(self).__name__} step_size", self.step_size)

    def check(self, key: jax.Array, log_density: LogDensity, position: Any) -> None:
        """Ask for blackjax and for positions that have gradients."""
        checks.need("blackjax", "mcmc")
        for leaf in jax.tree.leaves(position):
            if not jnp.issubdtype(leaf.dtype, jnp.floating):
                checks.refuse(f"{type(self).__name__} position", "real numbers throughout (gradients are taken)", f"dtype {leaf.dtype}",
                              "Move whole numbers by another kernel, in a Cycle of Blocks.")

    def initial_scale(self, size: int) -> float:
        """1 / x^(1/4) (Beskos et al. 2013)."""
        return size**-0.25

    def tuned(self, step_size: jax.Array, factor: jax.Array) -> "GradientKernel":
        """Return the kernel for densities of covariance L L'."""
        return replace(self, step_size=step_size, factor=factor)

    @abstractmethod
    def trajectory(self, key: jax.Array, size: int, dtype: Any) -> tuple[Any, tuple[Any, ...]]:
        """Return blackjax's module, and what its step takes after the density; the key is for what it draws beforehand."""

    def step(self, key: jax.Array, log_density: LogDensity, state: State, t: Any) -> tuple[State, Info]:
        """Make one step."""
        x, rebuild = ravel_pytree(state.position)

        def there(z: jax.Array) -> jax.Array:
            return x + (z if self.factor is None else jnp.matmul(self.factor.astype(x.dtype), z, precision=jax.lax.Precision.HIGHEST))

        def log_density_of(z: jax.Array) -> jax.Array:
            value = log_density(rebuild(there(z)))
            return jnp.where(jnp.isnan(value) | (value == jnp.inf), -jnp.inf, value)

        module, options = self.trajectory(random.child(key, random.INITIAL), x.shape[0], x.dtype)
        begun = module.init(jnp.zeros_like(x), log_density_of)
        found, report = module.build_kernel()(random.child(key, random.PREDICT), begun, log_density_of, *options)
        # rounding in x + 0 must not move a chain that stays
        stays = jnp.all(found.position == 0)
        position = jax.tree.map(lambda new, old: jnp.where(stays, old, new), rebuild(there(found.position)), state.position)
        after = State(position, jnp.where(stays, state.log_density, found.logdensity))
        return after, Info.of_one(jnp.nan_to_num(report.acceptance_rate), report.is_divergent)


@record
class MALA(GradientKernel):
    """Metropolis-adjusted Langevin steps.

    Source: Roberts, Tweedie 1996, Exponential convergence of Langevin distributions and their discrete approximations.

    Example:
        >>> kernel = mo.mcmc.Adaptive(mo.mcmc.MALA())
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)
    """

    def target(self, size: int) -> float:
        """0.574 (Roberts, Rosenthal 1998)."""
        return 0.574

    def trajectory(self, key: jax.Array, size: int, dtype: Any) -> tuple[Any, tuple[Any, ...]]:
        """Take trajectories of a single leap, which are Langevin steps; blackjax's own say nothing of densities that are no numbers."""
        return checks.need("blackjax.mcmc.hmc", "mcmc"), (jnp.asarray(self.step_size, dtype), jnp.ones(size, dtype), 1)


@record
class HMC(GradientKernel):
    """Hamiltonian trajectories of a random number of steps (Mackenzie 1989): those of one length may come back to where they began.

    Source: Duane, Kennedy, Pendleton, Roweth 1987, Hybrid Monte Carlo; Mackenzie 1989, An improved hybrid Monte Carlo method.

    Example:
        >>> kernel = mo.mcmc.Adaptive(mo.mcmc.HMC(num_steps=10))
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        step_size: of a leapfrog step, `()`.
        factor: see `GradientKernel`.
        num_steps: leapfrog steps of a trajectory, the most; each number from 1 on is equally likely.
    """

    num_steps: int = static(default=10)

    def __init__(self, num_steps: int = 10, step_size: jax.Array | float = 0.1, factor: jax.Array | None = None):
        """Check the parameters.

        Raises:
            MotesError: the step size is not positive, or num_steps no positive whole number.
        """
        checks.positive_integer("HMC num_steps", num_steps)
        for name, value in (("step_size", step_size), ("factor", factor), ("num_steps", num_steps)):
            object.__setattr__(self, name, value)
        GradientKernel.__post_init__(self)

    def target(self, size: int) -> float:
        """0.65 (Beskos et al. 2013), a little more to be safe: 0.75."""
        return 0.75

    def trajectory(self, key: jax.Array, size: int, dtype: Any) -> tuple[Any, tuple[Any, ...]]:
        """Take trajectories."""
        steps = 1 + jnp.int32(self.num_steps * random.uniform(key, (), jnp.float32))
        return checks.need("blackjax.mcmc.hmc", "mcmc"), (jnp.asarray(self.step_size, dtype), jnp.ones(size, dtype), steps)


@record
class NUTS(GradientKernel):
    """Hamiltonian trajectories that end where they turn back: the no-U-turn sampler.

    Source: Hoffman, Gelman 2014, The No-U-Turn sampler: adaptively setting path lengths in Hamiltonian Monte Carlo.

    Example:
        >>> kernel = mo.mcmc.Adaptive(mo.mcmc.NUTS())
        >>> chains = mo.sample(0, kernel, lambda x: -0.5 * x @ x, jnp.zeros(1))
        >>> chains.positions.shape
        (4, 1000, 1)

    Attributes:
        step_size: of a leapfrog step, `()`.
        factor: see `GradientKernel`.
        max_tree_depth: doublings of a trajectory, at most.
    """

    max_tree_depth: int = static(default=10)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the step size is not positive, or max_tree_depth no positive whole number.
        """
        GradientKernel.__post_init__(self)
        checks.positive_integer("NUTS max_tree_depth", self.max_tree_depth)

    def target(self, size: int) -> float:
        """0.8 (Hoffman, Gelman 2014)."""
        return 0.8

    def trajectory(self, key: jax.Array, size: int, dtype: Any) -> tuple[Any, tuple[Any, ...]]:
        """Take trajectories that stop in time."""
        return checks.need("blackjax.mcmc.nuts", "mcmc"), (jnp.asarray(self.step_size, dtype), jnp.ones(size, dtype), self.max_tree_depth)
