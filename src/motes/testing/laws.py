"""Rules of a filter as a value, and of its law. Each returns what is wrong, or None."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core.checks import MotesError
from motes.core.record import replace, values
from motes.testing.session import Session, quietly


def value(session: Session) -> str | None:
    """A filter is a value: it equals, hashes and prints by its parameters, and refuses a policy that there is not."""
    filter = session.filter
    kind, again = type(filter), replace(filter)
    if again != filter or hash(again) != hash(filter):
        return "a copy with the same parameters is not equal to it, or has another hash."
    if kind.__name__ not in repr(filter):
        return f"it prints as {filter!r:.80}, without the name of its class."
    try:
        kind(**{**values(filter), "on_collapse": "ignore"})
    except MotesError:
        return None
    return "on_collapse='ignore' is not refused."


def form(session: Session) -> str | None:
    """Its law has one form at all steps, in float32 and float64; found without computing anything."""
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"), quietly():
            model, ys = _as(precision, (session.model, session.ys))
            try:
                # the loop over steps asks for one form
                state = jax.eval_shape(lambda model, ys: session.run(ys[:2], model=model), model, ys).state
            except TypeError as reason:
                return f"the law after a step has another form than before it ({' '.join(str(reason).split())[:240]}...)."
        others = {str(leaf.dtype) for leaf in jax.tree.leaves(state) if jnp.issubdtype(leaf.dtype, jnp.floating)} - {precision}
        if others:
            return f"given a model in {precision} its law holds numbers of {', '.join(sorted(others))}."
    return None


def _as(precision: str, tree: Any) -> Any:
    def turned(leaf: Any) -> Any:
        return np.asarray(leaf).astype(precision) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

    return jax.tree.map(turned, tree)


def answers(session: Session) -> str | None:
    """Its law answers mean, covariance and draws, which agree with one another."""
    state = session.clean.state
    mean, cov, size = np.asarray(state.mean()), np.asarray(state.cov()), session.model.size
    draws = np.asarray(jax.jit(lambda state: state.sample(jax.random.key(0), 40_000))(state))
    shapes = (mean.shape, cov.shape, draws.shape)
    if shapes != ((size,), (size, size), (size, 40_000)):
        return f"mean, covariance and draws of {size} states have shapes {shapes}."
    spread = np.sqrt(np.diagonal(cov))
    # five standard errors of 40 000 draws
    off = np.abs(draws.mean(axis=1) - mean) / (spread / 200 + 1e-6)
    if not (off < 5).all():
        return f"the mean of 40 000 draws is {np.max(off):.3g} standard errors off."
    if not np.allclose(np.cov(draws), cov, atol=0.05 * spread.max() ** 2):
        off = np.abs(np.cov(draws) - cov).max()
        return f"the covariance of 40 000 draws differs by {off:.3g} (the largest variance is {spread.max() ** 2:.3g})."
    return None
