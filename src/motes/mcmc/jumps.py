"""Moves between models of different size, and templates of the usual ones: birth and death, split and merge, change points.

A move is a deterministic map of (model, x, u, choice) to (model', x', u', choice') that another move undoes (Green 1995). x is padded to
the size of the largest model; its live components come first. u are random numbers, choice a random whole number. `mcmc.ReversibleJump`
draws them, takes the map's Jacobian by differentiation and checks that the other move leads back.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from motes.core import checks
from motes.core.record import record, static
from motes.laws.law import Law
from motes.laws.noise import Uniform

JumpMap = Callable[[Any, jax.Array, jax.Array, jax.Array], tuple[Any, jax.Array, jax.Array, jax.Array]]


class Configuration(NamedTuple):
    """A position that says which model it belongs to.

    Attributes:
        model: whole numbers of any shape that name the model.
        x: its parameters `(x,)`, live ones first, the rest zero.
    """

    model: Any
    x: jax.Array


@record
class Jump:
    """One move between models.

    Attributes:
        map: `(model, x, u, choice)` to `(model', x', u', choice')`; must not draw numbers of its own.
        reverse: name of the jump that undoes it; a jump may undo itself.
        law: of u `(u,)`, or a function `(model, x, choice)` that returns one; None where there is no u.
        choices: function `(model, x)` that returns log weights `(c,)` of the choices, -inf for those that cannot be; a jump without any
            is not tried. None: one choice, 0.
    """

    map: JumpMap = static()
    reverse: str = static()
    law: Any = None
    choices: Callable[..., jax.Array] | None = static(default=None)

    def law_at(self, model: Any, x: jax.Array, choice: jax.Array) -> Law | None:
        """Return the law of u."""
        return self.law if self.law is None or isinstance(self.law, Law) else self.law(model, x, choice)

    def log_choices(self, model: Any, x: jax.Array) -> jax.Array:
        """Return log weights of the choices `(c,)`."""
        return jnp.zeros(1, x.dtype) if self.choices is None else jnp.asarray(self.choices(model, x), x.dtype)


def _inserted(items: jax.Array, place: jax.Array, item: jax.Array) -> jax.Array:
    """Put an item at a place of a list `(n, ...)`; the last one falls off."""
    where = jnp.arange(items.shape[0])
    shifted = items[jnp.maximum(where - 1, 0)]
    mask = where.reshape(-1, *([1] * (items.ndim - 1)))
    return jnp.where(mask < place, items, jnp.where(mask == place, item, shifted))


def _removed(items: jax.Array, place: jax.Array) -> jax.Array:
    """Take the item at a place out of a list `(n, ...)`; zeros come in at the end."""
    where = jnp.arange(items.shape[0])
    following = jnp.concatenate([items[1:], jnp.zeros_like(items[:1])])
    return jnp.where(where.reshape(-1, *([1] * (items.ndim - 1))) < place, items, following)


def _parts(x: jax.Array, fixed: int, width: int) -> tuple[jax.Array, jax.Array]:
    return x[:fixed], x[fixed:].reshape(-1, width)


def _whole(head: jax.Array, items: jax.Array) -> jax.Array:
    return jnp.concatenate([head, items.reshape(-1)])


def _log_uniform(count: jax.Array, possible: int) -> jax.Array:
    """Log weights of `count` equal choices among `possible` numbers."""
    return jnp.where(jnp.arange(possible) < count, 0.0, -jnp.inf)


def birth_death(law: Law, most: int, fixed: int = 0) -> dict[str, Jump]:
    """Return the jumps "birth", a new component drawn from a law, and "death", one component less.

    The model is the number of components, `()`; x are `fixed` numbers that all models share, then the components, each as long as a draw of
    the law, in a list whose order counts. A component is born at any place of the list, and any one dies.

    Args:
        law: of a component `(c,)`.
        most: components.
        fixed: numbers that all models share.
    """
    checks.positive_integer("birth_death most", most)

    def birth(k: Any, x: jax.Array, u: jax.Array, place: jax.Array) -> Any:
        head, items = _parts(x, fixed, u.shape[0])
        return k + 1, _whole(head, _inserted(items, place, u)), u[:0], place

    def death(width: int) -> JumpMap:
        def removed(k: Any, x: jax.Array, u: jax.Array, place: jax.Array) -> Any:
            head, items = _parts(x, fixed, width)
            return k - 1, _whole(head, _removed(items, place)), items[place], place

        return removed

    if not isinstance(law, Law):
        checks.refuse("birth_death law", "a law of one component", type(law).__name__, "For a law that depends on x write a Jump.")
    width = law.mean().shape[0]
    return {
        "birth": Jump(birth, "death", law, lambda k, x: jnp.where(k < most, _log_uniform(k + 1, most), -jnp.inf)),
        "death": Jump(death(width), "birth", None, lambda k, x: _log_uniform(k, most)),
    }


def split_merge(
    split: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]],
    merge: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]],
    law: Law,
    most: int,
    width: int = 1,
    fixed: int = 0,
) -> dict[str, Jump]:
    """Return the jumps "split", one component into two, and "merge", two into one; the list is as in `birth_death`.

    Args:
        split: component `(c,)` and u `(u,)` to two components.
        merge: its inverse: two components to one and u.
        law: of u.
        most: components.
        width: c, numbers of a component.
        fixed: numbers that all models share.
    """
    checks.positive_integer("split_merge most", most)
    first, second = (places.reshape(-1) for places in jnp.meshgrid(jnp.arange(most), jnp.arange(most), indexing="ij"))

    # choice: the places of the two in the longer list
    def pairs(count: jax.Array) -> jax.Array:
        return jnp.where((first < count) & (second < count) & (first != second), 0.0, -jnp.inf)

    def apart(k: Any, x: jax.Array, u: jax.Array, choice: jax.Array) -> Any:
        head, items = _parts(x, fixed, width)
        one, other = first[choice], second[choice]
        old = one - (one > other)
        a, b = split(items[old], u)
        return k + 1, _whole(head, _inserted(items.at[old].set(a), other, b)), u[:0], choice

    def together(k: Any, x: jax.Array, u: jax.Array, choice: jax.Array) -> Any:
        head, items = _parts(x, fixed, width)
        one, other = first[choice], second[choice]
        whole, u = merge(items[one], items[other])
        return k - 1, _whole(head, _removed(items.at[one].set(whole), other)), u, choice

    return {
        "split": Jump(apart, "merge", law, lambda k, x: jnp.where(k < most, pairs(k + 1), -jnp.inf)),
        "merge": Jump(together, "split", None, lambda k, x: pairs(k)),
    }


def change_points(most: int, places: int, reach: int = 1) -> dict[str, Jump]:
    """Return jumps for levels that change at some of many possible places (Green 1995, section 4, on a grid).

    The model says of each of the `places` between intervals whether the level changes there, `(places,)` of 0 and 1; x are the levels, all
    positive, one more than changes. "birth" makes a change and splits a level h over two spans of lengths L and M into
    h (u / (1 - u))^(M / (L + M)) and h ((1 - u) / u)^(L / (L + M)), u uniform, which keeps the mean of the logarithms; "death" undoes it;
    "shift" moves a change by up to `reach` places.

    Args:
        most: changes.
        places: where a change can be.
        reach: of a shift.
    """
    for name, value in (("most", most), ("places", places), ("reach", reach)):
        checks.positive_integer(f"change_points {name}", value)

    def birth(model: jax.Array, x: jax.Array, u: jax.Array, place: jax.Array) -> Any:
        level, left, right = _spans(model, place)
        log_ratio, share = jnp.log(u[0]) - jnp.log1p(-u[0]), left / (left + right)
        low, high = x[level] * jnp.exp((1 - share) * log_ratio), x[level] * jnp.exp(-share * log_ratio)
        return model.at[place].set(1), _inserted(x.at[level].set(high), level, low), u[:0], place

    def death(model: jax.Array, x: jax.Array, u: jax.Array, place: jax.Array) -> Any:
        level, left, right = _spans(model, place)
        low, high = x[level], x[level + 1]
        share = left / (left + right)
        merged = jnp.exp(share * jnp.log(low) + (1 - share) * jnp.log(high))
        return model.at[place].set(0), _removed(x.at[level + 1].set(merged), level), (low / (low + high))[None], place

    def free(model: jax.Array, x: jax.Array) -> jax.Array:
        return jnp.where((model == 0) & (jnp.sum(model) < most), 0.0, -jnp.inf)

    return {
        "birth": Jump(birth, "death", Uniform(jnp.zeros(1), jnp.ones(1)), free),
        "death": Jump(death, "birth", None, lambda model, x: jnp.where(model > 0, 0.0, -jnp.inf)),
        "shift": _shift(places, reach),
    }


def _spans(model: jax.Array, place: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Which level ends at a place, and the lengths of the spans before and after it."""
    grid = jnp.arange(model.shape[0])
    before = jnp.max(jnp.where((model > 0) & (grid < place), grid + 1, 0))
    after = jnp.min(jnp.where((model > 0) & (grid > place), grid + 1, model.shape[0] + 1))
    return jnp.sum(jnp.where(grid < place, model, 0)), place + 1 - before, after - place - 1


