"""A Gaussian, or a block of them, for each mode of a jump-Markov system: moved, corrected and asked for what they expect mode by mode."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from motes.gaussian.association import conditioned
from motes.gaussian.rule import Rule
from motes.laws.gaussian import Correction, Gaussian
from motes.laws.mode_mixture import ModeMixture
from motes.models.jump_markov import JumpMarkovModel


def initial_gaussians(model: JumpMarkovModel) -> Gaussian:
    """Return the m Gaussians with the moments of the initial laws of the modes."""
    laws = [part.initial for part in model.models]
    return Gaussian(jnp.stack([law.mean() for law in laws], axis=-1), jnp.stack([law.cov() for law in laws], axis=-1))


def predicted(rule: Rule, model: JumpMarkovModel, blocks: Sequence[Gaussian], u: Any, t: Any) -> Gaussian:
    """Move a block of Gaussians by the dynamics of each mode.

    Args:
        rule: for moments.
        model: the system.
        blocks: a batch of k Gaussians for each mode.
        u: inputs of the step.
        t: the time moved to.

    Returns:
        All of them, means `(x, m k)` and covariances `(x, x, m k)`, mode after mode.
    """
    return _joined([rule.through(part.dynamics, block, u, t) for part, block in zip(model.models, blocks, strict=True)])


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
    done = [conditioned(rule, part.sensor, block, y, u, t) for part, block in zip(model.models, _blocks(model, law), strict=True)]
    evidence, max_log_evidence = (jnp.concatenate([getattr(one, name) for one in done]) for name in ("log_evidence", "max_log_evidence"))
    max_log_evidence = jnp.where(jnp.isfinite(law.log_weights), max_log_evidence, jnp.finfo(max_log_evidence.dtype).max)
    return Correction(_joined([one.law for one in done]), evidence, max_log_evidence)


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
    some = [jax.tree.map(lambda leaf: leaf[..., columns], block) for block in _blocks(model, law)]
    return _joined([rule.through(part.sensor, block, u, t) for part, block in zip(model.models, some, strict=True)])


def _blocks(model: JumpMarkovModel, law: ModeMixture) -> list[Gaussian]:
    centers, covs = (jnp.split(leaf, model.count, axis=-1) for leaf in (law.parts.center, law.parts.covariance))
    return [Gaussian(*block) for block in zip(centers, covs, strict=True)]


def _joined(blocks: list[Gaussian]) -> Gaussian:
    """Put batches of Gaussians one behind the other."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=-1), *blocks)
