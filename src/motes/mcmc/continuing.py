"""Whether chains can go on: with the density that they had, and with a state that keeps its form from step to step."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.mcmc.interface import Kernel, State

ROUNDING = 200
"""Units in the last place of a log density by which two compiled programs may differ; beside them 60 roots of one unit."""
NATS, SPREADS = 10.0, 5.0
"""How far an estimate that was kept may lie from new ones: so many nats, and so many times the range of these."""


def check_same(kept: jax.Array, anew: list[jax.Array], estimated: bool) -> None:
    """Refuse to go on with another density: steps would be judged against the values of the old one, and perhaps never be accepted.

    Args:
        kept: log densities that the chains ended with, `(chain,)`.
        anew: the same worked out now, `(chain,)` each, with random numbers of their own.
        estimated: whether the density is an estimate, or an exact function of random numbers that are kept.
    """
    old, new = np.asarray(kept, np.float64), np.asarray(anew, np.float64)
    middle, unit = np.median(new, axis=0), float(jnp.finfo(kept.dtype).eps)
    off = np.abs(old - middle)
    allowed = 60 * np.sqrt(unit) + ROUNDING * unit * np.abs(old)
    if estimated:
        allowed = NATS + SPREADS * (new.max(axis=0) - new.min(axis=0))
    wrong = ~(off <= allowed)
    if wrong.any():
        chain = int(np.argmax(wrong))
        given = f"{middle[chain]:.8g} there, in chain {chain}"
        checks.refuse("sample log_density", f"that of the chains, which ended at {old[chain]:.8g}", given,
                      "Start anew with another density: init=jax.tree.map(lambda leaf: leaf[0, -1], chains.positions), with a burn-in.")


def explain(kernel: Kernel, log_density: Any, states: State, reason: Exception) -> None:
    """Refuse a step whose state has another form than the one it began with; where it has the same, do nothing.

    Args:
        kernel: what makes the step.
        log_density: of a position.
        states: of all chains, before.
        reason: what JAX said.
    """
    before = jax.tree.map(lambda leaf: leaf[0], states)
    one = jax.eval_shape(lambda state: kernel.step(random.as_key(0), log_density, state, jnp.int32(0))[0], before)
    old, new = (dict(jax.tree_util.tree_flatten_with_path(tree)[0]) for tree in (before, one))
    kind = type(kernel).__name__
    if old.keys() != new.keys():
        checks.refuse(f"{kind} step", "a state of the form it began with", "another", str(reason).partition("\n")[0][:150])
    for path, leaf in old.items():
        was, found = (f"{part.dtype}{list(part.shape)}" for part in (leaf, new[path]))
        if was != found:
            checks.refuse(f"{kind} step: {jax.tree_util.keystr(path)[1:]}", f"{was}, as at the start", found,
                          "Give results the type of the position, by .astype(x.dtype), or start with theirs.")
