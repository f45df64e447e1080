"""Derivatives of runs that resample: picking particles is a jump, and most schemes leave it out of the derivative, which is then wrong.

What is differentiated is known to JAX alone, while it traces: arrays pass through a function that does nothing but warn when it is asked
for its derivative.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from motes.core import checks

T = TypeVar("T")


@jax.custom_jvp
def _with_warning(leaves: list[jax.Array]) -> list[jax.Array]:
    return leaves


@_with_warning.defjvp
def _tell(primals: Any, tangents: Any) -> tuple[Any, Any]:
    checks.warn(
        "the derivative of a run that resamples leaves out how the picking of particles depends on the parameters: it is not that of the "
        "log likelihood. Use scheme=mo.resampling.StopGradient(mo.resampling.Systematic()), or a filter that does not resample."
    )
    return primals[0], tangents[0]


def loses(scheme: Any, policy: Any) -> bool:
    """Tell whether resampling by a scheme, where a policy says so, loses derivatives."""
    return not (getattr(scheme, "has_gradient", False) or policy.needed(jnp.zeros(2)) is False)


def noticed(tree: T) -> T:
    """Return a tree as it is, and warn when it is differentiated."""
    leaves, form = jax.tree.flatten(tree)
    places = [i for i, leaf in enumerate(leaves) if jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)]
    for i, leaf in zip(places, _with_warning([leaves[i] for i in places]), strict=True):
        leaves[i] = leaf
    return jax.tree.unflatten(form, leaves)
