"""Rao-Blackwellized particle filter for jump-Markov systems (Doucet, Gordon, Krishnamurthy 2001; Fearnhead, Clifford 2003).

A particle carries a path of modes, drawn values of the states named, and the Gaussian of the other states given those.

1. Merge hypotheses that agree in their last modes, where that is asked for (generalized pseudo-Bayes: Tugnait 1982).
   Bring the hypotheses of the step before down to n particles, unbiased: without copies (`resampling/reduction.py`), or, where states are
   drawn and few hypotheses have most of the weight, with copies, which then part by their draws.
2. Predict: each particle goes on in all m modes, by the extended Kalman filter of each, which gives n m hypotheses weighted by the
   transition probabilities. States that are drawn are drawn from the prediction; the rest is conditioned on the draw.
3. Correct each hypothesis by the sensor of its mode, and weigh it by its predictive density of y.

Nothing but the reduction is random where no state is drawn: while at most n paths of modes have weight the filter sums over all of them.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, logspace, random
from motes.core.record import record, replace, static
from motes.filters.clouds import correct_modes
from motes.filters.gated import Gated
from motes.filters.info import Info
from motes.filters.interface import FEW, Guide, TwoStageFilter
from motes.filters.needs import as_jump_markov
from motes.gaussian.modes import initial_gaussians, predicted
from motes.gaussian.rule import Rule, check_rule
from motes.gaussian.taylor import Taylor
from motes.laws.gaussian import Gaussian
from motes.laws.mode_mixture import ModeMixture
from motes.laws.switching import log_probabilities
from motes.models.certain import certain
from motes.models.jump_markov import JumpMarkovModel
from motes.resampling import gradients
from motes.resampling.reduction import Reduction, reduced
from motes.resampling.schemes import Systematic

FEW_PARTICLES = 128
"""So many and fewer are not worth sharing out among threads."""


@record
class JumpMarkovFilter(Gated, TwoStageFilter[ModeMixture]):
    """Rao-Blackwellized jump-Markov filter; the state is a `ModeMixture` of n m hypotheses, which `info.ess` counts.

    Source: Doucet, Gordon, Krishnamurthy 2001, Particle filters for state estimation of jump Markov linear systems; Fearnhead, Clifford
    2003, On-line inference for hidden Markov models via particle filters; Tugnait 1982, Detection and estimation for abruptly changing
    systems.

    Example:
        >>> model = mo.textbook.maneuvers()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.JumpMarkovFilter(n=20), model, ys).mean.shape
        (50, 4)

    Attributes:
        n: number of particles that are kept from step to step.
        sampled: states that particles draw, by name or index: those in which dynamics or sensors are too curved for an extended Kalman
            filter. Given them, linear models are exact.
        rule: how moments are taken through the functions of each mode: `mo.gaussian.Taylor(iterations)`, or sigma points such as
            `mo.gaussian.Cubature()`.
        lag: number of earlier modes that each particle remembers, for `state.delayed_mode_probabilities()`; `run` sees to it where
            `keep=mo.keep.modes(lag=4)` asks for them.
        merge: number of last modes such that hypotheses that agree in them are merged to one Gaussian with the moments of all, before
            they are brought down to n (generalized pseudo-Bayes of that order: Tugnait 1982); 0 for none. States that are found to have
            no variance have to agree, too. Modes before these, which a particle remembers, are those of the heaviest. Particles are then
            not wasted on old modes that make no difference any more, but the likelihood is not unbiased.
    """

    subtracts = True
    guide = Guide(
        needs="m modes with additive Gaussian noises",
        cost="n m x^3",
        use="a model that switches between modes whose past matters, or with a few strongly nonlinear states",
    )

    n: int = static()
    sampled: tuple[str | int, ...] = static(default=())
    rule: Rule = Taylor()
    lag: int = static(default=0)
    merge: int = static(default=0)

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: n is not a positive whole number, lag or merge is negative or none, the rule is none or has a parameter that it
                cannot have, or particles that draw states are to be merged.
        """
        checks.positive_integer("JumpMarkovFilter n", self.n)
        checks.natural("JumpMarkovFilter lag", self.lag)
        check_rule("JumpMarkovFilter", self.rule)
        checks.natural("JumpMarkovFilter merge", self.merge)
        object.__setattr__(self, "sampled", (self.sampled,) if isinstance(self.sampled, (str, int)) else tuple(self.sampled))
        if self.merge and self.sampled:
            checks.refuse("JumpMarkovFilter merge", "0 where states are sampled, in which particles differ", self.merge)
        object.__setattr__(self, "lag", max(self.lag, self.merge - 1))

    def remembering(self, lag: int) -> "JumpMarkovFilter":
        """Return the filter with particles that remember at least so many modes."""
        return replace(self, lag=max(lag, self.lag))

    def is_light(self, model: Any) -> bool:
        """See `Filter`."""
        return self.n <= FEW_PARTICLES and model.size <= FEW

    def prepare(self, model: Any, u: Any) -> JumpMarkovModel:
        """Ask for means and covariances of dynamics and sensor of every mode.

        Raises:
            MotesError: one of them has none, there is no such state, or the value is no model.
        """
        model = as_jump_markov("JumpMarkovFilter", model)
        self.rule.check_size("JumpMarkovFilter", model.size)
        if self._drawn_states(model) or self.rule != Taylor():
            return model
        return replace(model, certain=certain(model.models, model.noiseless, model.shared, u))

    def _drawn_states(self, model: JumpMarkovModel) -> tuple[int, ...]:
        return tuple(sorted({model.index(state) for state in self.sampled}))

    def _hypotheses(
        self, key: jax.Array, model: JumpMarkovModel, parts: Gaussian, log_weights: jax.Array, earlier: jax.Array
    ) -> ModeMixture:
        """Draw the states to be drawn (end of step 2); parts `(x, m n)` and weights `(m, n)` come mode after mode, earlier modes once."""
        states = self._drawn_states(model)
        if states:
            parts = parts.pinned(states, random.normal(key, (len(states), parts.center.shape[-1]), parts.center.dtype))
        modes = jnp.repeat(jnp.arange(model.count, dtype=jnp.int32), self.n)
        remembered = jnp.tile(earlier[: self.lag], model.count) if self.lag else None
        return ModeMixture(parts, log_weights.reshape(-1), modes, model.count, remembered)

    def init(self, key: jax.Array, model: JumpMarkovModel) -> ModeMixture:
        """Give each mode the Gaussian with the moments of its initial law: once, or n times where states are drawn."""
        parts = jax.tree.map(lambda leaf: jnp.repeat(leaf, self.n, axis=-1), initial_gaussians(model))
        equal = logspace.uniform_weights(self.n, model.dtype)
        among = equal if self.sampled else jnp.where(jnp.arange(self.n) == 0, jnp.zeros_like(equal), -jnp.inf)
        never = jnp.full((self.lag, self.n), -1, jnp.int32)
        return self._hypotheses(key, model, parts, log_probabilities(model.initial_mode)[:, None] + among, never)

    def _reduced(self, key: jax.Array, log_weights: jax.Array) -> Reduction:
        """Choose n of the hypotheses (step 1)."""
        if not self.sampled:
            return reduced(key, log_weights, self.n)

        def copied() -> Reduction:
            ancestors = Systematic().ancestors(key, log_weights, self.n)
            return Reduction(ancestors, logspace.uniform_weights(self.n, log_weights.dtype))

        few = logspace.effective_size(log_weights) < 0.5 * self.n
        return jax.lax.cond(few, copied, lambda: reduced(key, log_weights, self.n))

    def predict(self, key: jax.Array, model: JumpMarkovModel, state: ModeMixture, u: Any, t: Any) -> ModeMixture:
        """Merge hypotheses and bring them down to n (step 1), and move each in every mode (step 2)."""
        state = state.merged(self.merge, model.certain) if self.merge else state
        ancestors, log_weights = self._reduced(random.child(key, random.RESAMPLE), state.log_weights)
        kept, log_weights = gradients.noticed((state.resampled(ancestors), log_weights))
        log_transition = model.log_transition(u, t)[kept.part_modes].T
        moved = predicted(self.rule, model, jax.tree.map(lambda leaf: leaf[..., None, :], kept.parts), u, t)
        earlier = kept.part_modes[None]
        if kept.earlier_modes is not None:
            earlier = jnp.concatenate([earlier, kept.earlier_modes])
        return self._hypotheses(random.child(key, random.NOISE), model, moved, log_weights + log_transition, earlier)

    def correct(
        self, key: jax.Array, model: JumpMarkovModel, state: ModeMixture, y: jax.Array, u: Any, t: Any
    ) -> tuple[ModeMixture, Info]:
        """Weigh each hypothesis by its predictive density of y, and correct its Gaussian (step 3)."""
        return correct_modes(self.rule, model, state, y, u, t)
