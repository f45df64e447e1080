"""Pseudo-marginal Metropolis-Hastings (Beaumont 2003; Andrieu, Roberts 2009): the density is only estimated, without bias.

1. Draw new random numbers for an estimate; in the correlated form (Tran, Kohn, Quiroz, Villani 2016) those of a block of steps alone, so
   that the noise of the two estimates is nearly the same and fewer particles do.
2. Propose a new position, and estimate its density with these numbers.
3. Accept it as if the estimates were the densities; the estimate of the position where the chain stays is kept, never drawn anew.

With the likelihood of a particle filter it is particle marginal Metropolis-Hastings (Andrieu, Doucet, Holenstein 2010).
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, random
from motes.core.record import record, replace, static
from motes.mcmc.interface import Info, LogDensity, Position, Proposing, State, Tunable, Wrapper

TARGET = 0.2
"""Acceptance aimed at: noise in the estimates costs some of it (Sherlock, Thiery, Roberts, Rosenthal 2015)."""


@record
class PseudoMarginal(Wrapper, Tunable):
    """A Metropolis-Hastings kernel for a log density with a method `estimate(key, position)`, such as `parameters.Posterior`.

    Source: Beaumont 2003, Estimation of population growth or decline in genetically monitored populations; Andrieu, Roberts 2009, The
    pseudo-marginal approach for efficient Monte Carlo computations.

    Example:
        >>> model, prior = mo.textbook.growth(), mo.Gaussian(jnp.zeros(1), jnp.eye(1))
        >>> xs, ys = mo.simulate(0, model, 20)
        >>> noisy = lambda theta: mo.replace(model, sensor=mo.replace(model.sensor, Q=jnp.exp(theta[0]) * jnp.eye(1)))
        >>> posterior = mo.parameters.Posterior(prior, noisy, mo.ParticleFilter(n=100), ys)
        >>> chains = mo.sample(1, mo.mcmc.PseudoMarginal(mo.mcmc.RandomWalkMetropolis(1.0)), posterior, posterior.starts, draws=100)

    Attributes:
        kernel: makes the proposals: `RandomWalkMetropolis`, `IndependenceMetropolis` or `MetropolisHastings`.
        renewed: share of the steps whose random numbers a proposal draws anew; below 1 is the correlated form, for a density with `steps`
            whose `estimate` takes a key for each of them. Its filter had best resample by `mo.resampling.Sorted`.
    """

    kernel: Any
    renewed: float = static(default=1.0)

    def __post_init__(self) -> None:
        """Check the kernel.

        Raises:
            MotesError: it makes no single proposals.
        """
        if not isinstance(self.kernel, Proposing):
            wanted = "RandomWalkMetropolis, IndependenceMetropolis or MetropolisHastings"
            checks.refuse("PseudoMarginal kernel", wanted, type(self.kernel).__name__)
        checks.above_zero("PseudoMarginal renewed", self.renewed, 1.0)

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for a density that can be estimated."""
        if not hasattr(log_density, "estimate"):
            checks.refuse("PseudoMarginal log_density", "one with a method estimate(key, position)", type(log_density).__name__,
                          "Use mo.parameters.Posterior, or the kernel itself where the density is known.")
        if self.renewed < 1 and not hasattr(log_density, "steps"):
            checks.refuse("PseudoMarginal log_density", "one with steps (renewed is below 1)", type(log_density).__name__)
        super().check(key, log_density, position)

    def init(self, key: jax.Array, log_density: Any, position: Position) -> State:
        """Return the state of a chain with an estimate of its density; the state of the kernel are the keys that gave it."""
        keys = self._renewed(key, log_density, None)
        return State(position, log_density.estimate(keys, position), self._key_data(keys))

    def init_kernel_state(self, log_density: LogDensity, position: Position) -> Any:
        """Return nothing: a state is what only the correlated form has.

        Raises:
            MotesError: the correlated form is one of several kernels.
        """
        if self.renewed < 1:
            checks.refuse("PseudoMarginal renewed", "1 in a Cycle or Mix", self.renewed, "Other kernels would not keep its random numbers.")
        return super().init_kernel_state(log_density, position)

    def _key_data(self, keys: jax.Array) -> Any:
        return jax.random.key_data(keys) if self.renewed < 1 else ()

    def _renewed(self, key: jax.Array, log_density: Any, old: jax.Array | None) -> jax.Array:
        """Return the key of an estimate, or keys of its steps `(t,)`, all but a block of them the old ones."""
        if self.renewed == 1:
            return key
        steps = jnp.arange(log_density.steps)
        fresh = random.step_keys(key, log_density.steps)
        if old is None:
            return fresh
        block = max(1, round(self.renewed * log_density.steps))
        # blocks begin anywhere, also before the first step, so that all steps are renewed equally often
        begin = random.uniform(random.child(key, random.RESAMPLE), (), jnp.float32) * (log_density.steps + block - 1)
        since = steps - (jnp.floor(begin) - block + 1)
        within = (since >= 0) & (since < block)
        return random.as_key(jnp.where(within[:, None], jax.random.key_data(fresh), old))

    def step(self, key: jax.Array, log_density: Any, state: State, t: Any) -> tuple[State, Info]:
        """Make one step."""
        # 1. random numbers
        keys = self._renewed(random.child(key, random.FILTER), log_density, state.kernel_state)

        def estimated(position: Position) -> State:
            return State(position, log_density.estimate(keys, position), self._key_data(keys))

        # 2. propose and estimate; 3. accept or stay
        return self.kernel.step_by(key, estimated, state, t)

    def target(self, size: int) -> float:
        """Less than for known densities."""
        return TARGET

    def initial_scale(self, size: int) -> float:
        """That of the kernel."""
        return self.kernel.initial_scale(size)

    def tuned(self, step_size: jax.Array, factor: jax.Array) -> "PseudoMarginal":
        """Return the kernel with other steps."""
        return replace(self, kernel=self.kernel.tuned(step_size, factor))
