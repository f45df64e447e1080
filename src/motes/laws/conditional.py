"""Laws given a state: what dynamics and sensors are.

User functions have one signature, `f(x, u, t)`: one state `(x,)`, the inputs of the step, the step index. Every matrix may be an array
or such a function. Methods that take `X` work on a whole cloud `(x, n)`.
"""

from abc import ABC, abstractmethod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg
from motes.core.record import record, static
from motes.core.types import MatrixLike, UserFunction
from motes.laws.circular import wrap
from motes.laws.density import log_normal, max_log_normal, measured_in
from motes.laws.gaussian import Gaussian
from motes.laws.law import Law, Shifted, as_law, check_size


def over_particles(function: UserFunction, X: jax.Array, u: Any, t: Any) -> jax.Array:
    """Apply a user function to each particle of `X` `(x, n)`; the particle axis of the result is last."""
    return jax.vmap(lambda x: jnp.asarray(function(x, u, t)).astype(X.dtype), in_axes=-1, out_axes=-1)(X)


def matrix(value: MatrixLike, x: jax.Array, u: Any, t: Any) -> jax.Array:
    """Evaluate a matrix that may be a user function at one state."""
    return jnp.asarray(value(x, u, t) if callable(value) else value).astype(x.dtype)


def matrix_over(value: MatrixLike, X: jax.Array, u: Any, t: Any) -> jax.Array:
    """Evaluate a matrix at each particle: `(i, j)` when it is the same for all, otherwise `(i, j, n)`."""
    if not callable(value):
        return jnp.asarray(value).astype(X.dtype)
    try:
        # vmap itself knows whether the result depends on the particle: it refuses out_axes=None if so
        return jax.vmap(lambda x: matrix(value, x, u, t), in_axes=-1, out_axes=None)(X)
    except ValueError:
        return over_particles(value, X, u, t)


class Conditional(ABC):
    """The law of a vector given a state, the inputs and the step index."""

    angles: tuple[int, ...] = ()
    modes: int = 0
    """Number of modes of a jump-Markov system, the index of which is then the last component; 0 where none is."""
    has_moments: bool = False
    """Whether mean function and noise covariance are known."""
    marginalizes: bool = True
    """Whether single missing (NaN) components can be left out of the density."""
    draws: bool = True
    """Whether values can be drawn from it."""
    measures_anything: bool = False
    """Whether measurements may be other than vectors: arrays of any shape and type, or trees of them."""
    sensors: tuple[tuple[str, int], ...] = ()
    """Names of several sensors whose components follow each other, and how many each has; none where it is one sensor."""

    def of_states(self, names: tuple[str, ...]) -> "Conditional":
        """Return the same for a model whose states have these names; conditionals that name states look them up here."""
        return self

    def each(self, value: Any) -> list[tuple["Conditional", Any]]:
        """Return the sensors that a measurement is of, each with what it measured of it."""
        return [(self, value)]

    def packed(self, ys: Any) -> Any:
        """Return measurements as they come, time axis first, in the form in which they are computed with; as they are by default."""
        return ys

    def in_arrays(self, y: Any) -> Any:
        """Return one measurement that is a tree with arrays in place of lists of numbers, where lists are no parts of the tree."""
        return y

    def silence(self, steps: int) -> Any:
        """Return measurements of so many steps in which nothing was measured, in the form in which they are computed with.

        Raises:
            MotesError: their form is not known.
        """
        checks.refuse("ys", f"what {type(self).__name__} measures, NaN where it measured nothing", "None",
                      "Give NaN in its form, or of one of several sensors leave it out of all steps.")

    @abstractmethod
    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Return the law given one state `(x,)`."""

    @abstractmethod
    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Draw one value for each particle, `(z, n)`, with one block of noise."""

    @abstractmethod
    def log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density `(n,)` given each particle: of one value `(z,)`, a measurement, whose NaN components are left out; or of `(z, n)`.

        Values of each particle's own were drawn, not measured: NaN among them gives NaN.
        """

    def max_log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Largest value that `log_prob` can take for each particle, `()` or `(n,)`; infinite when not known."""
        return jnp.full((), jnp.inf, X.dtype)

    def mean(self, x: jax.Array, u: Any, t: Any) -> jax.Array:
        """Mean given one state, `(z,)`."""
        return self.given(x, u, t).mean()

    def cov(self, x: jax.Array, u: Any, t: Any) -> jax.Array:
        """Covariance given one state, `(z, z)`."""
        return self.given(x, u, t).cov()

    def residual(self, value: jax.Array, prediction: jax.Array) -> jax.Array:
        """Difference `(z, *n)` of a value and a prediction, wrapped to (-pi, pi] where the component is an angle."""
        if value.shape[0] != prediction.shape[0]:
            checks.refuse(f"value given to {type(self).__name__}", f"{prediction.shape[0]} components, as it predicts", value.shape[0])
        return wrap(linalg.add_vectors(value, -prediction), self.angles)


