"""Parameters as a user gives them, by name, and coordinates in which they are free of bounds."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks
from motes.core.record import record, static


@record
class Parameters:
    """Numbers by name, some of them held, and where each may lie.

    A coordinate z stands for a parameter: a multiple of its first size where it has no bounds, else the logarithm of its distance from the
    bound, or the logit of its place between two.

    Attributes:
        names: of the p numbers.
        groups: name and shape of each entry of the dictionary that the user's function takes.
        by_name: whether it takes a dictionary; otherwise a vector `(p,)`.
        lower: bounds, minus infinity for none.
        upper: likewise.
        values: first values, `(p,)`.
        held: which of them stay at these, `(p,)`.
    """

    names: tuple[str, ...] = static()
    groups: tuple[tuple[str, tuple[int, ...]], ...] = static()
    by_name: bool = static()
    lower: tuple[float, ...] = static()
    upper: tuple[float, ...] = static()
    values: Any
    held: Any

    @property
    def free(self) -> np.ndarray:
        """Which of them are not held, `(p,)`."""
        return ~np.asarray(self.held)

    def natural(self, z: Any) -> jax.Array:
        """Return the parameters `(p,)` at coordinates `(p,)`."""
        size = jnp.where(self.values == 0, 1.0, jnp.abs(self.values))
        each = [_inward(z[i], low, high, size[i]) for i, (low, high) in enumerate(zip(self.lower, self.upper, strict=True))]
        return jnp.where(self.held, self.values, jnp.stack(each))

    def coordinates(self) -> np.ndarray:
        """Return the coordinates `(p,)` of the first values."""
        values, sides = np.asarray(self.values, np.float64), zip(self.lower, self.upper, strict=True)
        found = [_outward(value, low, high) for value, (low, high) in zip(values, sides, strict=True)]
        return np.where(self.held, 0.0, found)

    def given(self, values: Any) -> Any:
        """Return parameters `(p,)` as the user's function takes them."""
        return grouped(self.groups, values) if self.by_name else values


def grouped(groups: Iterable[tuple[str, tuple[int, ...]]], values: Any) -> dict[str, Any]:
    """Return numbers `(p,)` as a dictionary of entries of some shapes."""
    found, at = {}, 0
    for name, shape in groups:
        size = int(np.prod(shape, dtype=int))
        found[name] = values[at : at + size].reshape(shape)
        at += size
    return found


def _inward(z: jax.Array, low: float, high: float, size: jax.Array) -> jax.Array:
    if np.isinf(low) and np.isinf(high):
        return z * size
    if np.isinf(high):
        return low + jnp.exp(z)
    return high - jnp.exp(z) if np.isinf(low) else low + (high - low) * jax.nn.sigmoid(z)


def _outward(value: float, low: float, high: float) -> float:
    with np.errstate(all="ignore"):
        if np.isinf(low) and np.isinf(high):
            return 1.0 if value > 0 else -1.0 if value < 0 else 0.0
        if np.isinf(high):
            return np.log(value - low)
        return np.log(high - value) if np.isinf(low) else np.log(value - low) - np.log(high - value)


def parameters_of(init: Any, names: Any, fixed: Any, positive: Any, bounds: Any) -> Parameters:
    """Return what a user says of parameters; see `fit` for the arguments.

    Raises:
        MotesError: a name is unknown, or a number cannot be used.
    """
    entries, fixed = _entries(init, names), _mapping("fit fixed", fixed)
    if isinstance(init, Mapping):
        entries |= {name: _as_reals(f"fit fixed[{name!r}]", value) for name, value in fixed.items()
                    if isinstance(name, str) and name not in entries and name not in _elements(entries)}  # fmt: skip
    if not entries:
        checks.refuse("fit init", "at least one parameter", "none")
    groups = tuple((name, np.shape(value)) for name, value in entries.items())
    named = _elements(entries)
    values = np.concatenate([np.ravel(value) for value in entries.values()])
    lower, upper, held = np.full(len(named), -np.inf), np.full(len(named), np.inf), np.zeros(len(named), bool)
    for name, value in fixed.items():
        places = _standing("fit fixed", name, entries)
        number = _as_reals(f"fit fixed[{name!r}]", value)
        if number.size not in (1, len(places)):
            checks.refuse(f"fit fixed[{name!r}]", f"{len(places)} numbers, as in init", number.size)
        values[places], held[places] = np.ravel(number), True
    for name in (positive,) if isinstance(positive, str) else tuple(positive):
        lower[_standing("fit positive", name, entries)] = 0.0
    for name, pair in _mapping("fit bounds", bounds).items():
        places = _standing("fit bounds", name, entries)
        lower[places], upper[places] = _pair(name, pair, bool((lower[places] == 0).any()))
    _ask_inside(named, values, held, lower, upper)
    if held.all():
        checks.refuse("fit fixed", "at least one parameter left to estimate", "all of them")
    return Parameters(named, groups, isinstance(init, Mapping), tuple(lower.tolist()), tuple(upper.tolist()), values, held)


