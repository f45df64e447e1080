"""A key of each particle's own: split from a shared one by `jax.random.split(key, n)`, and what a user's function draws with it.

The words are those of JAX's Threefry generator in its partitionable form: child and draw number k of a key are its cipher of k.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from motes.native.rules import Scalar, Untranslatable

KIND = "Key"
"""C++ type of a key."""

NUMBERED = "random_split"
"""The operation that gives each particle a key, where it gives as many as there are particles."""


def numbered(words: np.ndarray) -> Scalar:
    """Return the key of a particle, by its number, from the words of the shared key."""
    _check()
    first, second = words.flat
    return Scalar(f"motes::child({{{first.text}, {second.text}}}, 0, (uint32_t)(first + i))", KIND)


def _check() -> None:
    if not jax.config.jax_threefry_partitionable:  # type: ignore[attr-defined]
        raise Untranslatable("keys of each particle's own with jax_threefry_partitionable off")


def _children(named: Callable[[str, str], Scalar], params: dict[str, Any], keys: np.ndarray) -> np.ndarray:
    return _each(keys, params["shape"], lambda key, k: named(KIND, f"motes::child({key.text}, 0, {k}u)"))


def _bits(named: Callable[[str, str], Scalar], params: dict[str, Any], keys: np.ndarray) -> np.ndarray:
    if params["bit_width"] != 32:
        raise Untranslatable(f"random words of {params['bit_width']} bits")
    return _each(keys, params["shape"], lambda key, k: named("uint32_t", f"motes::word({key.text}, {k}u)"))


def _folded(named: Callable[[str, str], Scalar], params: dict[str, Any], keys: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    made, numbers = np.empty(keys.shape, object), np.broadcast_to(numbers, keys.shape)
    for index in np.ndindex(*keys.shape):
        made[index] = named(KIND, f"motes::child({keys[index].text}, 0, {numbers[index].text})")
    return made


def _each(keys: np.ndarray, shape: tuple[int, ...], draw: Callable[[Scalar, int], Scalar]) -> np.ndarray:
    _check()
    made = np.empty((*keys.shape, *shape), object)
    for index in np.ndindex(*keys.shape):
        for k, place in enumerate(np.ndindex(*shape)):
            made[(*index, *place)] = draw(keys[index], k)
    return made


DRAWN: dict[str, Callable[..., np.ndarray]] = {"random_split": _children, "random_bits": _bits, "random_fold_in": _folded}
"""What is drawn from keys of each particle's own, from what names expressions, parameters and operands."""
