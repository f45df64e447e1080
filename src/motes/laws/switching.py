"""Laws of a state whose last component is the number of a mode, 0 to m - 1, and of what is measured of it; each mode has its own."""

from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, random
from motes.core.record import record, static
from motes.laws.conditional import Conditional
from motes.laws.law import Law

FEW_MODES = 4
"""So many modes of one model and fewer are gone through one by one: XLA makes faster code of that, more of them would compile longer."""


class WithMode(NamedTuple):
    """Inputs of a model that all modes share: its functions take the mode as their last argument.

    Attributes:
        u: the user's inputs.
        mode: number of the mode, `()` int32.
    """

    u: Any
    mode: Any


def log_probabilities(probabilities: jax.Array) -> jax.Array:
    """Logs of probabilities, minus infinity where they are zero."""
    possible = probabilities > 0
    return jnp.where(possible, jnp.log(jnp.where(possible, probabilities, 1)), -jnp.inf)


def transition_matrix(transition: Any, u: Any, t: Any, dtype: Any) -> jax.Array:
    """Probabilities `(m, m)` of going from the mode of a row to that of a column; given as an array or as a function of (u, t)."""
    return jnp.asarray(transition(u, t) if callable(transition) else transition).astype(dtype)


def number_of(modes: jax.Array, count: int) -> jax.Array:
    """Turn modes that stand among the states into indices."""
    return jnp.clip(jnp.round(modes), 0, count - 1).astype(jnp.int32)


def of_mode(modes: jax.Array, each: list[jax.Array]) -> jax.Array:
    """Pick, for each particle `(n,)`, what its mode gives; `each` holds what every mode does, particle axis last."""
    result = each[0]
    for number, other in enumerate(each[1:], 1):
        result = jnp.where(modes == number, other, result)
    return result


def mode_weights(modes: jax.Array, weights: jax.Array, count: int) -> jax.Array:
    """Weight `(count,)` of those in each mode, of modes `(n,)` as indices and weights `(n,)`."""
    numbers = jnp.arange(count, dtype=modes.dtype)
    return jnp.sum(jnp.where(modes == numbers[:, None], weights, 0), axis=1)


def one_by_one(parts: tuple[Any, ...], count: int, u: Any) -> list[tuple[Any, Any]]:
    """Return the part of each mode with the inputs that it takes."""
    return [(part, u) for part in parts] if len(parts) == count else [(parts[0], WithMode(u, np.int32(mode))) for mode in range(count)]


def of_each(parts: tuple[Any, ...], count: int, modes: jax.Array, u: Any, ask: Callable[[Any, Any], Any]) -> Any:
    """Pick, for each particle `(n,)`, what the part of its mode answers; see `in_each_mode`. What is asked has the particle axis last."""
    if len(parts) == count or count <= FEW_MODES:
        return jax.tree.map(lambda *each: of_mode(modes, list(each)), *[ask(*each) for each in one_by_one(parts, count, u)])
    numbers = jnp.arange(count, dtype=jnp.int32)
    found = jax.vmap(lambda mode: ask(parts[0], WithMode(u, mode)))(numbers)
    # what does not depend on the particle has no axis of particles
    return jax.tree.map(lambda leaf: _picked(modes, leaf if leaf.ndim > 1 else leaf[:, None]), found)


def _picked(modes: jax.Array, each: jax.Array) -> jax.Array:
    """Pick one of m arrays `(m, ..., n)` for each particle."""
    each = jnp.broadcast_to(each, (*each.shape[:-1], modes.shape[0]))
    return jnp.take_along_axis(each, modes.reshape(*[1] * (each.ndim - 1), -1), axis=0)[0]


