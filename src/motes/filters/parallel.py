"""The Kalman filter over all steps at once (Sarkka, Garcia-Fernandez 2021): a scan that needs log2(t) rounds in place of t.

Each step is an element: what it makes of any state before it, x | y ~ N(A x' + b, C), and the likelihood of its measurement in that state,
N(J^-1 eta, J^-1). Two neighbors combine to one, and the combination is associative. Ten times the operations, and worth it where there are
many processors, as on a GPU.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, linalg
from motes.core.logspace import RunningSum
from motes.core.loop import with_first
from motes.core.record import replace
from motes.core.types import Inputs, Measurements
from motes.filters import alarm, keep, notices, precision
from motes.filters.data import labelled_data
from motes.filters.history import Carry, History
from motes.filters.info import single
from motes.filters.needs import as_linear_model
from motes.gaussian.taylor import Linear, affine
from motes.laws.density import among, measured_in, zeroed
from motes.laws.gaussian import Gaussian
from motes.models.canonical import canonical, one_of
from motes.models.interface import Model
from motes.models.state_space import StateSpaceModel, at_step
from motes.tracing.compiling import jitted
from motes.tracing.identity import Beside


class _Element(NamedTuple):
    A: jax.Array
    b: jax.Array
    C: jax.Array
    eta: jax.Array
    J: jax.Array


def run_in_parallel(model: Model, ys: Measurements, inputs: Inputs = None) -> History:
    """Run the Kalman filter over all steps at once; the same as `run` with `KalmanFilter` up to rounding, in t times the memory.

    Args:
        model: linear, with Gaussian noises.
        ys: measurements `(t, y)`; NaN means not measured.
        inputs: tree with the time axis first, or None.

    Raises:
        MotesError: the model is not linear-Gaussian, or measurements and inputs do not fit it.
        CollapseError: a measurement lies beyond all reason (outside jit only).
    """
    ys, inputs, labels = labelled_data(model, ys, inputs)
    known = canonical(model, jax.tree.map(one_of, inputs), one_of(ys))
    exact, *found = _run(known, ys, inputs, Beside(known))
    if checks.is_concrete(exact) and bool(exact.any()):
        checks.refuse("run_in_parallel model", "noise of process or sensor in all that is measured (likelihoods of steps are joined)",
                      f"none at step {int(jnp.argmax(exact))}", "Use run with KalmanFilter.")
    traits = {"weighs": False, "subtracts": True, "circular": model.circular}
    kept, info, last, rounding = found
    history = History(kept, info, last, jnp.int32(0), model.names, "KalmanFilter() in parallel", rounding=rounding, **traits)
    if checks.is_concrete(history.info.collapsed):
        history.raise_on_collapse()
        notices.warn(history, None)
    return history.labelled(labels)


@jitted
def _run(model: Model, ys: jax.Array, inputs: Inputs, beside: Beside) -> tuple[Any, ...]:
    model, drive = model.independent()
    us = drive.over(inputs, ys)
    model = as_linear_model("run_in_parallel", model, at_step(us, 0))
    if model.sensor.angles:
        checks.refuse("run_in_parallel sensor", "no angles (they are wrapped about a prediction, which is not there yet)",
                      list(model.sensor.angles), "Use run with KalmanFilter.")
    t = jnp.arange(ys.shape[0], dtype=jnp.int32)
    first = Linear().measured(model.sensor, Gaussian(model.initial.mean(), model.initial.cov()), ys[0], at_step(us, 0), t[0])
    nothing = jnp.zeros_like(first.law.covariance)
    opening = _Element(nothing, first.law.center, first.law.covariance, jnp.zeros_like(first.law.center), nothing)
    others, exact = jax.vmap(lambda y, u, t: _element(model, y, u, t))(*jax.tree.map(lambda leaf: leaf[1:], (ys, us, t)))
    elements = with_first(opening, others)
    together = jax.lax.associative_scan(jax.vmap(_combined), elements)

    def evidence_of(b: jax.Array, C: jax.Array, y: jax.Array, u: Any, t: jax.Array) -> Any:
        return Linear().measured(model.sensor, Linear().through(model.dynamics, Gaussian(b, C), u, t), y, u, t)

    later = jax.vmap(evidence_of)(together.b[:-1], together.C[:-1], *jax.tree.map(lambda leaf: leaf[1:], (ys, us, t)))
    done = with_first(first, later)
    laws = done.law
    info = jax.vmap(single)(done)
    suspicion, rings = alarm.advanced_in_parallel(info.nis, info.freedom)
    info = replace(info, alarm=rings)
    evidence = RunningSum(jnp.sum(done.log_evidence), jnp.zeros((), ys.dtype))
    last = Carry(jax.tree.map(lambda leaf: leaf[-1], laws), evidence, suspicion, ys[-1], at_step(inputs, -1), t[-1])
    return jnp.append(False, exact), jax.vmap(keep.moments)(laws), info, last, precision.rounding(model, ys, at_step(us, 0))


def _element(model: StateSpaceModel, y: jax.Array, u: Any, t: jax.Array) -> tuple[_Element, jax.Array]:
    """Return a step as an element: x = F x' + c + noise of covariance Q, and y = H x + d + noise of covariance R.

    x' is the state before. Also tell whether the measurement says something of it without any noise, which no element can hold.
    """
    origin = jnp.zeros((model.size,), y.dtype)  # a linear model is the same about any point
    c, F, Q = affine(model.dynamics, origin, u, t)
    d, H, R = affine(model.sensor, origin, u, t)
    seen = measured_in(y, R)
    # what was not measured has no row in H, and a variance of one that tells nothing
    innovation = zeroed(model.sensor.residual(y, d + H @ c), seen)
    H, R = zeroed(H, seen, 2), among(R, seen)
    factor = linalg.cholesky(linalg.sandwich(H, Q) + R)
    gain = linalg.transpose(linalg.solve(factor, linalg.product(H, Q)))
    kept = linalg.identity_like(Q) - linalg.product(gain, H)
    back = linalg.product(H, F)
    element = _Element(
        linalg.product(kept, F),
        c + gain @ innovation,
        linalg.sandwich(kept, Q) + linalg.sandwich(gain, R),
        linalg.transpose(back) @ linalg.solve(factor, innovation),
        linalg.symmetric(linalg.product(linalg.transpose(back), linalg.solve(factor, back))),
    )
    return element, ~jnp.all(linalg.diagonal_of(factor) > 0)


def _combined(first: _Element, second: _Element) -> _Element:
    """Return two neighbors as one element (the paper's lemma 8)."""
    # (I + C J)^-1 = I - L (I + L' J L)^-1 L' J with C = L L': what is inverted is never near to singular
    lower = linalg.cholesky(first.C)
    left = linalg.product(linalg.transpose(lower), second.J)
    inner = linalg.cholesky(linalg.identity_like(lower) + linalg.product(left, lower))
    inverse = linalg.identity_like(lower) - linalg.product(lower, linalg.solve(inner, left))
    forward = linalg.product(second.A, inverse)
    backward = linalg.product(linalg.transpose(first.A), linalg.transpose(inverse))
    return _Element(
        linalg.product(forward, first.A),
        forward @ (first.b + first.C @ second.eta) + second.b,
        linalg.symmetric(linalg.product(linalg.product(forward, first.C), linalg.transpose(second.A)) + second.C),
        backward @ (second.eta - second.J @ first.b) + first.eta,
        linalg.symmetric(linalg.product(linalg.product(backward, second.J), first.A) + first.J),
    )