def as_conditional(argument: str, value: Any) -> Conditional:
    """Return a conditional.

    Raises:
        MotesError: it is none.
    """
    return checks.instance(argument, value, Conditional, "a conditional such as mo.AdditiveGaussian(f, Q)")


def check_function(argument: str, value: Any) -> None:
    """Refuse what cannot be called as a user function."""
    if not callable(value):
        checks.refuse(argument, "a function f(x, u, t) of one state", type(value).__name__)


def check_matrix(argument: str, value: Any, shape: tuple[int | None, int | None] = (None, None)) -> Any:
    """Return a matrix given as an array (checked, as floats) or as a function (left alone)."""
    if callable(value):
        return value
    array = checks.as_float(argument, value)
    checks.shape(argument, array, shape)
    return array


def check_noise_cov(argument: str, value: Any, definite: bool = False) -> Any:
    """Return a noise covariance given as an array (checked, as floats) or as a function (left alone)."""
    if not callable(value):
        value = checks.as_float(argument, value)
        if value.ndim < 2:
            checks.refuse(argument, "the covariance matrix of a noise, or a function that returns it", f"shape {value.shape}",
                          "One variance is [[v]], several are np.diag(v).")
        checks.covariance(argument, value, value.shape[0], definite)
    return value


@record
class AdditiveGaussian(Conditional):
    """f(x, u, t) plus Gaussian noise of covariance Q.

    Attributes:
        f: user function that returns `(z,)`.
        Q: covariance `(z, z)` in squared units of z, or a function that returns it.
        angles: components of z that are angles in radians: differences are wrapped.
    """

    has_moments = True
    f: UserFunction
    Q: MatrixLike
    angles: tuple[int, ...] = static(default=())

    def __init__(self, f: UserFunction, Q: MatrixLike, angles: tuple[int, ...] = ()):
        """Check what can be known without a model.

        Raises:
            MotesError: f is not callable, or Q is not a covariance.
        """
        check_function(f"{type(self).__name__} f", f)
        object.__setattr__(self, "f", f)
        object.__setattr__(self, "Q", check_noise_cov(f"{type(self).__name__} Q", Q))
        object.__setattr__(self, "angles", tuple(angles))

    def silence(self, steps: int) -> Any:
        """Return so many rows of NaN.

        Raises:
            MotesError: the noise covariance, a function, does not say how many components are measured.
        """
        return super().silence(steps) if callable(self.Q) else np.full((steps, np.shape(self.Q)[0]), np.nan)  # type: ignore[arg-type]

    def given(self, x: jax.Array, u: Any, t: Any) -> Gaussian:
        """Return the Gaussian given one state."""
        return Gaussian(self.mean(x, u, t), self.cov(x, u, t))

    def mean(self, x: jax.Array, u: Any, t: Any) -> jax.Array:
        """f(x, u, t), `(z,)`."""
        return jnp.asarray(self.f(x, u, t)).astype(x.dtype)

    def cov(self, x: jax.Array, u: Any, t: Any) -> jax.Array:
        """Q, `(z, z)`."""
        return matrix(self.Q, x, u, t)

    def means(self, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """F of each particle, `(z, n)`."""
        return over_particles(self.f, X, u, t)

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Draw one value for each particle, `(z, n)`."""
        return Gaussian(self.means(X, u, t), matrix_over(self.Q, X, u, t)).sample(key, X.shape[-1])

    def log_prob(
        self, value: jax.Array, X: jax.Array, u: Any, t: Any, size: jax.Array | None = None, trusted: float | None = None
    ) -> jax.Array:
        """Log density given each particle (see `Conditional`); `log_density` says what size (None: the value's) and trusted are."""
        return self.log_prob_about(value, self.means(X, u, t), matrix_over(self.Q, X, u, t), size, trusted)

    def log_prob_about(
        self, value: jax.Array, means: jax.Array, cov: jax.Array, size: jax.Array | None = None, trusted: float | None = None
    ) -> jax.Array:
        """Return the same where the means `(z, n)` and the covariance `(z, z, *n)` are known already."""
        size = jnp.abs(value) if size is None else size
        return log_normal(self.residual(value, means), cov, _measured(value, cov), size, None, trusted)

    def max_log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density at a perfect fit."""
        cov = matrix_over(self.Q, X, u, t)
        return max_log_normal(value, cov, _measured(value, cov))


@record
class LinearGaussian(AdditiveGaussian):
    """A x plus Gaussian noise of covariance Q.

    Attributes:
        A: `(z, x)`, or a function of (x, u, t) that returns it.
        Q: covariance `(z, z)`, or a function that returns it.
        angles: components of z that are angles in radians.
        live: which elements of A can be other than zero, row by row, where the library has looked before it compiles; None for all.
    """

    A: MatrixLike  # type: ignore[misc]
    live: tuple[tuple[bool, ...], ...] | None = static(default=None)

    def __init__(self, A: MatrixLike, Q: MatrixLike, angles: tuple[int, ...] = ()):
        """Check what can be known without a model.

        Raises:
            MotesError: A is not a matrix, or Q is not a covariance of its number of rows.
        """
        A = check_matrix("LinearGaussian A", A)
        AdditiveGaussian.__init__(self, _linear, Q, angles)
        if not callable(A) and not callable(self.Q):
            rows = np.shape(A)[0]
            checks.shape("LinearGaussian Q", self.Q, (rows, rows), "(rows of A)")
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "live", None)

    def mean(self, x: jax.Array, u: Any, t: Any) -> jax.Array:
        """A x, `(z,)`."""
        return self._marked(matrix(self.A, x, u, t)) @ x

    def means(self, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """A x of each particle, `(z, n)`."""
        return linalg.times_vector(self._marked(matrix_over(self.A, X, u, t)), X)

    def _marked(self, A: jax.Array) -> jax.Array:
        """Have who reads the traced program see which elements are zero."""
        return A if self.live is None else jnp.where(np.array(self.live), A, 0)


def _measured(value: jax.Array, cov: jax.Array | None = None) -> jax.Array | None:
    """Tell which components of a measurement `(z,)` are there, see `measured_in`; None, for all, of values `(z, n)`, which were drawn."""
    if value.ndim != 1:
        return None
    return ~jnp.isnan(value) if cov is None else measured_in(value, cov)


def _linear(x: jax.Array, u: Any, t: Any) -> jax.Array:
    raise AssertionError("LinearGaussian works with its matrix")


@record
class AdditiveNoise(Conditional):
    """f(x, u, t) plus noise of any law.

    Attributes:
        f: user function that returns `(z,)`.
        law: a law of z components, or an object with `sample(key, shape)` and `log_prob(x)` such as a numpyro distribution.
        angles: components of z that are angles in radians.
    """

    f: UserFunction
    law: Law
    angles: tuple[int, ...] = static(default=())

    def __init__(self, f: UserFunction, law: Any, angles: tuple[int, ...] = ()):
        """Check what can be known without a model.

        Raises:
            MotesError: f is not callable, or law is not a law.
        """
        check_function("AdditiveNoise f", f)
        object.__setattr__(self, "f", f)
        object.__setattr__(self, "law", as_law("AdditiveNoise law", law))
        object.__setattr__(self, "angles", tuple(angles))

    @property
    def has_moments(self) -> bool:  # type: ignore[override]
        """Whether those of the noise are known."""
        return self.law.has_moments

    @property
    def marginalizes(self) -> bool:  # type: ignore[override]
        """Only noise with independent components, or a Gaussian mixture, can leave one out."""
        return self.law.marginalizes

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Return the law given one state."""
        return Shifted(self.law, self._fitting(jnp.asarray(self.f(x, u, t)).astype(x.dtype)))

    def _fitting(self, predicted: jax.Array) -> jax.Array:
        """Return what f gave `(z, *n)`, if the law has as many components."""
        check_size("AdditiveNoise law", self.law, predicted.shape[0])
        return predicted

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Draw one value for each particle, `(z, n)`."""
        return self._fitting(over_particles(self.f, X, u, t)) + self.law.sample(key, X.shape[-1]).astype(X.dtype)

    def log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density given each particle; see `Conditional` (NaN components are left out where `marginalizes`)."""
        residual = self.residual(value, self._fitting(over_particles(self.f, X, u, t)))
        # a prediction that is not a number is no missing measurement
        seen = _measured(value)
        wrong = jnp.isnan(residual) if seen is None else jnp.isnan(residual) & seen[:, None]
        size = (jnp.abs(value),) if isinstance(self.law, Gaussian) else ()
        return jnp.where(jnp.any(wrong, axis=0), jnp.nan, self.law.log_prob(residual, *size))
