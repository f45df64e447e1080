"""What every law answers, and what a foreign distribution is turned into."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Self

import jax
import jax.numpy as jnp

from motes.core import linalg, logspace
from motes.core.checks import refuse
from motes.core.record import record, static
from motes.laws.clusters import Clusters, clusters, one_cluster

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    LawT = TypeVar("LawT", default=Any)
else:
    from typing import TypeVar

    # type checkers take any law where none is named
    LawT = TypeVar("LawT")


class Law(ABC):
    """A probability law of a vector of x components."""

    independent: bool = False
    """Whether the components are independent."""
    has_moments: bool = True
    """Whether mean and covariance are known; a law that has none refuses to tell them."""
    weighted: ClassVar[bool] = False
    """Whether the law is made of weighted parts, of normalized `log_weights` `(n,)`."""
    marks_ancestors: ClassVar[bool] = False
    """Whether its `ancestors` `(n,)` say which part each came from."""

    def effective_size(self) -> jax.Array:
        """Effective number of the parts of a law that is `weighted`."""
        return logspace.effective_size(self.log_weights)  # type: ignore[attr-defined]

    @property
    def marginalizes(self) -> bool:
        """Whether the density can leave out components that are missing (NaN); of independent ones it can."""
        return self.independent

    @abstractmethod
    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""

    @abstractmethod
    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""

    @abstractmethod
    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at points `(x, *n)`, as `(*n)`."""
        refuse(type(self).__name__, "a law with a density", "one that can only be sampled", "Give it a log_prob.")

    def mode_probabilities(self, count: int = 0) -> jax.Array | None:
        """Probabilities `(m,)` of the modes of a jump-Markov system; None of a law that knows none.

        Args:
            count: how many modes there are, where the last state is the index of one (see `JumpMarkovModel.joined`); 0 where it is not.
        """
        return None

    def delayed_mode_probabilities(self) -> jax.Array | None:
        """Probabilities `(lag + 1, m)` of the last modes, the newest first; None of a law that remembers none."""
        return None

    def modes(self, count: int = 8) -> Clusters:
        """Return the heaviest clusters of the law; one of a law that has one mode.

        Args:
            count: most clusters.
        """
        points = self.weighted_points()
        return one_cluster(self.mean(), self.cov(), count) if points is None else clusters(*points, count)

    def weighted_points(self) -> tuple[jax.Array, jax.Array] | None:
        """Return points `(x, n)` in the user's order of states and their normalized log weights `(n,)`; None of a law that has none."""
        return None

    def gathered(self, angles: tuple[int, ...]) -> Self:
        """Return the law with what it averages on one branch of the states named, which are angles; see `laws/circular.py`.

        Laws that average nothing, such as one Gaussian, are as they were.
        """
        return self


