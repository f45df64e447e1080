"""A Gaussian, or a block of them, for each mode of a jump-Markov system: moved, corrected and asked for what they expect mode by mode."""

from typing import Any

import jax
import jax.numpy as jnp

from motes.gaussian.association import conditioned
from motes.gaussian.rule import Rule
from motes.gaussian.rule import conditioned as conditioned_near
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Correction, Gaussian
from motes.laws.mode_mixture import ModeMixture
from motes.models.jump_markov import JumpMarkovModel
from motes.models.state_space import StateSpaceModel


def initial_gaussians(model: JumpMarkovModel) -> Gaussian:
    """Return the m Gaussians with the moments of the initial laws of the modes."""
    laws = [part.initial for part in model.models]
    found = Gaussian(jnp.stack([law.mean() for law in laws], axis=-1), jnp.stack([law.cov() for law in laws], axis=-1))
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (*leaf.shape[:-1], model.count)), found)


def predicted(rule: Rule, model: JumpMarkovModel, blocks: Gaussian, u: Any, t: Any) -> Gaussian:
    """Move a block of Gaussians by the dynamics of each mode.

    Args:
        rule: for moments.
        model: the system.
        blocks: k Gaussians for each mode, means `(x, m, k)` and covariances `(x, x, m, k)`; or, with an axis of one in place of m, for all.
        u: inputs of the step.
        t: the time moved to.

    Returns:
        All of them, means `(x, m k)` and covariances `(x, x, m k)`, mode after mode.
    """
    spread = model.spread

    def of_one(part: StateSpaceModel, u: Any, block: Gaussian) -> Gaussian:
        near = rule.linearized(part.dynamics, block, u, t)
        if not model.certain:
            return near.over(block)
        return Gaussian(near.prediction, block.covariance).with_marginal(spread, near.of(spread).over(block, spread))

    return _joined(model.in_each_mode(u, of_one, blocks))


def measured(rule: Rule, model: JumpMarkovModel, law: ModeMixture, y: jax.Array, u: Any, t: Any) -> Correction:
    """Condition each component on a measurement `(y,)` through the sensor of its mode.

    Args:
        rule: for moments.
        model: the system.
        law: its components come in m blocks of equal length, one for each mode in order.
        y: the measurement; NaN means not measured; or the scan.
        u: inputs of the step.
        t: the time.

    Returns:
        The correction; components without weight have the highest maximum there is, so that a good fit of theirs hides no collapse.
    """

    def of_one(part: StateSpaceModel, u: Any, block: Gaussian) -> tuple[Gaussian, jax.Array, jax.Array]:
        if model.certain and isinstance(part.sensor, AdditiveGaussian):
            done = conditioned_near(part.sensor, block, y, rule.linearized(part.sensor, block, u, t), model.certain)
        else:
            done = conditioned(rule, part.sensor, block, y, u, t)
        return done.law, done.log_evidence[None], done.max_log_evidence[None]

    after, evidence, highest = _joined(model.in_each_mode(u, of_one, _blocks(model, law)))
    highest = jnp.where(jnp.isfinite(law.log_weights), highest[0], jnp.finfo(highest.dtype).max)
    return Correction(after, evidence[0], highest)


def expected(rule: Rule, model: JumpMarkovModel, law: ModeMixture, columns: jax.Array, u: Any, t: Any) -> Gaussian:
    """Return what some components expect to measure: means `(y, m k)`, covariances `(y, y, m k)`, mode after mode.

    Args:
        rule: for moments.
        model: the system.
        law: see `measured`.
        columns: places `(k,)` within each block.
        u: inputs of the step.
        t: the time.
    """
    some = jax.tree.map(lambda leaf: leaf[..., columns], _blocks(model, law))
    spread = model.spread if model.certain else None
    return _joined(model.in_each_mode(u, lambda part, u, block: rule.linearized(part.sensor, block, u, t).over(block, spread), some))


def _blocks(model: JumpMarkovModel, law: ModeMixture) -> Gaussian:
    return jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape[:-1], model.count, -1), law.parts)


def _joined(blocks: Any) -> Any:
    """Put batches `(..., m, k)` one behind the other, `(..., m k)`."""
    return jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape[:-2], -1), blocks)
