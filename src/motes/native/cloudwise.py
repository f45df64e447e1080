"""The stages of filters with clouds on the native engine: each as one fused kernel where the model translates."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import eval_jaxpr

from motes.core import engine, logspace
from motes.core.engine import CompileError
from motes.core.record import replace
from motes.native import blocks, report
from motes.native.rules import Untranslatable
from motes.native.stage import Stage, call_move, call_weigh, judgement, movement
from motes.native.translate import traced
from motes.resampling.policy import Never, Policy
from motes.resampling.schemes import Given, Scheme


class Parts:
    """A cloud taken apart into arrays with the particle axis, and the rest."""

    def __init__(self, cloud: Any):
        """Find which arrays have the particle axis, by asking for one particle more."""
        n = cloud.log_weights.shape[0]
        leaves, self.tree = jax.tree.flatten(cloud)
        probe = jax.eval_shape(lambda cloud: cloud.resampled(jnp.zeros((n + 1,), jnp.int32)), cloud)
        own = (id(cloud.log_weights), id(getattr(cloud, "ancestors", None)))
        self.places = [
            i for i, (leaf, other) in enumerate(zip(leaves, jax.tree.leaves(probe), strict=True))
            if leaf.shape != other.shape and id(leaf) not in own
        ]  # fmt: skip
        self.leaves = leaves
        self.lanes = [leaves[i] for i in self.places]
        self.weights = [i for i, leaf in enumerate(leaves) if id(leaf) in own]
        self.rest = [i for i in range(len(leaves)) if i not in self.places and i not in self.weights]

    def cloud(self, lanes: Sequence[jax.Array]) -> Any:
        """Put a cloud of any number of particles together; nothing may look at its weights."""
        n = lanes[0].shape[-1]
        leaves = [jnp.zeros((n,), leaf.dtype) if i in self.weights else leaf for i, leaf in enumerate(self.leaves)]
        for i, lane in zip(self.places, lanes, strict=True):
            leaves[i] = lane
        return jax.tree.unflatten(self.tree, leaves)

    def apart(self, cloud: Any) -> list[jax.Array]:
        """Return the arrays with the particle axis first, then the rest without the weights."""
        leaves = jax.tree.leaves(cloud)
        return [leaves[i] for i in [*self.places, *self.rest]]

    def together(self, cloud: Any, arrays: Sequence[jax.Array]) -> Any:
        """Undo `apart`, with weights and ancestors of a cloud."""
        leaves = jax.tree.leaves(cloud)
        for i, array in zip([*self.places, *self.rest], arrays, strict=True):
            leaves[i] = array
        return jax.tree.unflatten(self.tree, leaves)


def resample_and_move(keys: tuple[Any, Any], scheme: Scheme, policy: Policy, cloud: Any, move: Callable[[Any, Any], Any]) -> Any:
    """Resample where the policy says so and move, fused; None where that cannot be. See `filters.clouds`."""
    children = scheme.indices.shape[0] if isinstance(scheme, Given) else cloud.log_weights.shape[0]
    parts = _parts("move", cloud, children)
    if parts is None:
        return None
    chosen = blocks.ancestors(keys[0], scheme, policy, cloud.log_weights)
    if chosen is None:
        return report.note("move", report.KERNELS, f"{type(scheme).__name__} resampling")
    ancestors, log_weights = chosen

    def function(*lanes: jax.Array) -> list[jax.Array]:
        return parts.apart(move(keys[1], parts.cloud(lanes)))

    stage = _attempt("move", partial(movement, resampled=not isinstance(policy, Never)), function, parts)
    if stage is None:
        return None
    program = traced(function, parts.lanes, children)

    def native(shared: Any, ancestors: jax.Array, lanes: Any, consts: Any) -> list[jax.Array]:
        return call_move(stage, shared, ancestors, lanes)

    def pure(shared: Any, ancestors: jax.Array, lanes: Any, consts: Any) -> list[jax.Array]:
        return eval_jaxpr(program.jaxpr, consts, *(lane[..., ancestors] for lane in lanes))[: len(lanes)]

    moved = blocks.differentiable(native, pure)(stage.shared, ancestors, parts.lanes, program.consts)
    marks = {"ancestors": ancestors} if cloud.marks_ancestors else {}
    return replace(parts.together(cloud, [*moved, *stage.rest]), log_weights=log_weights, **marks)


def update_weights(cloud: Any, likelihood_of: Callable[[Any], tuple[Any, jax.Array, jax.Array]]) -> tuple[Any, jax.Array] | None:
    """Correct and weigh, fused; None where that cannot be. See `filters.clouds`."""
    parts = _parts("weigh", cloud, cloud.log_weights.shape[0])
    if parts is None:
        return None

    def function(*lanes: jax.Array) -> list[jax.Array]:
        after, likelihood, max_log_likelihood = likelihood_of(parts.cloud(lanes))
        return [likelihood, max_log_likelihood, *parts.apart(after)]

    stage = _attempt("weigh", judgement, function, parts)
    if stage is None:
        return None
    program = traced(function, parts.lanes, cloud.log_weights.shape[0])

    def native(shared: Any, log_weights: jax.Array, lanes: Any, consts: Any) -> tuple[jax.Array, jax.Array, list[jax.Array]]:
        return call_weigh(stage, shared, log_weights, lanes)

    def pure(shared: Any, log_weights: jax.Array, lanes: Any, consts: Any) -> tuple[jax.Array, jax.Array, list[jax.Array]]:
        likelihood, max_log_likelihood, *outs = eval_jaxpr(program.jaxpr, consts, *lanes)
        return *engine.original(logspace.joint_weights)(log_weights, likelihood, max_log_likelihood), outs[: len(lanes)]

    given = (stage.shared, cloud.log_weights, parts.lanes, program.consts)
    weights, found, lanes = blocks.differentiable(native, pure)(*given)
    return replace(parts.together(cloud, [*lanes, *stage.rest]), log_weights=weights), found


def left_to_jax(stage: str, cloud: Any, why: str) -> None:
    """Note why a stage of a cloud is left to JAX, between native kernels for random numbers, resampling and weights."""
    if _parts(stage, cloud, cloud.log_weights.shape[0]) is not None:
        report.note(stage, report.KERNELS, why)


def _parts(stage: str, cloud: Any, n: int) -> Parts | None:
    """Take a cloud apart, where the native engine is to be used on n particles of it."""
    if engine.chosen() == "jax":
        return None
    if cloud.log_weights.dtype not in blocks.PRECISIONS:
        return report.note(stage, report.JAX, f"particles of type {cloud.log_weights.dtype}")
    if n < blocks.fewest():
        return report.note(stage, report.JAX, f"fewer than {blocks.fewest()} particles")
    if blocks.standing():
        return report.note(stage, report.JAX, blocks.standing())
    parts = Parts(cloud)
    return parts if parts.lanes else report.note(stage, report.JAX, "no particles")


def _attempt(name: str, translate: Callable[..., Stage], function: Callable[..., Any], parts: Parts) -> Stage | None:
    try:
        stage = translate(function, parts.lanes)
    except (Untranslatable, CompileError) as reason:
        return report.note(name, report.KERNELS, str(reason))
    report.note(name, report.FUSED, f"{stage.size} scalar operations")
    return stage
