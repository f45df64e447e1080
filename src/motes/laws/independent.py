"""Several sensors with noises of their own, each by its name: what one of them did not measure is left out."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motes.core import checks, linalg, random
from motes.core.record import record, static
from motes.laws.conditional import AdditiveGaussian, Conditional
from motes.laws.law import Law
from motes.laws.observed import Observed


def Independent(**sensors: Conditional) -> Conditional:  # noqa: N802 (makes a conditional, as those that it is made of)
    """Return the sensor of a model that has several, whose noises are independent given the state.

    Measurements are then dictionaries by name, time axis first: `{"radar": (t, 2), "camera": (t, 640, 480)}`; a sensor that is left out, or
    is NaN in a row, measured nothing there. Each has angles of its own, and a filter's `gate` holds for each alone. Where all noises are
    Gaussian with constant covariances, every filter takes it, Kalman filters too; otherwise those that weigh by a density.

    Args:
        sensors: each sensor by its name.

    Raises:
        MotesError: there are none, or one is no sensor.
    """
    if not sensors:
        checks.refuse("Independent", "at least one sensor by name", "none", "Write Independent(radar=..., camera=...).")
    for name, sensor in sensors.items():
        checks.instance(f"Independent {name}", sensor, Conditional, "a sensor such as AdditiveGaussian")
    names, parts = tuple(sensors), tuple(sensors.values())
    if all(isinstance(part, AdditiveGaussian) and not callable(part.Q) for part in parts):
        return Stacked(names, parts)  # type: ignore[arg-type]
    return Together(names, parts)


@record
class Stacked(AdditiveGaussian):
    """Sensors with Gaussian noise as one: their components one after the other.

    Attributes:
        parts: the sensors.
        of_parts: their names.
    """

    parts: tuple[AdditiveGaussian, ...] = ()
    of_parts: tuple[str, ...] = static(default=())

    def __init__(self, of_parts: tuple[str, ...], parts: tuple[AdditiveGaussian, ...]):
        """Take names and sensors, in the same order."""
        sizes = [part.Q.shape[0] for part in parts]  # type: ignore[union-attr]
        begins = np.cumsum([0, *sizes[:-1]])
        angles = tuple(int(begin) + angle % size for begin, size, part in zip(begins, sizes, parts, strict=True) for angle in part.angles)
        fields = {"f": _stacked_mean, "Q": linalg.block_diagonal([part.Q for part in parts]), "angles": angles, "parts": parts,
                  "of_parts": of_parts}  # fmt: skip
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def sensors(self) -> tuple[tuple[str, int], ...]:  # type: ignore[override]
        """Names and sizes of the sensors."""
        return tuple((name, part.Q.shape[0]) for name, part in zip(self.of_parts, self.parts, strict=True))  # type: ignore[union-attr]

    def mean(self, x: jax.Array, u: Any, t: Any) -> jax.Array:
        """Mean given one state, `(y,)`."""
        return jnp.concatenate([part.mean(x, u, t) for part in self.parts])

    def means(self, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Means given each particle, `(y, n)`."""
        return jnp.concatenate([part.means(X, u, t) for part in self.parts])

    def in_arrays(self, y: Any) -> Any:
        """Return one measurement by name with arrays in place of lists of numbers."""
        return _in_arrays(y)

    def packed(self, ys: Any) -> Any:
        """Return measurements by name, lists by name or a list with a dictionary for each step, as an array, time axis first."""
        if type(ys) in (list, tuple) and any(isinstance(one, Mapping) for one in ys):
            names = dict.fromkeys(name for one in ys if one is not None for name in one)
            ys = {name: [None if one is None else one.get(name) for one in ys] for name in names}
        if not isinstance(ys, Mapping):
            return ys
        sizes = dict(self.sensors)
        ys = {name: _listed_rows(name, own, sizes.get(name)) for name, own in ys.items() if own is not None}
        unknown = [name for name in ys if name not in sizes]
        if unknown or not ys:
            checks.refuse("ys", f"measurements of {', '.join(sizes)}", repr(unknown[0]) if unknown else "none")
        steps = _steps(ys)
        rows = []
        for name, size in sizes.items():
            if name not in ys:
                rows.append(np.full((steps, size), np.nan))
                continue
            array = checks.as_numbers(f"ys[{name!r}]", ys[name])
            array = array[:, None] if np.ndim(array) == 1 and size == 1 else array
            checks.shape(f"ys[{name!r}]", array, (steps, size), "(steps, components of that sensor)")
            rows.append(array)
        module = jnp if any(isinstance(row, jax.Array) for row in rows) else np
        return module.concatenate(rows, axis=1)


