"""Pseudo-marginal Metropolis-Hastings (Beaumont 2003; Andrieu, Roberts 2009): the density is only estimated, without bias.

1. Propose a new position; estimate its density with fresh random numbers.
2. Accept it as if the estimates were the densities; the estimate of the position where the chain stays is kept, never drawn anew.

With the likelihood of a particle filter it is particle marginal Metropolis-Hastings (Andrieu, Doucet, Holenstein 2010).
"""

from typing import Any

import jax
from jax.flatten_util import ravel_pytree

from motes.core import checks, random
from motes.core.record import record, replace
from motes.mcmc.interface import Info, Kernel, LogDensity, Position, Proposing, State, Tunable, settle

TARGET = 0.2
"""Acceptance aimed at: noise in the estimates costs some of it (Sherlock, Thiery, Roberts, Rosenthal 2015)."""


@record
class PseudoMarginal(Kernel, Tunable):
    """A Metropolis-Hastings kernel for a log density with a method `estimate(key, position)`, such as `parameters.Posterior`.

    Attributes:
        kernel: makes the proposals: `RandomWalkMetropolis`, `IndependenceMetropolis` or `MetropolisHastings`.
    """

    kernel: Any

    def __post_init__(self) -> None:
        """Check the kernel.

        Raises:
            MotesError: it makes no single proposals.
        """
        if not isinstance(self.kernel, Proposing):
            wanted = "RandomWalkMetropolis, IndependenceMetropolis or MetropolisHastings"
            checks.refuse("PseudoMarginal kernel", wanted, type(self.kernel).__name__)

    @property
    def moves(self) -> tuple[str, ...]:
        """That of the kernel."""
        return self.kernel.moves

    def check(self, key: jax.Array, log_density: LogDensity, position: Position) -> None:
        """Ask for a density that can be estimated."""
        if not hasattr(log_density, "estimate"):
            checks.refuse("PseudoMarginal log_density", "one with a method estimate(key, position)", type(log_density).__name__,
                          "Use mo.parameters.Posterior, or the kernel itself where the density is known.")
        self.kernel.check(key, log_density, position)

    def init(self, key: jax.Array, log_density: Any, position: Position) -> State:
        """Return the state of a chain with an estimate of its density."""
        return State(position, log_density.estimate(key, position))

    def step(self, key: jax.Array, log_density: Any, state: State, t: Any) -> tuple[State, Info]:
        """Make one step."""
        x, rebuild = ravel_pytree(state.position)
        new, log_proposals = self.kernel.proposed(random.child(key, random.PREDICT), x, t)
        position = rebuild(new)
        there = State(position, log_density.estimate(random.child(key, random.FILTER), position))
        return settle(random.child(key, random.UPDATE), state, there, there.log_density - state.log_density + log_proposals)

    def target(self, size: int) -> float:
        """Less than for known densities."""
        return TARGET

    def first_scale(self, size: int) -> float:
        """That of the kernel."""
        return self.kernel.first_scale(size)

    def tuned(self, scale: jax.Array, factor: jax.Array) -> "PseudoMarginal":
        """Return the kernel with other steps."""
        return replace(self, kernel=self.kernel.tuned(scale, factor))
