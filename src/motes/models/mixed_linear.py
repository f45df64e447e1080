"""Mixed linear models: all of x_k is linear-Gaussian once the path of x_p is known (Schon, Gustafsson, Nordlund 2005, model 3)."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random
from motes.core.record import record, static
from motes.core.types import Inputs
from motes.laws.conditional import AdditiveGaussian
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law, as_law, drawn
from motes.models.interface import Model, Wrap, exchanged
from motes.models.state_space import StateSpaceModel


class Affine(NamedTuple):
    """f + A x_k + noise of covariance Q, at one particle.

    Attributes:
        f: `(z,)`.
        A: `(z, k)`.
        Q: `(z, z)`.
    """

    f: jax.Array
    A: jax.Array
    Q: jax.Array


AffineFunction = Callable[[jax.Array, Any, Any], tuple[jax.Array, jax.Array, jax.Array]]


@record
class MixedLinearModel(Model):
    """A model whose states are split into a particle part x_p and a Kalman part x_k.

    Attributes:
        initial_p: law of x_p at step 0, `(p,)`.
        initial_k: law of x_k at step 0, `(k,)`, or (with `initial_gain`) its law given x_p at the mean of x_p.
        particle: `(x_p, u, t)` to `(f, A, Q)`: x_p' = f + A x_k + noise.
        kalman: `(x_p, u, t)` to `(f, A, Q)`: x_k' = f + A x_k + noise.
        sensor: `(x_p, u, t)` to `(f, A, Q)`, that is `(h, C, R)`: y = h + C x_k + noise.
        cross_cov: `(x_p, u, t)` to the covariance `(p, k)` of the two process noises, or None when they are independent.
        initial_gain: `(k, p)`: the mean of x_k given x_p moves by this times the distance of x_p from its mean; None for no relation.
        angles: components of y that are angles in radians.
        linear: places of x_k in the user's order of states; x_p fills the rest in order. The last k by default.
        names: names of all states in the user's order.
        circular: places of the states that are angles in radians, in the user's order.
        input_names: names of the inputs of a step where these are an array; see `StateSpaceModel`.
    """

    initial_p: Law
    initial_k: Gaussian
    particle: AffineFunction
    kalman: AffineFunction
    sensor: AffineFunction
    cross_cov: Callable[[jax.Array, Any, Any], jax.Array] | None = None
    initial_gain: jax.Array | None = None
    angles: tuple[int, ...] = static(default=())
    linear: tuple[int, ...] = static(default=())
    names: tuple[str, ...] = static(default=())
    circular: tuple[int, ...] = static(default=())
    input_names: tuple[str, ...] = static(default=())

    def __post_init__(self) -> None:
        """Fill in the order and the names.

        Raises:
            MotesError: a piece has the wrong kind, or there is nothing in one of the parts.
        """
        object.__setattr__(self, "initial_p", as_law("MixedLinearModel initial_p", self.initial_p))
        if not isinstance(self.initial_k, Gaussian):
            checks.refuse("MixedLinearModel initial_k", "a Gaussian", type(self.initial_k).__name__)
        for name in ("particle", "kalman", "sensor"):
            if not callable(getattr(self, name)):
                checks.refuse(f"MixedLinearModel {name}", "a function (x_p, u, t) -> (f, A, Q)", type(getattr(self, name)).__name__)
        size = self.sizes[0] + self.sizes[1]
        if not self.linear:
            object.__setattr__(self, "linear", tuple(range(self.sizes[0], size)))
        names = tuple(self.names) or tuple(f"x{i}" for i in range(size))
        if len(names) != size:
            checks.refuse("MixedLinearModel names", f"{size} names", list(names))
        if any(not -size <= a < size for a in self.circular):
            checks.refuse("MixedLinearModel circular", f"indices of the {size} states", list(self.circular))
        object.__setattr__(self, "circular", tuple(sorted({a % size for a in self.circular})))
        object.__setattr__(self, "names", names)

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of states in the particle part and in the Kalman part."""
        return drawn(self.initial_p).shape[0], self.initial_k.center.shape[0]

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the states."""
        return self.initial_k.center.dtype

    @property
    def order(self) -> tuple[int, ...]:
        """For each state in the user's order, its place in (x_p, x_k)."""
        return user_order(self.linear, self.size)

    def check(self, inputs_of_step: Inputs) -> None:
        """Run all functions on shapes alone and refuse what does not fit.

        Raises:
            MotesError: a function returns the wrong shape; the message names it.
        """
        (p, k), found = self.sizes, {name: self._shapes(name, inputs_of_step) for name in ("particle", "kalman", "sensor")}
        for name, expected in (("particle", p), ("kalman", k), ("sensor", None)):
            f, A, Q = found[name]
            checks.shape(f"{name}(x_p, u, t) f", f, (expected,))
            checks.shape(f"{name}(x_p, u, t) A", A, (f.shape[0], k), "(the size of its f, the size of x_k)")
            checks.shape(f"{name}(x_p, u, t) Q", Q, (f.shape[0], f.shape[0]), "(the size of its f)")
        if self.cross_cov is not None:
            checks.shape("cross_cov(x_p, u, t)", self._shapes("cross_cov", inputs_of_step), (p, k), "(the sizes of x_p and x_k)")

    def measurement_size(self, inputs_of_step: Inputs) -> int:
        """Return the number of measured components."""
        return self._shapes("sensor", inputs_of_step)[0].shape[0]

    def _shapes(self, name: str, u: Inputs) -> Any:
        x_p, t = jax.ShapeDtypeStruct((self.sizes[0],), self.dtype), jax.ShapeDtypeStruct((), jnp.int32)
        return jax.eval_shape(lambda x_p, u, t: jax.tree.map(jnp.asarray, getattr(self, name)(x_p, u, t)), x_p, u, t)

    def rebuilt(self, wrap: Wrap, u: Any, y: Any) -> "MixedLinearModel":
        """Exchange the functions; see `Model`."""
        args = (jax.ShapeDtypeStruct((self.sizes[0],), self.dtype), u, jax.ShapeDtypeStruct((), jnp.int32))
        names = ("particle", "kalman", "sensor", "cross_cov")
        return exchanged(self, {name: wrap.function(getattr(self, name), args, f"{name}(x_p, u, t)") for name in names})

    def as_state_space(self) -> StateSpaceModel:
        """Return the same model as one state-space model in the user's order of states, for filters that do not split it."""
        back, p = self.order, self.sizes[0]
        kept = tuple(i for i in range(self.size) if i not in self.linear)

        def parts_of(x: jax.Array) -> tuple[jax.Array, jax.Array]:
            return linalg.take(x, kept), linalg.take(x, self.linear)

        def dynamics_mean(x: jax.Array, u: Any, t: Any) -> jax.Array:
            x_p, x_k = parts_of(x)
            parts = (self.particle(x_p, u, t), self.kalman(x_p, u, t))
            return linalg.take(jnp.concatenate([f + A @ x_k for f, A, _ in parts]), back)

        def dynamics_cov(x: jax.Array, u: Any, t: Any) -> jax.Array:
            x_p = parts_of(x)[0]
            Q_p, Q_k = self.particle(x_p, u, t)[2], self.kalman(x_p, u, t)[2]
            cross = jnp.zeros((p, Q_k.shape[0]), x.dtype) if self.cross_cov is None else self.cross_cov(x_p, u, t)
            return linalg.take(linalg.take(jnp.block([[Q_p, cross], [cross.T, Q_k]]), back), back, axis=1)

        def sensor_mean(x: jax.Array, u: Any, t: Any) -> jax.Array:
            x_p, x_k = parts_of(x)
            h, C, _ = self.sensor(x_p, u, t)
            return h + C @ x_k

        initial: Law = JoinedInitial(self.initial_p, self.initial_k, self.initial_gain, self.order)
        if isinstance(self.initial_p, Gaussian):
            initial = Gaussian(initial.mean(), initial.cov())

        return StateSpaceModel(
            initial,
            AdditiveGaussian(dynamics_mean, dynamics_cov, self.circular),
            AdditiveGaussian(sensor_mean, lambda x, u, t: self.sensor(parts_of(x)[0], u, t)[2], self.angles),
            self.names,
            input_names=self.input_names,
        )


