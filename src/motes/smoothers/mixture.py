"""Backward simulation from mixtures of Gaussians (Fong, Godsill, Doucet, West 2002), after filters of jump-Markov systems.

Trajectories of state and mode are drawn backward; (x', s') is what was drawn at the next step.

1. Draw a component of the last mixture by weight, and the last state from its Gaussian.
2. Going back, take component i of the filtered mixture, which is in mode s_i, with probability in proportion to
   w_i transition[s_i, s'] N(x'; f(m_i), F P_i F' + Q), with f, F and Q those of mode s'.
3. Condition its Gaussian on x', and draw x from it.
4. Means and covariances are those of the conditioned Gaussians, and probabilities of modes sums of the weights of step 2, not those of the
   draws, so that less is left to chance.

For linear modes a trajectory is a draw from the joint law given all measurements if the filter's law was exact; elsewhere f, F and Q are
those of the rule for moments over N(m_i, P_i).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, pairs, random
from motes.core.record import record, replace, static
from motes.filters.history import History
from motes.filters.needs import as_jump_markov
from motes.gaussian.rule import Linearized, Rule, check_rule
from motes.gaussian.taylor import Taylor
from motes.laws.circular import wrap
from motes.laws.cloud import draw, pick
from motes.laws.density import log_normal, noiseless
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import Mixture
from motes.laws.mode_mixture import ModeMixture
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel, at_step
from motes.smoothers.interface import Smoothed, Smoother, Steps, ask_laws
from motes.smoothers.parents import FOLLOWED


class _Drawn(NamedTuple):
    """States `(x, m)` and modes `(m,)` of m trajectories at one step."""

    states: jax.Array
    modes: jax.Array


@record
class MixtureSmoother(Smoother):
    """Backward simulation from mixtures of Gaussians; it gives probabilities of modes too.

    It works with the laws of `JumpMarkovFilter` and `InteractingMultipleModel`, and with those of Gaussian sums and kernels, as one mode.

    Source: Fong, Godsill, Doucet, West 2002, Monte Carlo smoothing with application to audio signal enhancement.

    Example:
        >>> model = mo.textbook.maneuvers()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> history = mo.run(1, mo.JumpMarkovFilter(n=20), model, ys, keep=mo.keep.laws)
        >>> mo.smooth(2, mo.smoothers.MixtureSmoother(n=100), model, history).mean.shape
        (50, 4)

    Attributes:
        n: number of trajectories.
        rule: how the Gaussians are taken through the dynamics, best by the rule of the filter (see `JumpMarkovFilter`).
    """

    n: int = static()
    rule: Rule = Taylor()
    lost = ("states that a component leads to", "Dynamics without noise in some direction lead from drawn states to others than were kept: "
            "use more particles, or give it a little noise.")  # fmt: skip

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, or the rule is none or has a parameter that it cannot have.
        """
        Smoother.check_parameters(self)
        check_rule("MixtureSmoother", self.rule)

    def prepare(self, model: Any, history: History, u: Any) -> JumpMarkovModel:
        """Ask for mixtures, and for means and covariances of the dynamics of every mode.

        Raises:
            MotesError: one is missing.
        """
        ask_laws("MixtureSmoother", history, Mixture)
        model = as_jump_markov("MixtureSmoother", model)
        self.rule.check_size("MixtureSmoother", model.size)
        modes = getattr(history.state, "count", 1)
        if modes != model.count:
            checks.refuse("MixtureSmoother model", f"the model of the run, of {modes} modes", f"one of {model.count}")
        return model

    def smooth(self, key: jax.Array, model: JumpMarkovModel, history: History, steps: Steps) -> Smoothed:
        """Draw trajectories backward."""
        laws = _with_modes(history.law, model.count)
        # 1. last component and state
        last: ModeMixture = at_step(laws, -1)
        opening = random.step_key(key, steps.t[-1])
        first = last.resampled(draw(random.child(opening, random.RESAMPLE), last.log_weights, self.n))
        start = _Drawn(first.parts.sample(random.child(opening, random.NOISE), self.n), first.part_modes)
        equal = logspace.uniform_weights(self.n, start.states.dtype)

        def back(after: _Drawn, row: Any) -> tuple[_Drawn, tuple[jax.Array, ...]]:
            law, u, t, t_after = row
            step_key = random.step_key(key, t)
            # 2. component; 3. condition and draw
            conditioned, modes, probabilities = self._conditioned(random.child(step_key, random.RESAMPLE), model, law, after, u, t_after)
            before = _Drawn(conditioned.sample(random.child(step_key, random.NOISE), self.n), modes)
            # 4. moments
            whole = Mixture(conditioned, equal).gathered(model.circular)
            return before, (whole.mean(), whole.cov(), before.states, modes, probabilities)

        rows = *jax.tree.map(lambda leaf: leaf[:-1], (laws,)), jax.tree.map(lambda leaf: leaf[1:], steps.u), steps.t[:-1], steps.t[1:]
        _, earlier = jax.lax.scan(back, start, rows, reverse=True)
        ending = (last.mean(), last.cov(), *start, last.mode_probabilities())
        mean, cov, paths, modes, probabilities = (jnp.concatenate([some, one[None]]) for some, one in zip(earlier, ending, strict=True))
        found = Smoothed(mean, cov, paths, equal)
        return replace(found, mode_probabilities=probabilities, modes=modes) if isinstance(history.state, ModeMixture) else found

    def _conditioned(
        self, key: jax.Array, model: JumpMarkovModel, law: ModeMixture, after: _Drawn, u: Any, t: Any
    ) -> tuple[Gaussian, jax.Array, jax.Array]:
        """Draw a component for each trajectory, and condition its Gaussian on what follows.

        Returns:
            The Gaussians, NaN where no component leads to what follows; the modes of the components `(m,)`; and the probabilities of the
            modes `(modes,)`.
        """
        # 2. weights of the components
        def moved(part: StateSpaceModel, u: Any, parts: Gaussian) -> tuple[Linearized, jax.Array]:
            move = self.rule.linearized(part.dynamics, parts, u, t)
            return move, move.over(parts).covariance

        moves, covs = model.in_each_mode(u, moved, jax.tree.map(lambda leaf: leaf[..., None, :], law.parts))
        log_transition = model.log_transition(u, t)[law.part_modes]
        size = jnp.maximum(jnp.max(jnp.abs(after.states), axis=1), jnp.max(jnp.abs(moves.prediction), axis=(1, 2)))

        def log_weights(state: jax.Array, mode: jax.Array, trusted: float | None) -> jax.Array:
            prediction, noise, cov = moves.prediction[:, mode], moves.noise[:, :, mode], covs[:, :, mode]
            density = log_normal(wrap(state[:, None] - prediction, model.circular), cov, None, size, noiseless(noise), trusted)
            possible = law.log_weights > -jnp.inf
            return jnp.where(possible, law.log_weights + log_transition[:, mode] + density, -jnp.inf)

        def parent(row: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array, jax.Array]:
            state, mode, point = row
            strict, loose = (log_weights(state, mode, trusted) for trusted in (None, FOLLOWED))
            log_p, total = logspace.normalize(jnp.where(jnp.any(jnp.isfinite(strict)), strict, loose))
            return pick(jnp.exp(log_p), point), jnp.isfinite(total), replace(law, log_weights=log_p).mode_probabilities()

        points = random.uniform(key, (self.n,), size.dtype)
        rows = (after.states.T, after.modes, points)
        parents, known, probabilities = pairs.against_all(parent, rows, model.count * law.log_weights.shape[0])
        # 3. condition
        chosen = law.resampled(parents)
        move = Linearized(*(leaf[..., after.modes, parents] for leaf in moves))
        done = chosen.parts.corrected(wrap(after.states - move.prediction, model.circular), move.slope, move.noise).law
        return Gaussian(jnp.where(known, done.center, jnp.nan), done.covariance), chosen.part_modes, jnp.mean(probabilities, axis=0)


def _with_modes(laws: Mixture, count: int) -> ModeMixture:
    """Return mixtures with the modes of their components; those that have none are all in one."""
    if isinstance(laws, ModeMixture):
        return laws
    return ModeMixture(laws.parts, laws.log_weights, jnp.zeros(laws.log_weights.shape, jnp.int32), count)
