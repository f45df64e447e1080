"""A conditional law in the user's own words, of measurements of any shape."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from motes.core import checks, linalg, random
from motes.core.record import record, replace, static
from motes.laws.conditional import Conditional
from motes.laws.law import Law
from motes.laws.observed import Observed, value_of


@record
class Custom(Conditional):
    """A conditional law in the user's own words.

    As a sensor it may measure anything: a vector, an array of any shape and type (a video frame), or a tree of arrays.

    Attributes:
        sampler: `(key, x, u, t)` draws one value; needed of dynamics, and of a sensor that is simulated.
        density: `(value, x, u, t)` gives the log density, one number; needed of a sensor.
        digest: `(value, u, t)` works out what all particles share, once a step; the density gets it in place of the value.
        angles: components of the value that are angles in radians: as states they are averaged as such.
        states: the states that the functions are given, in this order; None for all.
        batched: whether the functions take all particles at once, `(x, n)`, and give `(n,)`, or draws with the particle axis last.
        partial: whether the density takes care of NaN in the value; otherwise measurements that miss some numbers are refused.
        looks: indices of the states that the density looks at, as tracing found; None where nobody has traced it.
    """

    sampler: Callable[..., Any] | None
    density: Callable[..., jax.Array] | None
    digest: Callable[..., Any] | None = None
    angles: tuple[int, ...] = static(default=())
    states: tuple[str | int, ...] | None = static(default=None)
    batched: bool = static(default=False)
    partial: bool = static(default=False)
    looks: tuple[int, ...] | None = static(default=None)
    measures_anything = True

    def __init__(
        self,
        sample: Callable[..., Any] | None = None,
        log_prob: Callable[..., jax.Array] | None = None,
        angles: tuple[int, ...] = (),
        *,
        digest: Callable[..., Any] | None = None,
        states: tuple[str | int, ...] | None = None,
        batched: bool = False,
        partial: bool = False,
    ):
        """Check that at least one of the two functions is there.

        Args:
            sample: `(key, x, u, t)` to one value, or None.
            log_prob: `(value, x, u, t)` to its log density, or None.
            angles: components of the value that are angles in radians.
            digest: `(value, u, t)` to what the density is given in place of the value, or None.
            states: names or indices of the states that the functions are given, or None.
            batched: whether they take all particles at once.
            partial: whether the density takes care of NaN.

        Raises:
            MotesError: both functions are missing, or one is not callable.
        """
        if sample is None and log_prob is None:
            checks.refuse("Custom", "sample, log_prob or both", "neither")
        for name, value in (("sample", sample), ("log_prob", log_prob), ("digest", digest)):
            if value is not None and not callable(value):
                checks.refuse(f"Custom {name}", "a function", type(value).__name__)
        if isinstance(states, (str, int)):
            checks.refuse("Custom states", "a tuple of names or indices of states", repr(states), f"Write states=({states!r},).")
        fields = {"sampler": sample, "density": log_prob, "digest": digest, "angles": tuple(angles), "batched": batched,
                  "states": None if states is None else tuple(states), "partial": partial, "looks": None}  # fmt: skip
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def marginalizes(self) -> bool:  # type: ignore[override]
        """Whether the density can leave out missing components."""
        return self.partial

    @property
    def draws(self) -> bool:  # type: ignore[override]
        """Whether there is a sampler."""
        return self.sampler is not None

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: moments are not known."""
        checks.refuse("Custom", "a conditional with a mean and a covariance", "one with only sample and log_prob",
                      "Use AdditiveGaussian or AdditiveNoise, or a ParticleFilter.")

    def of_states(self, names: tuple[str, ...]) -> "Custom":
        """Look up the states that the functions are given."""
        if self.states is None:
            return self
        places = {name: place for place, name in enumerate(names)} | {place: place for place in range(-len(names), len(names))}
        unknown = [state for state in self.states if state not in places]
        if unknown:
            checks.refuse("Custom states", f"among the states {', '.join(names)}", repr(unknown[0]))
        return replace(self, states=tuple(places[state] % len(names) for state in self.states))

    def own(self, X: jax.Array) -> jax.Array:
        """Return of states `(x, *n)` those that the functions are given."""
        return X if self.states is None else linalg.take(X, self.states)  # type: ignore[arg-type]

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> Any:
        """Draw one value for each particle, particle axis last; one key per particle, since the user's sampler takes one."""
        sampler = self.sampler
        if sampler is None:
            checks.refuse("Custom", "a sample function (it is simulated here)", "None")
        if self.batched:
            return _as_values(sampler(key, self.own(X), u, t), X.dtype, 2)
        keys = random.split(key, X.shape[-1])
        return jax.vmap(lambda k, x: _as_values(sampler(k, x, u, t), X.dtype, 1), (0, -1), -1)(keys, self.own(X))

    def log_prob(self, value: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density given each particle."""
        density, digest = self.density, self.digest
        if density is None:
            checks.refuse("Custom", "a log_prob function (its density is needed here)", "None")
        measured = isinstance(value, Observed) or value.ndim == 1
        value = value_of(value)
        if digest is not None:
            value = digest(value, u, t) if measured else jax.vmap(lambda v: digest(v, u, t), -1, -1)(value)
        if self.batched:
            return jnp.asarray(density(value, self.own(X), u, t)).astype(X.dtype)
        one = lambda v, x: jnp.asarray(density(v, x, u, t)).astype(X.dtype)  # noqa: E731
        return jax.vmap(one, (None if measured else -1, -1))(value, self.own(X))


def _as_values(drawn: Any, dtype: Any, rank: int) -> Any:
    """Return what a sampler drew as arrays: vectors in the type of the states, other arrays of numbers with a point too."""

    def one(leaf: Any) -> jax.Array:
        array = jnp.asarray(leaf)
        real = jnp.issubdtype(array.dtype, jnp.floating)
        return array.astype(dtype) if real or (leaf is drawn and array.ndim == rank) else array

    return jax.tree.map(one, drawn)
