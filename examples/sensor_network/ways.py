"""Four ways to track with all nodes: bearings in one place, summed increments, consensus, and each node alone.

What a bearing tells is the increment that it makes in the information form of a Gaussian, (P^-1, P^-1 m): bearings are independent given
the target, so their increments add up (Hlinka, Hlawatsch, Djuric 2013 survey such filters).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from model import of_a_node, of_all_nodes
from network import Network

import motes as mo


def information(law: mo.Gaussian) -> tuple[jax.Array, jax.Array]:
    """Return P^-1 m `(x,)` and P^-1 `(x, x)`."""
    matrix = jnp.linalg.inv(law.cov())
    return matrix @ law.mean(), matrix


def added(law: mo.Gaussian, vector: jax.Array, matrix: jax.Array) -> mo.Gaussian:
    """Return a law with increments added."""
    own, known = information(law)
    cov = jnp.linalg.inv(known + matrix)
    cov = 0.5 * (cov + cov.T)
    return mo.Gaussian(cov @ (own + vector), cov)


def increment(key: jax.Array, filter: mo.Filter, model: Any, law: mo.Gaussian, y: jax.Array, place: jax.Array, t: Any) -> Any:
    """Return what a node's own bearing `(1,)` adds to its law, `(x,)` and `(x, x)`; nothing where it does not see the target."""
    after, _ = filter.update(key, model, law, y, place, t)
    return jax.tree.map(jnp.subtract, information(after), information(law))


def together(key: jax.Array, filter: mo.filters.TwoStageFilter, network: Network, ys: jax.Array, shared: Any) -> jax.Array:
    """Track with a law in each node, and share increments after each step; return the means `(t, nodes, x)`.

    Args:
        key: of the run.
        filter: whose law is a `mo.Gaussian`.
        network: of the nodes.
        ys: bearings `(t, nodes)`.
        shared: gives each node a sum of what all of them found: `(nodes, ...)` to `(nodes, ...)`.
    """
    places = jnp.asarray(network.places, ys.dtype)
    model = filter.prepare(of_a_node(), places[0])

    def predicted(key, laws, t):
        # one key for all: nodes that know the same draw the same
        return jax.vmap(lambda law, place: filter.predict(key, model, law, place, t))(laws, places)

    def corrected(key, laws, y, t):
        keys = jax.random.split(key, len(places))
        found = jax.vmap(lambda *node: increment(node[0], filter, model, *node[1:], t))(keys, laws, y[:, None], places)
        return jax.vmap(added)(laws, *jax.tree.map(shared, found))

    def step(laws, row):
        t, y = row
        move, see = jax.random.split(jax.random.fold_in(key, t))
        laws = jax.lax.cond(t > 0, lambda: predicted(move, laws, t), lambda: laws)
        laws = corrected(see, laws, y, t)
        return laws, laws.mean()

    first = jax.vmap(lambda _: filter.init(key, model))(places)
    return jax.lax.scan(step, first, (jnp.arange(len(ys)), ys))[1]


def in_one_place(key: jax.Array, filter: mo.Filter, network: Network, ys: jax.Array) -> jax.Array:
    """Track with all bearings in one place; return the means `(t, 1, x)`."""
    return mo.run(key, filter, of_all_nodes(network), ys).mean[:, None]


def alone(key: jax.Array, filter: mo.Filter, network: Network, ys: jax.Array) -> jax.Array:
    """Let each node track with its own bearings; return the means `(t, nodes, x)`."""

    def one(y, place):
        return mo.run(key, filter, of_a_node(), y[:, None], jnp.broadcast_to(place, (len(y), 2))).mean

    return jax.vmap(one, in_axes=(1, 0), out_axes=1)(ys, jnp.asarray(network.places, ys.dtype))


def summed(found: jax.Array) -> jax.Array:
    """Add up exactly what nodes found `(nodes, ...)`: each gets the sum of all."""
    return jnp.broadcast_to(jnp.sum(found, axis=0), found.shape)


def agreed(network: Network, rounds: int) -> Any:
    """Return a function that adds up by rounds of averages with neighbors: each node gets so many times its average as there are nodes."""
    weights = jnp.asarray(np.linalg.matrix_power(network.averaging, rounds), jnp.float32)
    return lambda found: found.shape[0] * jnp.tensordot(weights, found, axes=1)
