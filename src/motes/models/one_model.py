"""One model for all modes of a jump-Markov system: its functions take the mode as their last argument, and are traced once.

    f(x, u, t, mode),   Q(x, u, t, mode),   log_prob(y, x, u, t, mode),   ...

Within the library such a function finds the mode among its inputs (`laws.switching.WithMode`), so that everything that takes a model's
functions takes these.
"""

import dataclasses
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from motes.core.record import replace
from motes.laws.conditional import Conditional
from motes.laws.law import Law
from motes.laws.switching import WithMode
from motes.models.state_space import StateSpaceModel


def taking_mode(model: StateSpaceModel) -> StateSpaceModel:
    """Return a model whose functions find the mode among their inputs, of one whose functions take it as their last argument."""
    return _exchanged(model, _TakesMode)


def at_mode(model: StateSpaceModel, mode: int) -> StateSpaceModel:
    """Return a model whose functions find a given mode among their inputs, whatever these are; see `taking_mode`."""
    return _exchanged(model, partial(_AtMode, mode=np.int32(mode)))


class _TakesMode:
    """A user's function that takes the mode, where it takes one; equal where the user's are."""

    def __init__(self, func: Callable[..., Any]):
        self.func = func

    def __call__(self, *args: Any) -> Any:
        *given, seen, t = args
        plain = (*given, seen.u, t)
        return self.func(*plain, seen.mode) if _takes(self.func, len(plain)) else self.func(*plain)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _TakesMode) and self.func == other.func

    def __hash__(self) -> int:
        return hash((_TakesMode, self.func))


class _AtMode:
    """A function that finds the mode among its inputs, at one mode."""

    def __init__(self, func: Callable[..., Any], mode: np.int32):
        self.func, self.mode = func, mode

    def __call__(self, *args: Any) -> Any:
        *given, u, t = args
        return self.func(*given, WithMode(u, self.mode), t)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _AtMode) and (self.func, self.mode) == (other.func, other.mode)

    def __hash__(self) -> int:
        return hash((_AtMode, self.func, self.mode))


def _takes(function: Callable[..., Any], others: int) -> bool:
    """Tell whether a function wants the mode after so many other arguments: it cannot do without, or calls an argument so."""
    try:
        signature = inspect.signature(function)
    except ValueError:
        return True
    if "mode" in signature.parameters:
        return True
    try:
        signature.bind(*range(others))
    except TypeError:
        return True
    return False


def _exchanged(part: Any, change: Callable[[Callable[..., Any]], Any]) -> Any:
    """Exchange all functions of a model, or of a conditional and those within it."""

    def of(value: Any) -> Any:
        if isinstance(value, Conditional):
            return _exchanged(value, change)
        if isinstance(value, tuple):
            return tuple(of(each) for each in value)
        return change(value) if callable(value) and not isinstance(value, Law) else value

    return replace(part, **{field.name: of(getattr(part, field.name)) for field in dataclasses.fields(part)})