@record
class Together(Conditional):
    """Sensors of which not all have Gaussian noise of a constant covariance: densities, multiplied.

    Attributes:
        of_parts: names of the sensors.
        parts: the sensors.
    """

    of_parts: tuple[str, ...] = static()
    parts: tuple[Conditional, ...]
    measures_anything = True

    @property
    def marginalizes(self) -> bool:  # type: ignore[override]
        """Whether all sensors do."""
        return all(part.marginalizes for part in self.parts)

    def each(self, value: Any) -> list[tuple[Conditional, Any]]:
        """Return the sensors of which there are measurements, each with its own."""
        return [(part, value[name]) for name, part in self._by_name() if isinstance(value, Mapping) and name in value]

    def in_arrays(self, y: Any) -> Any:
        """Return one measurement by name with arrays in place of lists of numbers."""
        return _in_arrays(y)

    def packed(self, ys: Any) -> Any:
        """Return measurements by name, those of each sensor as it computes with them; a list with a dictionary for each step stays one."""
        if type(ys) in (list, tuple):
            return [_in_arrays(one) for one in ys]
        if not isinstance(ys, Mapping):
            return ys
        parts = dict(self._by_name())
        found = {name: parts[name].packed(own) if name in parts else own for name, own in ys.items() if own is not None}
        silent = [name for name, own in ys.items() if own is None]
        steps = jax.tree.leaves(found)[0].shape[0] if silent and found else 1
        return {name: parts[name].silence(steps) if name in silent and name in parts else found.get(name) for name in ys}

    def of_states(self, names: tuple[str, ...]) -> "Together":
        """Look up the states that sensors name."""
        return Together(self.of_parts, tuple(part.of_states(names) for part in self.parts))

    def given(self, x: jax.Array, u: Any, t: Any) -> Law:
        """Refuse: not all moments are known."""
        checks.refuse("Independent", "sensors that all have a Gaussian noise of constant covariance", ", ".join(self.of_parts),
                      "Use a ParticleFilter.")

    def sample(self, key: jax.Array, X: jax.Array, u: Any, t: Any) -> Any:
        """Draw one measurement of each sensor for each particle, particle axis last."""
        return {name: part.sample(random.child(key, place), X, u, t) for place, (name, part) in enumerate(self._by_name())}

    def log_prob(self, value: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Sum of the log densities of what was measured, `(n,)`."""
        found = [jnp.where(there, part.log_prob(own, X, u, t), 0) for part, own, there in self.measured(value)]
        return jnp.sum(jnp.stack([jnp.broadcast_to(one, X.shape[-1:]) for one in found]), axis=0)

    def max_log_prob(self, value: Any, X: jax.Array, u: Any, t: Any) -> jax.Array:
        """Sum of the largest values that the log densities can take, `(n,)`."""
        found = [jnp.where(there, part.max_log_prob(own, X, u, t), 0) for part, own, there in self.measured(value)]
        return jnp.sum(jnp.stack([jnp.broadcast_to(one, X.shape[-1:]) for one in found]), axis=0)

    def _by_name(self) -> list[tuple[str, Conditional]]:
        return list(zip(self.of_parts, self.parts, strict=True))

    def measured(self, y: Any) -> list[tuple[Conditional, Any, jax.Array]]:
        """Return each sensor that is in a measurement with its own, and whether that is one."""
        assert isinstance(y, Observed)
        if not isinstance(y.value, Mapping) or set(y.value) - set(self.of_parts):
            checks.refuse("ys", f"a dictionary of measurements of {', '.join(self.of_parts)}", f"{type(y.value).__name__}"
                          + (f" of {', '.join(map(str, y.value))}" if isinstance(y.value, Mapping) else ""))
        found = []
        for name, part in self._by_name():
            if name in y.value:
                own = y.value[name]
                there = own.there if isinstance(own, Observed) else _is_there(own)
                own = own.value if isinstance(own, Observed) else own
                vector = not isinstance(own, Mapping) and jnp.ndim(own) < 2
                found.append((part, jnp.atleast_1d(jnp.asarray(own)) if vector else Observed(own, there), there))
        return found


def _stacked_mean(x: jax.Array, u: Any, t: Any) -> jax.Array:
    raise NotImplementedError


def _in_arrays(y: Any) -> Any:
    if not isinstance(y, Mapping):
        return y
    return {name: checks.as_numbers(f"y[{name!r}]", own) if checks.are_numbers(own) else own for name, own in y.items()}


def _listed_rows(name: str, own: Any, size: int | None) -> Any:
    """Return what a sensor of so many components measured, where it is a list for each step, with NaN in place of None."""
    if type(own) not in (list, tuple) or size is None or not checks.is_concrete(own):
        return own
    return [np.full(size, np.nan) if one is None else np.atleast_1d(checks.as_numbers(f"ys[{name!r}]", one)) for one in own]


def _steps(ys: Mapping[str, Any]) -> int:
    lengths = {name: np.shape(value)[0] if np.ndim(value) else 0 for name, value in ys.items()}
    if len(set(lengths.values())) > 1:
        checks.refuse("ys", "arrays with the time axis first, of one length", ", ".join(f"{name}: {n}" for name, n in lengths.items()))
    return next(iter(lengths.values()))


def _is_there(own: Any) -> jax.Array:
    """Tell whether a sensor measured anything; whole numbers always say something."""
    leaves = jax.tree.leaves(own)
    if any(not jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves):
        return jnp.ones((), bool)
    return ~jnp.stack([jnp.all(jnp.isnan(leaf)) for leaf in leaves]).all()