@record
class JoinedInitial(Law):
    """The law of (x_p, x_k) at step 0 in the user's order; see `MixedLinearModel`."""

    initial_p: Law
    initial_k: Gaussian
    gain: jax.Array | None
    order: tuple[int, ...] = static()

    def _gain(self) -> jax.Array:
        p = drawn(self.initial_p).shape[0]
        k = self.initial_k.center.shape[0]
        return jnp.zeros((k, p), self.initial_k.center.dtype) if self.gain is None else self.gain

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return jnp.concatenate([self.initial_p.mean(), self.initial_k.center])[jnp.asarray(self.order)]

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        G, P = self._gain(), self.initial_p.cov()
        joint = jnp.block([[P, P @ G.T], [G @ P, linalg.sandwich(G, P) + self.initial_k.covariance]])
        order = jnp.asarray(self.order)
        return joint[order][:, order]

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        x_p, means = initial_split(key, self.initial_p, self.initial_k, self.gain, n)
        x_k = Gaussian(means, self.initial_k.covariance).sample(random.child(key, 1), n)
        return jnp.concatenate([x_p, x_k])[jnp.asarray(self.order)]


def initial_split(key: jax.Array, initial_p: Law, initial_k: Gaussian, gain: jax.Array | None, n: int) -> tuple[jax.Array, jax.Array]:
    """Draw x_p `(p, n)` and give the mean of x_k `(k, n)` for each."""
    x_p = initial_p.sample(random.child(key, 0), n)
    return x_p, initial_means(initial_p, initial_k, gain, x_p)


def initial_means(initial_p: Law, initial_k: Gaussian, gain: jax.Array | None, x_p: jax.Array) -> jax.Array:
    """Return the mean of x_k `(k, n)` given each x_p `(p, n)`."""
    means = jnp.broadcast_to(initial_k.center[:, None], (initial_k.center.shape[0], x_p.shape[1]))
    return means if gain is None else means + gain @ (x_p - initial_p.mean()[:, None])


def user_order(linear: tuple[int, ...], size: int) -> tuple[int, ...]:
    """For each of the states in the user's order, its place in (x_p, x_k)."""
    particle = [i for i in range(size) if i not in linear]
    return tuple(particle.index(i) if i in particle else len(particle) + linear.index(i) for i in range(size))
