"""Interacting multiple models (Blom, Bar-Shalom 1988): one extended Kalman filter for each mode of a jump-Markov system.

1. Mix: p(s_t = j) = sum over modes i of transition[i, j] p(s_{t-1} = i); the law of x_{t-1} given s_t = j is the sum over i of
   p(s_{t-1} = i | s_t = j) N(m_i, P_i), of which mean and covariance are kept.
2. Predict each mixed Gaussian by the dynamics of its mode.
3. Correct each by the sensor of its mode, and weigh the mode by the predictive density of y.

Mixing is the one approximation for linear models. Where the modes agree on the state it costs nothing: without uncertain states the filter
is the forward recursion of a hidden Markov model.
"""

from typing import Any

import jax
import jax.numpy as jnp

from motes.core import linalg
from motes.core.record import record, replace
from motes.filters.clouds import correct_modes
from motes.filters.gated import Gated
from motes.filters.info import Info
from motes.filters.interface import Guide, TwoStageFilter
from motes.filters.needs import as_jump_markov
from motes.gaussian.modes import initial_gaussians, predicted
from motes.gaussian.rule import Rule, check_rule
from motes.gaussian.taylor import Taylor
from motes.laws.gaussian import Gaussian
from motes.laws.mixture import moments_each
from motes.laws.mode_mixture import ModeMixture
from motes.laws.switching import log_probabilities
from motes.models.jump_markov import JumpMarkovModel


@record
class InteractingMultipleModel(Gated, TwoStageFilter[ModeMixture]):
    """Interacting multiple models; the state is a `ModeMixture` of one Gaussian for each mode, and `info.ess` counts modes.

    Source: Blom, Bar-Shalom 1988, The interacting multiple model algorithm for systems with Markovian switching coefficients.

    Example:
        >>> model = mo.textbook.maneuvers()
        >>> xs, ys = mo.simulate(0, model, 50)
        >>> mo.run(1, mo.InteractingMultipleModel(), model, ys).mean.shape
        (50, 4)

    Attributes:
        rule: how moments are taken through the functions of each mode: `mo.gaussian.Taylor(iterations)`, or sigma points such as
            `mo.gaussian.Cubature()`.
    """

    subtracts = True
    light = True
    guide = Guide(
        needs="m modes with mean functions and noise covariances",
        cost="m x^3",
        use="a model that switches between a few modes, each mildly nonlinear",
    )

    rule: Rule = Taylor()

    def check_parameters(self) -> None:
        """Check the parameters.

        Raises:
            MotesError: the rule is none, or has a parameter that it cannot have.
        """
        check_rule("InteractingMultipleModel", self.rule)

    def prepare(self, model: Any, u: Any) -> JumpMarkovModel:
        """Ask for means and covariances of dynamics and sensor of every mode.

        Raises:
            MotesError: one of them has none, or the value is no model.
        """
        model = as_jump_markov("InteractingMultipleModel", model)
        self.rule.check_size("InteractingMultipleModel", model.size)
        return model

    def init(self, key: jax.Array, model: JumpMarkovModel) -> ModeMixture:
        """Return the Gaussians with the moments of the initial laws."""
        modes = jnp.arange(model.count, dtype=jnp.int32)
        return ModeMixture(initial_gaussians(model), log_probabilities(model.initial_mode), modes, model.count)

    def predict(self, key: jax.Array, model: JumpMarkovModel, state: ModeMixture, u: Any, t: Any) -> ModeMixture:
        """Mix (step 1), then move each mode (step 2)."""
        # 1. mix
        joint = state.log_weights[:, None] + model.log_transition(u, t)
        log_weights = jax.nn.logsumexp(joint, axis=0)
        possible = jnp.isfinite(log_weights)
        log_mixing = jnp.where(possible, joint - jnp.where(possible, log_weights, 0), state.log_weights[:, None])
        between = moments_each(log_mixing, jnp.broadcast_to(state.parts.center[..., None], (*state.parts.center.shape, model.count)))
        counted = jnp.where(jnp.isfinite(state.log_weights), state.parts.covariance, 0)
        within = jnp.einsum("abi,ij->abj", counted, jnp.exp(log_mixing), precision=jax.lax.Precision.HIGHEST)
        center, cov = between.center, linalg.symmetric(between.covariance + within)
        mixed = jax.tree.map(lambda leaf: leaf[..., None], Gaussian(center, cov))
        # 2. predict
        return replace(state, parts=predicted(self.rule, model, mixed, u, t), log_weights=log_weights)

    def correct(
        self, key: jax.Array, model: JumpMarkovModel, state: ModeMixture, y: jax.Array, u: Any, t: Any
    ) -> tuple[ModeMixture, Info]:
        """Condition each mode's Gaussian on y, and weigh the modes (step 3)."""
        return correct_modes(self.rule, model, state, y, u, t)