def _entries(init: Any, names: Any) -> dict[str, np.ndarray]:
    """Return starting values by name."""
    if isinstance(init, Mapping):
        if names is not None:
            checks.refuse("fit names", "none beside a dictionary, which has them", repr(names)[:80])
        if not all(isinstance(name, str) for name in init):
            checks.refuse("fit init", "names that are words", repr([name for name in init if not isinstance(name, str)])[:80])
        return {name: _as_reals(f"fit init[{name!r}]", value) for name, value in init.items()}
    vector = _as_reals("fit init", init, "a dictionary of numbers by name, or a vector (p,)")
    checks.shape("fit init", vector, (None,), "(a vector of parameters, or a dictionary by name)")
    names = [f"theta{i}" for i in range(vector.size)] if names is None else [names] if isinstance(names, str) else list(names)
    if len(names) != vector.size or len(set(names)) != len(names) or not all(isinstance(name, str) for name in names):
        checks.refuse("fit names", f"{vector.size} different names, one for each number of init", repr(names)[:200])
    return dict(zip(names, vector, strict=True))


def _as_reals(argument: str, value: Any, expected: str = "a number, or an array of numbers") -> np.ndarray:
    found = np.asarray(checks.as_numbers(argument, value, expected), np.float64)
    checks.finite(argument, found)
    return found


def _elements(entries: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Return a name for each number."""
    return tuple(name + (f"[{','.join(map(str, place))}]" if place else "") for name, value in entries.items()
                 for place in np.ndindex(np.shape(value)))  # fmt: skip


def _standing(argument: str, name: Any, entries: Mapping[str, np.ndarray]) -> list[int]:
    """Return where the numbers of a parameter stand, given by its name, or by that of one of its numbers."""
    named = _elements(entries)
    if name in named:
        return [named.index(name)]
    if isinstance(name, str) and name in entries:
        before = list(entries)[: list(entries).index(name)]
        first = sum(np.size(entries[one]) for one in before)
        return list(range(first, first + np.size(entries[name])))
    checks.refuse(argument, f"names of parameters: {', '.join(entries)}", repr(name))


def _mapping(argument: str, value: Any) -> Mapping[Any, Any]:
    return checks.instance(argument, {} if value is None else value, Mapping, "a dictionary by name")  # type: ignore[type-abstract]


def _pair(name: str, pair: Any, twice: bool) -> tuple[float, float]:
    """Return two bounds, infinite where there is none."""
    expected = "a pair (low, high), None for no bound"
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        checks.refuse(f"fit bounds[{name!r}]", expected, repr(pair)[:80])
    if twice:
        checks.refuse(f"fit bounds[{name!r}]", "a parameter that is not in positive=", "one that is", "Say (0, high) here alone.")
    low, high = (side if one is None else float(_as_reals(f"fit bounds[{name!r}]", one))
                 for one, side in zip(pair, (-np.inf, np.inf), strict=True))  # fmt: skip
    if not low < high:
        checks.refuse(f"fit bounds[{name!r}]", expected, repr(pair)[:80])
    return low, high


def _ask_inside(names: tuple[str, ...], values: np.ndarray, held: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Refuse starting values that do not lie between their bounds; those that stay may lie on them."""
    for name, value, low, high, stays in zip(names, values, lower, upper, held, strict=True):
        inside = low <= value <= high if stays else low < value < high
        if not inside:
            where = f"above {low:g}" if np.isinf(high) else f"below {high:g}" if np.isinf(low) else f"between {low:g} and {high:g}"
            checks.refuse(f"fit {'fixed' if stays else 'init'}[{name!r}]", f"a number {where}", f"{value:g}")
