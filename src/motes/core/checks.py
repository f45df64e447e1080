"""Checks of what the user gives: every refusal is one line that names the argument, what was expected, what was given, what to do."""

import importlib
import sys
import warnings
from decimal import Decimal
from numbers import Real
from types import ModuleType
from typing import Any, NoReturn, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

LONGEST = 500
T = TypeVar("T")


class MotesError(ValueError):
    """Something the user gave cannot be used; the message is one line of at most 500 printable characters."""

    def __init__(self, message: str):
        """Keep the message printable and on one line, whatever names or values it quotes."""
        line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
        super().__init__(line if len(line) <= LONGEST else line[: LONGEST - 3] + "...")


class FileError(MotesError):
    """A file cannot be read or written as asked."""


class CollapseError(MotesError):
    """No particle (or no prediction) explains a measurement: all weights vanished."""


class MissingExtraError(MotesError, ImportError):
    """A feature needs a package that is not installed."""


class MotesWarning(UserWarning):
    """A result is there, but should not be trusted as it is."""


def warn(text: str) -> None:
    """Warn in one line, at the place outside of the library (and JAX) from where it was called."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(("motes.", "jax.", "contextlib")):
        level, frame = level + 1, frame.f_back
    warnings.warn(str(MotesError(text)), MotesWarning, stacklevel=level)


def refuse(argument: str, expected: str, given: object, hint: str = "", error: type[MotesError] = MotesError) -> NoReturn:
    """Raise `error` with the project's one form of message."""
    raise error(f"{argument}: expected {expected}, got {given}." + (f" {hint}" if hint else ""))


