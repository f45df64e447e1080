"""Clouds of elements that devices share out: the law is that of all particles, its sums are formed for each element and added in order."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import engine
from motes.core.devices import Crew, shared_out
from motes.core.record import record, replace, static, values
from motes.laws import circular
from motes.laws.cloud import Cloud, weighted_moments
from motes.laws.law import Law
from motes.laws.marginal_cloud import MarginalCloud


def lane_marks(law: Any) -> list[bool]:
    """Tell of each array of a weighted law whether it has the particle axis, by asking for one particle more."""
    n = law.log_weights.shape[-1]
    probe = jax.eval_shape(lambda law: law.resampled(jnp.zeros((n + 1,), jnp.int32)), law)
    return [leaf.shape != other.shape for leaf, other in zip(jax.tree.leaves(law), jax.tree.leaves(probe), strict=True)]


class Form:
    """The form of a law of particles: how it is put together of the arrays that have the particle axis, and of the others.

    A *cut* law has arrays `(..., e, m)`: e elements of m particles each.
    """

    def __init__(self, law: Any):
        """Look at a law, or at its shapes."""
        leaves, self.tree = jax.tree.flatten(law)
        self.marks = lane_marks(law)
        self.own = [leaf is law.log_weights or leaf is law.ancestors for leaf in leaves]
        self.ranks = [len(leaf.shape) for leaf, lane in zip(leaves, self.marks, strict=True) if lane]

    def law(self, lanes: list[Any], rest: list[Any]) -> Any:
        """Put a law together."""
        lanes, rest = list(lanes), list(rest)
        return jax.tree.unflatten(self.tree, [lanes.pop(0) if lane else rest.pop(0) for lane in self.marks])

    def arrays(self, law: Any) -> tuple[list[Any], list[Any]]:
        """Take a law, cut or not, apart."""
        marked = list(zip(self.marks, jax.tree.leaves(law), strict=True))
        return [leaf for lane, leaf in marked if lane], [leaf for lane, leaf in marked if not lane]

    def particles(self, law: Any) -> tuple[list[Any], list[Any]]:
        """Take a law apart, leaving weights and ancestors out."""
        marked = list(zip(self.marks, self.own, jax.tree.leaves(law), strict=True))
        return [leaf for lane, own, leaf in marked if lane and not own], [leaf for lane, _, leaf in marked if not lane]

    def of_particles(self, lanes: Sequence[Any], rest: Sequence[Any]) -> Any:
        """Put a law together of any number of particles, whose weights and ancestors nobody looks at."""
        none = jnp.zeros((lanes[0].shape[-1],), lanes[0].dtype)
        marked = [own for lane, own in zip(self.marks, self.own, strict=True) if lane]
        lanes = list(lanes)
        law = self.law([none if own else lanes.pop(0) for own in marked], list(rest))
        return replace(law, ancestors=none.astype(jnp.int32))

    def each(self, function: Any, law: Any) -> Any:
        """Apply a function to each array with the particle axis."""
        lanes, rest = self.arrays(law)
        return self.law([function(lane) for lane in lanes], rest)

    def cut(self, law: Any, elements: int) -> Any:
        """Cut a law into elements."""
        return self.each(lambda lane: lane.reshape(*lane.shape[:-1], elements, lane.shape[-1] // elements), law)

    def uncut(self, law: Any) -> Any:
        """Undo `cut`."""
        return self.each(_side_by_side, law)

    def axes(self, rest: int | None) -> Any:
        """Say to `vmap` where a cut law has the axis of elements, and where the arrays without particles have it."""
        return jax.tree.unflatten(self.tree, [-2 if lane else rest for lane in self.marks])

    def mapped(self, function: Callable[..., tuple[Any, Any]], at_once: bool, each: Any, law: Any, is_cut: bool) -> tuple[Any, Any]:
        """Apply a function to the law of each element.

        Args:
            function: from what each element has of its own, and a law, to a law and a tree of arrays.
            at_once: whether all elements are worked on at once, or one after the other (see `one_by_one`).
            each: what each has of its own, a tree of arrays `(e, ...)`.
            law: cut; or one that is not, and that each element is handed whole.
            is_cut: which of both.

        Returns:
            A cut law, and a tree of arrays `(e, ...)`.
        """
        if at_once:
            with engine.for_elements():
                after, found = jax.vmap(function, (0, self.axes(None) if is_cut else None), (self.axes(0), 0))(each, law)
        else:

            def one(k: jax.Array) -> tuple[Any, Any]:
                own = jax.tree.map(lambda leaf: leaf[k], each)
                return function(own, self.each(lambda lane: row(lane, k), law) if is_cut else law)

            after, found = one_by_one(one, jax.tree.leaves(each)[0].shape[0])
            after = self.each(lambda lane: jnp.moveaxis(lane, 0, -2), after)
        # arrays without particles are the same for all elements
        lanes, rest = self.arrays(after)
        return self.law(lanes, [leaf[0] for leaf in rest]), found


def _side_by_side(lane: jax.Array) -> jax.Array:
    return lane.reshape(*lane.shape[:-2], lane.shape[-2] * lane.shape[-1])


def row(lane: jax.Array, k: jax.Array) -> jax.Array:
    """Return the part `(..., m)` of an element of an array `(..., e, m)`."""
    return jax.lax.dynamic_index_in_dim(lane, k, lane.ndim - 2, keepdims=False)


def one_by_one(function: Callable[[jax.Array], Any], count: int) -> Any:
    """Apply a function to each of `count` numbers, one after the other; results are `(count, ...)`.

    What runs over particles is rounded otherwise by compilers where it is one of several that are worked out at once, and then depends on
    how many there are on a device. A loop that is gone through once would be none to the compiler.
    """

    def none() -> Any:
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    shapes = jax.eval_shape(function, jnp.int32(0))
    found = jax.lax.map(lambda k: jax.lax.cond(k < count, lambda: function(k), none), jnp.arange(max(count, 2)))
    return jax.tree.map(lambda leaf: leaf[:count], found)


class Sums(NamedTuple):
    """Sums over particles that decide whether to resample; each is `()`, or that of each of several parts of the particles.

    Attributes:
        weights: of the weights.
        squares: of their squares.
        terms: of w log w.
    """

    weights: jax.Array
    squares: jax.Array
    terms: jax.Array

    @classmethod
    def of(cls, log_weights: jax.Array) -> "Sums":
        """Sum log weights `(n,)`."""
        weights = jnp.exp(log_weights)
        terms = jnp.where(weights > 0, weights * log_weights, 0)
        return cls(jnp.sum(weights), jnp.sum(weights**2), jnp.sum(terms))


class Masses(NamedTuple):
    """Sums over the particles of each element; all `(e,)`.

    Attributes:
        log: log of the sum of weights; minus infinity where all vanish.
        sums: what policies ask of the weights.
    """

    log: jax.Array
    sums: Sums


def masses(log_weights: jax.Array) -> Masses:
    """Sum log weights `(e, m)` over each element."""
    found = masses_of(log_weights)
    return Masses(found[:, 0], Sums(*(found[:, k] for k in (1, 2, 3))))


@engine.replaceable
def masses_of(log_weights: jax.Array) -> jax.Array:
    """Log of the sum of weights, their sum, that of their squares, and that of w log w, `(e, 4)`, from log weights `(e, m)`."""

    def one(k: jax.Array) -> jax.Array:
        row = log_weights[k]
        return jnp.stack([log_sum(row), *Sums.of(row)])

    return one_by_one(one, log_weights.shape[0])


def log_sum(logs: jax.Array) -> jax.Array:
    """Log of the sum of what logs `(n,)` are given of; minus infinity where all are."""
    top = jnp.max(logs)
    anchor = jnp.where(jnp.isfinite(top), top, 0)
    return anchor + jnp.log(jnp.sum(jnp.exp(logs - anchor)))


def normalized_within(log_weights: jax.Array, masses: jax.Array) -> jax.Array:
    """Return log weights `(e, m)` normalized within each element of the given log mass; equal ones in an element without mass."""
    equal = -jnp.log(jnp.asarray(log_weights.shape[-1], log_weights.dtype))
    return jnp.where(jnp.isfinite(masses)[:, None], log_weights - masses[:, None], equal)


def added(log_weights: jax.Array, masses: jax.Array) -> jax.Array:
    """Undo `normalized_within` for log weights `(e, m)` and the log masses `(e,)` that the elements are to have."""
    return jnp.where(jnp.isfinite(masses)[:, None], log_weights + masses[:, None], -jnp.inf)


@engine.replaceable
def moments_of(log_weights: jax.Array, points: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return masses `(e,)`, means `(e, x)` and covariances `(e, x, x)` of points `(x, e, m)` under log weights `(e, m)`."""

    def moments(k: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        log_mass = log_sum(log_weights[k])
        return jnp.exp(log_mass), *weighted_moments(normalized_within(log_weights[k][None], log_mass[None])[0], row(points, k))

    return one_by_one(moments, log_weights.shape[0])


class InElements(Law):
    """What a law of K elements says itself; it is put before the class of the law."""

    elements: int

    @property
    def plain(self) -> Any:
        """The same law, knowing nothing of elements."""
        fields = values(self)
        del fields["elements"]
        return PLAIN[type(self)](**fields)

    def _moments(self) -> tuple[jax.Array, jax.Array]:
        form = Form(self.plain)

        def work(crew: Crew, lanes: Any, rest: Any) -> Any:
            return [], crew.gathered(self._moments_of(form, form.cut(form.law(lanes, rest), crew.here)))

        _, (weights, means, covs) = shared_out(work, self.elements, *form.arrays(self.plain), ranks=[])
        shares = (weights / jnp.sum(weights))[:, None]
        mean = jnp.sum(jnp.where(shares > 0, shares * means, 0), axis=0)
        off = means - mean
        covs = covs + off[:, :, None] * off[:, None, :]
        shares = shares[..., None]
        return mean, jnp.sum(jnp.where(shares > 0, shares * covs, 0), axis=0)

    def _moments_of(self, form: Form, law: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return masses `(e,)`, means `(e, x)` and covariances `(e, x, x)` of the elements of a cut law."""

        def moments(k: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            own = form.each(lambda lane: row(lane, k), law)
            log_mass = log_sum(own.log_weights)
            own = replace(own, log_weights=normalized_within(own.log_weights[None], log_mass[None])[0])
            return jnp.exp(log_mass), own.mean(), own.cov()

        return one_by_one(moments, law.log_weights.shape[0])

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return self._moments()[0]

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        return self._moments()[1]

    def effective_size(self) -> jax.Array:
        """Effective number of particles."""

        def work(crew: Crew, lanes: Any, rest: Any) -> Any:
            return [], crew.gathered(masses(lanes[0].reshape(crew.here, -1)).sums.squares)

        return 1 / jnp.sum(shared_out(work, self.elements, [self.log_weights], [], ranks=[])[1])  # type: ignore[attr-defined]

    def resampled(self, ancestors: jax.Array) -> Any:
        """Return the law of the named particles `(n,)`, with equal weights."""
        chosen = self.plain.resampled(ancestors)
        return chosen if ancestors.shape[0] % self.elements else in_elements(chosen, self.elements)

    def _gathered(self, points: jax.Array, angles: tuple[int, ...]) -> jax.Array:
        """Return points `(x, n)` on one branch of the rows that are angles."""

        def work(crew: Crew, lanes: Any, rest: Any) -> Any:
            def total(rows: jax.Array) -> jax.Array:
                parts = rows.reshape(rows.shape[0], crew.here, -1)
                return jnp.sum(crew.gathered(one_by_one(lambda k: jnp.sum(row(parts, k), axis=-1), crew.here)), axis=0)

            return [circular.gathered(lanes[0], lanes[1], angles, total)], ()

        return shared_out(work, self.elements, [points, self.log_weights], [], ranks=[2])[0][0]  # type: ignore[attr-defined]


@record
class ElementCloud(InElements, Cloud):
    """Weighted particles of K elements, which devices may share out; a `Cloud`.

    Attributes:
        particles: `(x, n)`; those of an element stand side by side.
        log_weights: normalized over all, `(n,)`.
        ancestors: index of each particle's parent at the step before, among all, `(n,)` int32.
        elements: K.
    """

    elements: int = static(default=1)

    def _moments_of(self, form: Form, law: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        return moments_of(law.log_weights, law.particles)

    def gathered(self, angles: tuple[int, ...]) -> "ElementCloud":
        """Return the cloud with particles on one branch of the states that are angles."""
        return replace(self, particles=self._gathered(self.particles, angles)) if angles else self


@record
class ElementMarginalCloud(InElements, MarginalCloud):
    """Weighted particles with a Gaussian each, of K elements, which devices may share out; a `MarginalCloud`.

    Attributes:
        particles: x_p, `(p, n)`; those of an element stand side by side.
        kalman: law of x_k given each particle, as of a `MarginalCloud`.
        log_weights: normalized over all, `(n,)`.
        ancestors: index of each particle's parent at the step before, among all, `(n,)` int32.
        order: for each state in the user's order, its place in (x_p, x_k).
        elements: K.
    """

    elements: int = static(default=1)

    def gathered(self, angles: tuple[int, ...]) -> Any:
        """Return the cloud with particles and means on one branch of the states, in the user's order, that are angles."""
        if not angles:
            return self
        return self.with_points(self._gathered(self._concatenated(), tuple(self.order[a] for a in angles)))


PLAIN: dict[type, type] = {ElementCloud: Cloud, ElementMarginalCloud: MarginalCloud}


def in_elements(law: Any, elements: int) -> Any:
    """Return a law of particles as that of so many elements; None of a law of another kind."""
    for kind, plain in PLAIN.items():
        if type(law) is plain:
            return kind(**values(law), elements=elements)
    return None