def in_each_mode(parts: tuple[Any, ...], count: int, u: Any, ask: Callable[..., Any], given: Any = ()) -> Any:
    """Ask the part of each mode, mode axis last but one: of one part that all modes share once, with the mode among its inputs.

    Args:
        parts: one for each mode, or one that all share.
        count: number m of modes.
        u: inputs of the step.
        ask: function of a part, the inputs and what is given, that returns a tree of arrays.
        given: tree of arrays `(..., m or 1, k)`, of which each mode gets its own `(..., k)`, or all get the one.

    Returns:
        What the function returns, `(..., m, k)`.
    """
    if len(parts) == count or count <= FEW_MODES:
        mine = [jax.tree.map(lambda leaf, mode=mode: leaf[..., min(mode, leaf.shape[-2] - 1), :], given) for mode in range(count)]
        found = [ask(part, seen, each) for (part, seen), each in zip(one_by_one(parts, count, u), mine, strict=True)]
        return jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-2), *found)
    alike = jax.tree.map(lambda leaf: leaf.shape[-2] == 1, given)
    given = jax.tree.map(lambda leaf: leaf[..., 0, :] if leaf.shape[-2] == 1 else leaf, given)
    axes = jax.tree.map(lambda one: None if one else -2, alike)
    modes = jnp.arange(count, dtype=jnp.int32)
    return jax.vmap(lambda mode, given: ask(parts[0], WithMode(u, mode), given), in_axes=(0, axes), out_axes=-2)(modes, given)


def pick_each(weights: jax.Array, points: jax.Array) -> jax.Array:
    """Indices int32, one for each uniform number `(*n)` in [0, 1), in proportion to weights `(m, *n)` of its own; for few weights."""
    edges = jnp.cumsum(weights, axis=0)
    return jnp.sum(points * edges[-1] >= edges[:-1], axis=0, dtype=jnp.int32)


def _drawn(key: jax.Array, rows: jax.Array) -> jax.Array:
    """Draw one index `(n,)` for each column of probabilities `(m, n)`."""
    return pick_each(rows, random.uniform(key, rows.shape[1:], rows.dtype))


@record
class SwitchingLaw(Law):
    """Law of a state and its mode.

    Attributes:
        probabilities: of the modes, `(m,)`.
        laws: law of the rest of the state in each mode, or the one that all have.
    """

    probabilities: jax.Array
    laws: tuple[Law, ...]

    def mean(self) -> jax.Array:
        """Mean `(x + 1,)`; the last component is the mean of the mode's number."""
        return self._spread()[0] @ self.probabilities

    def cov(self) -> jax.Array:
        """Covariance within and between the modes, `(x + 1, x + 1)`."""
        points, inside = self._spread()
        off = points - (points @ self.probabilities)[:, None]
        return (off * self.probabilities) @ off.T + jnp.pad(inside @ self.probabilities, (0, 1))

    def _spread(self) -> tuple[jax.Array, jax.Array]:
        """Means with the mode's number `(x + 1, m)`, and covariances `(x, x, m)`."""
        count = self.probabilities.shape[0]
        laws = self.laws * count if len(self.laws) == 1 else self.laws
        means = jnp.stack([law.mean() for law in laws], axis=-1)
        numbers = jnp.arange(count, dtype=means.dtype)
        return jnp.concatenate([means, numbers[None]]), jnp.stack([law.cov() for law in laws], axis=-1)

    def sample(self, key: jax.Array, n: int) -> jax.Array:
        """Draw n points, `(x + 1, n)`."""
        rows = jnp.broadcast_to(self.probabilities[:, None], (self.probabilities.shape[0], n))
        modes = _drawn(random.child(key, 0), rows)
        points = of_mode(modes, [law.sample(random.child(key, 1), n) for law in self.laws])
        return jnp.concatenate([points, modes[None].astype(points.dtype)])

    def log_prob(self, value: jax.Array) -> jax.Array:
        """Log density at `(x + 1,)` or `(x + 1, n)`."""
        modes = number_of(value[-1], self.probabilities.shape[0])
        return log_probabilities(self.probabilities)[modes] + of_mode(modes, [law.log_prob(value[:-1]) for law in self.laws])