def need(module: str, extra: str) -> ModuleType:
    """Import an optional module, or say which extra brings it.

    Raises:
        MissingExtraError: the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as reason:
        package = module.split(".")[0]
        raise MissingExtraError(
            f"{package}: needed for this and not usable here ({reason}); install it with: pip install 'motes[{extra}]'."
        ) from None


def is_concrete(value: Any) -> bool:
    """Tell whether a value is known now (not a tracer inside jit, vmap or grad)."""
    leaves = [value] if isinstance(value, (np.ndarray, jax.Array)) else jax.tree.leaves(value)
    return not any(isinstance(leaf, Tracer) for leaf in leaves)


def are_numbers(value: Any) -> bool:
    """Tell a list of numbers, or of lists of them, None among them, from a list of arrays."""
    return type(value) in (list, tuple) and all(np.ndim(leaf) == 0 for leaf in jax.tree.leaves(value, is_leaf=lambda leaf: leaf is None))


def as_numbers(argument: str, value: Any, expected: str = "an array of numbers") -> Any:
    """Return what the user gives as an array of real numbers in which NaN stands for what is missing; the one place that decides that.

    Missing are: masked entries of NumPy's masked arrays, NA and NaT of pandas, None, NaN. Arrays of JAX come back as they are.

    Args:
        argument: name to use in the message.
        value: an array, or whatever NumPy makes one of: lists, tables of pandas, xarray, pyarrow.
        expected: what it should be, for the message.

    Raises:
        MotesError: it holds something that is no real number.
    """
    if isinstance(value, jax.Array) or (type(value) is np.ndarray and value.dtype.kind in "biuf"):
        return value
    if isinstance(value, (list, tuple)):
        if not is_concrete(value):
            return jnp.asarray(value)
        # NumPy would drop the masks of masked arrays in a list
        value = [item if isinstance(item, (int, float)) else _unmasked(item) for item in value]
    try:
        array = np.asarray(_unmasked(value))
    except (TypeError, ValueError):
        refuse(argument, expected, *_ragged(value))
    if array.dtype == object:
        array = np.array([_as_number(argument, item, place, expected) for place, item in np.ndenumerate(array)]).reshape(array.shape)
    if array.dtype.kind not in "biuf" and not jnp.issubdtype(array.dtype, jnp.floating):
        refuse(argument, expected, f"dtype {array.dtype}")
    return array


def _unmasked(value: Any) -> Any:
    """Return the same with None in place of masked entries, as objects, wherever a mask is."""
    if isinstance(value, (list, tuple)):
        return [_unmasked(item) for item in value]
    if not isinstance(value, np.ma.MaskedArray) or not np.ma.is_masked(value):
        return value.data if isinstance(value, np.ma.MaskedArray) else value
    if np.issubdtype(value.dtype, np.floating):
        return value.filled(np.nan)
    items = value.data.astype(object)
    items[np.ma.getmaskarray(value)] = None
    return items


def _ragged(value: Any) -> tuple[str, str]:
    """Return what is wrong with what NumPy makes no array of, and what to do."""
    lengths = [len(row) for row in value if isinstance(row, (list, tuple, np.ndarray))] if isinstance(value, (list, tuple)) else []
    if len(set(lengths)) < 2:
        return type(value).__name__, ""
    shown = ", ".join(map(str, lengths[:5])) + ", ..." * (len(lengths) > 5)
    return f"rows of {shown} numbers", "Give NaN where nothing was measured; mo.sightings and mo.plots take rows of any number."


def _as_number(argument: str, item: Any, place: tuple[int, ...], expected: str) -> float:
    if item is None or type(item).__name__ in ("NAType", "NaTType") or (isinstance(item, np.datetime64) and np.isnat(item)):
        return np.nan
    try:
        if isinstance(item, (Real, Decimal, np.bool_)) or getattr(item, "shape", None) == ():
            return float(item)
    except (TypeError, ValueError, OverflowError):
        pass
    refuse(argument, expected, f"{item!r:.80} at index {list(place)}")


def as_float(argument: str, value: Any) -> jax.Array:
    """Return an array of floats, or refuse; see `as_numbers`."""
    # a bare number keeps the freedom of its type
    array = jnp.asarray(value if isinstance(value, (bool, int, float)) else as_numbers(argument, value))
    if jnp.issubdtype(array.dtype, jnp.floating):
        return array
    if jnp.issubdtype(array.dtype, jnp.integer) or array.dtype == bool:
        return array.astype(jnp.result_type(float))
    refuse(argument, "real numbers", f"dtype {array.dtype}")


def unknown(value: Any, dtype: Any = None, nan: bool = True) -> np.ndarray | None:
    """Return the index of the first number that is infinite, also once it has the type it is computed with, or NaN; None if there is none.

    Args:
        value: array of numbers.
        dtype: type it is computed with; the one JAX gives it otherwise.
        nan: whether NaN counts.
    """
    held = np.asarray(value)
    if dtype is None or held.dtype != dtype:  # a stream asks this at each step
        if not jnp.issubdtype(held.dtype, jnp.floating):
            return None
        with np.errstate(over="ignore"):
            held = held.astype(jax.dtypes.canonicalize_dtype(held.dtype) if dtype is None else dtype, copy=False)
    wrong = ~np.isfinite(held) if nan else np.isinf(held)
    return np.argwhere(wrong)[0] if wrong.any() else None


def shape(argument: str, value: Any, expected: tuple[int | None, ...], meaning: str = "") -> None:
    """Refuse a value whose shape is not the expected one (None in the expected shape matches any length)."""
    given = np.shape(value)
    if len(given) != len(expected) or any(e is not None and e != g for e, g in zip(expected, given, strict=True)):
        wanted = "(" + ", ".join("any" if e is None else str(e) for e in expected) + ("," if len(expected) == 1 else "") + ")"
        refuse(argument, f"shape {wanted}{' ' + meaning if meaning else ''}", f"shape {given}")


def covariance(argument: str, value: Any, size: int, definite: bool = False) -> None:
    """Refuse what is not a covariance of the given size; only the shape is checked where the numbers are not known yet.

    Args:
        argument: name to use in the message.
        value: the matrix, `(size, size)`.
        size: number of components.
        definite: ask for positive definite instead of positive semi-definite.
    """
    shape(argument, value, (size, size), "(a covariance matrix)")
    if not is_concrete(value) or size == 0:
        return
    matrix = np.asarray(value, dtype=np.float64)
    if not np.isfinite(matrix).all():
        refuse(argument, "finite numbers in the covariance", "NaN or infinite entries")
    scale = np.sqrt(np.outer(np.abs(np.diag(matrix)), np.abs(np.diag(matrix)))) + np.finfo(np.float64).tiny
    asymmetry = np.abs(matrix - matrix.T)
    if (asymmetry > 1e-5 * (scale + np.abs(matrix))).any():
        i, j = np.unravel_index(np.argmax(asymmetry), matrix.shape)
        refuse(argument, "a symmetric covariance", f"{matrix[i, j]:.6g} at [{i}, {j}] but {matrix[j, i]:.6g} at [{j}, {i}]")
    kind = "positive definite" if definite else "positive semi-definite"
    if (np.diag(matrix) < 0).any() or (definite and (np.diag(matrix) <= 0).any()):
        refuse(argument, f"a {kind} covariance", f"variances {np.diag(matrix).tolist()}")
    # scaled to a correlation matrix first, so that small variances beside large ones are judged alike
    lowest = float(np.linalg.eigvalsh(matrix / scale).min())
    if lowest < -1e-5 or (definite and lowest <= 0):
        refuse(argument, f"a {kind} covariance", f"one whose scaled matrix has the eigenvalue {lowest:.3g}")


def finite(argument: str, value: Any, hint: str = "") -> None:
    """Refuse infinite or NaN numbers, as far as they are known."""
    if is_concrete(value) and not np.isfinite(np.asarray(value)).all():
        where = np.argwhere(~np.isfinite(np.asarray(value)))[0].tolist()
        refuse(argument, "finite numbers", f"{np.asarray(value)[tuple(where)]} at index {where}", hint)


def instance(argument: str, value: Any, kind: type[T], expected: str) -> T:
    """Return a value of a kind, or refuse any other."""
    if not isinstance(value, kind):
        refuse(argument, expected, type(value).__name__)
    return value


def positive_integer(argument: str, value: Any) -> None:
    """Refuse what is not a whole number of at least one."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        refuse(argument, "a whole number of at least 1", repr(value))


def natural(argument: str, value: Any) -> None:
    """Refuse what is not a whole number of at least zero."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        refuse(argument, "a whole number of at least 0", repr(value))


def above_zero(argument: str, value: Any, top: float = float("inf")) -> None:
    """Refuse what is not a number above zero and at most `top`, as far as it is known."""
    if is_concrete(value) and not (np.ndim(value) == 0 and np.asarray(value).dtype.kind in "biuf" and 0 < value <= top):
        refuse(argument, "a number above 0" + ("" if top == float("inf") else f" and at most {top:g}"), value)


def probability(argument: str, value: Any) -> None:
    """Refuse what does not lie between 0 and 1, neither of them included, as far as it is known."""
    if is_concrete(value) and not (np.ndim(value) == 0 and np.asarray(value).dtype.kind in "biuf" and 0 < value < 1):
        refuse(argument, "a probability between 0 and 1", value)


def option(argument: str, value: Any, allowed: tuple[str, ...]) -> None:
    """Refuse a word that is not one of the allowed ones."""
    if value not in allowed:
        refuse(argument, "one of " + ", ".join(map(repr, allowed)), repr(value))