def _shift(places: int, reach: int) -> Jump:
    """Return the jump that moves a change without passing another."""
    steps = jnp.array([step for step in range(-reach, reach + 1) if step])

    def landing(choice: jax.Array) -> tuple[jax.Array, jax.Array]:
        return choice // steps.shape[0], choice // steps.shape[0] + steps[choice % steps.shape[0]]

    def shift(model: jax.Array, x: jax.Array, u: jax.Array, choice: jax.Array) -> Any:
        here, there = landing(choice)
        back = there * steps.shape[0] + steps.shape[0] - 1 - choice % steps.shape[0]
        return model.at[here].set(0).at[there].set(1), x, u, back

    def shiftable(model: jax.Array, x: jax.Array) -> jax.Array:
        here, there = landing(jnp.arange(places * steps.shape[0]))
        inside = (there >= 0) & (there < places)
        clear = model.at[jnp.clip(there, 0, places - 1)].get() == 0
        # no other change may lie between, so that the levels keep their order
        count = jnp.concatenate([jnp.zeros(1, model.dtype), jnp.cumsum(model)])
        low, high = jnp.minimum(here, there), jnp.maximum(here, there)
        alone = count[jnp.clip(high, 0, places - 1) + 1] - count[jnp.clip(low, 0, places - 1)] == 1
        return jnp.where(inside & clear & alone & (model[here] > 0), 0.0, -jnp.inf)

    return Jump(shift, "shift", None, shiftable)