@record
class Shifted(Law):
    """A law moved by a vector.

    Attributes:
        law: the law of the difference.
        by: `(x,)`.
    """

    law: Law
    by: jax.Array

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return self.law.mean() + self.by

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        return self.law.cov()

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        return self.law.sample(key, n) + self.by[:, None]

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at `(x,)` or `(x, n)`."""
        return self.law.log_prob(linalg.add_vectors(value, -self.by))


@record
class Foreign(Law):
    """A distribution object of another library or of the user's: anything with `sample(key, shape)` and `log_prob(x)`.

    Attributes:
        distribution: the object; its components lie along its batch or event axis.
        size: number of components.
        scalar: whether one draw is a number, without an axis.
        independent: components on a batch axis are independent; an event axis makes a joint density.
    """

    distribution: Any = static()
    size: int = static()
    scalar: bool = static(default=False)
    independent: bool = static(default=True)

    @property
    def has_moments(self) -> bool:  # type: ignore[override]
        """Whether the object knows its mean and its variance or covariance."""
        return self._attribute("mean") is not None and any(self._attribute(name) is not None for name in ("covariance_matrix", "variance"))

    def _attribute(self, name: str) -> Any:
        try:
            return getattr(self.distribution, name, None)
        except NotImplementedError:
            return None

    def _moment(self, name: str) -> jax.Array:
        value = self._attribute(name)
        if value is None:
            kind = type(getattr(self.distribution, "of", self.distribution)).__name__
            refuse(f"law {kind}", f"one with a {name} (moments are needed here)", "sample and log_prob alone",
                   "Use a ParticleFilter, which needs no more, or give the law its moments.")
        return jnp.asarray(value)

    def mean(self) -> jax.Array:
        """Mean, `(x,)`."""
        return jnp.broadcast_to(self._moment("mean"), (self.size,))

    def cov(self) -> jax.Array:
        """Covariance, `(x, x)`."""
        if self._attribute("covariance_matrix") is not None:
            return self._moment("covariance_matrix")
        return jnp.diag(jnp.broadcast_to(self._moment("variance"), (self.size,)))

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x, n)`."""
        drawn = self.distribution.sample(key, (n, self.size) if self.scalar else (n,))
        return jnp.reshape(drawn, (n, self.size)).T

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density; NaN components are left out where the components are independent."""
        points = jnp.moveaxis(value, 0, -1)
        if not self.independent:
            return self.distribution.log_prob(points)
        missing = jnp.isnan(points)
        stand_in = self.mean().astype(points.dtype) if self._attribute("mean") is not None else 0
        each = self.distribution.log_prob(jnp.where(missing, stand_in, points))
        each = jnp.reshape(each, points.shape)
        return jnp.sum(jnp.where(missing, 0, each), axis=-1)


class _Hashed:
    """An object without a hash, as a dataclass that can be changed has none; it equals itself alone."""

    def __init__(self, of: Any):
        self.of = of

    def __getattr__(self, name: str) -> Any:
        return getattr(object.__getattribute__(self, "of"), name)


def drawn(law: Law) -> jax.ShapeDtypeStruct:
    """Shape and type of one draw, `(x, 1)`, found without drawing."""
    center = getattr(law, "center", None)
    if center is not None:
        return jax.ShapeDtypeStruct((center.shape[0], 1), center.dtype)
    return jax.eval_shape(_one_draw, law)


def _one_draw(law: Law) -> jax.Array:
    # a function of its own: JAX knows it again, and traces a law once, not each time that its type is asked for
    return law.sample(jax.random.key(0), 1)


def check_size(argument: str, law: Law, size: int) -> None:
    """Refuse a law of another number of components: broadcasting would make one number serve for all, or draw one for all."""
    found = drawn(law).shape[0]
    if found != size:
        checked = f"a law of {size} components, as its function returns"
        refuse(argument, checked, f"{type(law).__name__} of {found}", "Give one scale (or mean, or entry) for each component.")


def as_law(argument: str, value: Any) -> Law:
    """Return a law, wrapping a foreign distribution.

    Raises:
        MotesError: the value has neither the methods of a law nor those of a distribution, or cannot be drawn from.
    """
    if isinstance(value, Law):
        return value
    if hasattr(value, "sample") and hasattr(value, "log_prob"):
        return _foreign(argument, value)
    refuse(argument, "a law, or an object with sample(key, shape) and log_prob(x)", type(value).__name__)


def _foreign(argument: str, value: Any) -> Foreign:
    """Find out how many components a distribution has, and whether they are independent, by its shapes or on shapes alone."""
    if type(value).__hash__ is None:
        value = _Hashed(value)
    batch, event = getattr(value, "batch_shape", None), getattr(value, "event_shape", None)
    if batch is not None or event is not None:
        shape = (*(batch or ()), *(event or ()))
        return Foreign(value, shape[-1] if shape else 1, not shape, not event or shape[-1] == 1)
    form = "sample(key, (n,)) that returns (n,) or (n, x), and log_prob of such points"
    try:
        shape = jax.eval_shape(lambda: jnp.asarray(value.sample(jax.random.key(0), (3,)))).shape
        points = jax.ShapeDtypeStruct((*shape[:1], 1) if len(shape) == 1 else shape, jnp.result_type(float))
        each = jax.eval_shape(lambda points: jnp.asarray(value.log_prob(points)), points).shape
    except Exception as reason:
        refuse(argument, form, f"{type(reason).__name__} ({reason!s:.100})", "Batch and event shape are read where they are.")
    if len(shape) not in (1, 2) or shape[0] != 3 or each not in (points.shape, shape, (3,)):
        refuse(argument, form, f"shapes {shape} and {each}")
    return Foreign(value, points.shape[-1], len(shape) == 1, each == points.shape or points.shape[-1] == 1)
