"""States without variance: symbols that were sent, delays of them, constants. A Kalman filter need not carry them in covariances.

Such a state has none at first, process noise gives it none, and the dynamics make it of such states alone. The first two are read off the
numbers before anything is compiled, while they are known; the last off the traced dynamics of all modes.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import is_concrete
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.switching import WithMode
from motes.models.state_space import StateSpaceModel
from motes.tracing.affinity import dependence


def noiseless(models: Sequence[StateSpaceModel]) -> tuple[int, ...]:
    """Return the states that have no variance at first, nor process noise where that is no function, in any of several models."""
    found = np.ones(models[0].size, bool)
    for model in models:
        if not isinstance(model.initial, Gaussian) or not isinstance(model.dynamics, AdditiveGaussian):
            return ()
        found &= _without(model.initial.covariance)
        if not callable(model.dynamics.Q):
            found &= _without(model.dynamics.Q)
    return tuple(np.flatnonzero(found).tolist())


def _without(cov: Any) -> np.ndarray:
    """Tell of each state whether its row of a covariance `(x, x)` is known to be zero."""
    return ~(np.asarray(cov) != 0).any(axis=0) if is_concrete(cov) else np.zeros(cov.shape[0], bool)


def certain(models: Sequence[StateSpaceModel], candidates: Sequence[int], shared: bool, u: Any) -> tuple[int, ...]:
    """Return those of the states named by `noiseless` that never get any variance from dynamics of any mode.

    Args:
        models: of the modes, or the one that all share.
        candidates: what `noiseless` found.
        shared: whether it is one, whose functions find the mode among their inputs.
        u: inputs of a step, or their shapes.
    """
    if not candidates:
        return ()
    size, kinds = models[0].size, ("fixed", "elements", "whole", "whole")
    x, t = jax.ShapeDtypeStruct((size,), models[0].dtype), jax.ShapeDtypeStruct((), jnp.int32)
    moved, noisy = np.zeros((size, size), bool), np.zeros(size, bool)
    for model in models:
        given = (model.dynamics, x, WithMode(u, t) if shared else u, t)
        moved |= dependence(lambda part, x, u, t: part.mean(x, u, t), given, kinds).uses[:, :size]
        if callable(model.dynamics.Q):  # type: ignore[attr-defined]
            # what is zero whatever the variables are has no use for a factor
            factor = jax.ShapeDtypeStruct((), x.dtype)
            scaled = dependence(lambda part, x, u, t, s: s * part.cov(x, u, t), (*given, factor), (*kinds, "whole"))
            noisy |= scaled.uses[..., -1].any(axis=0)
    kept = np.isin(np.arange(size), candidates) & ~noisy
    while (wrong := kept & moved[:, ~kept].any(axis=1)).any():
        kept &= ~wrong
    return tuple(np.flatnonzero(kept).tolist())