@record
class SwitchingDynamics(Conditional):
    """The mode goes on by its chain, then the rest of the state by the dynamics of the new mode.

    Attributes:
        transition: probabilities `(m, m)` or a function of (u, t) that returns them.
        parts: dynamics of each mode, or those that all share, which find the mode among their inputs (`WithMode`).
        count: number m of modes.
        angles: indices of the states that are angles.
    """

    transition: jax.Array | Callable[[Any, Any], Any]
    parts: tuple[Conditional, ...]
    count: int = static()
    angles: tuple[int, ...] = static(default=())

    @property
    def modes(self) -> int:  # type: ignore[override]
        """Number of modes."""
        return self.count

    def of_modes(self, u: Any) -> list[tuple[Conditional, Any]]:
        """Return the dynamics of each mode with the inputs that they take."""
        return one_by_one(self.parts, self.count, u)

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: a Gaussian says little of a mode."""
        _refuse_moments()

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Draw one state for each particle, `(x + 1, n)`."""
        rows = transition_matrix(self.transition, u, t, X.dtype)[number_of(X[-1], self.count)].T
        modes = _drawn(random.child(key, 0), rows)
        # one block of noise serves all modes, since each particle takes what only one of them gives
        moved = of_each(self.parts, self.count, modes, u, lambda part, u: part.sample(random.child(key, 1), X[:-1], u, t))
        return jnp.concatenate([moved, modes[None].astype(X.dtype)])

    def log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density given each particle; see `Conditional`."""
        before, after = (number_of(modes, self.count) for modes in (X[-1], value[-1]))
        log_transition = log_probabilities(transition_matrix(self.transition, u, t, X.dtype))[before, after]
        each = jnp.broadcast_to(after, X.shape[-1:])
        return log_transition + of_each(self.parts, self.count, each, u, lambda part, u: part.log_prob(value[:-1], X[:-1], u, t))


@record
class SwitchingSensor(Conditional):
    """The sensor of the mode that the state is in.

    Attributes:
        parts: sensor of each mode, or the one that all have, which finds the mode among its inputs (`WithMode`).
        count: number m of modes; 0 where the sensor of all asks for none.
    """

    parts: tuple[Conditional, ...]
    count: int = static(default=0)

    @property
    def marginalizes(self) -> bool:  # type: ignore[override]
        """Whether the sensors of all modes do."""
        return all(part.marginalizes for part in self.parts)

    @property
    def draws(self) -> bool:  # type: ignore[override]
        """Whether the sensors of all modes do."""
        return all(part.draws for part in self.parts)

    @property
    def measures_anything(self) -> bool:  # type: ignore[override]
        """Whether the sensors of all modes do."""
        return all(part.measures_anything for part in self.parts)

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: a Gaussian says little of a mode."""
        _refuse_moments()

    def _each(self, X: jax.Array, u: Any, ask: Callable[[Conditional, jax.Array, Any], Any]) -> Any:
        count = self.count or len(self.parts)
        return of_each(self.parts, count, number_of(X[-1], count), u, lambda part, u: ask(part, X[:-1], u))

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> Any:
        """Draw one measurement for each particle, particle axis last."""
        return self._each(X, u, lambda part, X, u: part.sample(key, X, u, t))

    def log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Log density given each particle; see `Conditional`."""
        return self._each(X, u, lambda part, X, u: part.log_prob(value, X, u, t))

    def max_log_prob(self, value: jax.Array, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Largest value that `log_prob` can take for each particle."""
        return self._each(X, u, lambda part, X, u: part.max_log_prob(value, X, u, t))


def _refuse_moments() -> NoReturn:
    checks.refuse("joined model", "a filter that needs no mean and covariance of dynamics and sensor", "one that does",
                  "Use InteractingMultipleModel, JumpMarkovFilter or ParticleFilter.")
