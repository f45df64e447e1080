"""A key of each particle's own: split from a shared one by `jax.random.split(key, n)`, and what a user's function draws with it.

The words are those of JAX's Threefry generator in its partitionable form: child and draw number k of a key are its cipher of k.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from motes.native.rules import Named, Scalar, Scalars, Untranslatable

KIND = "key"
"""A key is the names of its two words, `"v1, v2"`: loops that hold structures are not vectorized."""

NUMBERED = "random_split"
"""The operation that gives each particle a key, where it gives as many as there are particles."""


def numbered(named: Named, words: Scalars) -> Scalar:
    """Return the key of a particle, by its number, from the words of the shared key."""
    _check()
    first, second = words.flat
    return _child(named, f"{first.text}, {second.text}", "(uint32_t)(first + i)")


def _child(named: Named, key: str, number: str) -> Scalar:
    halves = (named("uint32_t", f"motes::threefry({{{key}}}, 0, {number}).{half}") for half in ("first", "second"))
    return Scalar(", ".join(half.text for half in halves), KIND)


def selected(named: Named, which: Scalars, *cases: Scalars) -> np.ndarray:
    """Choose between keys."""
    made = np.empty(cases[0].shape, object)
    for index in np.ndindex(*made.shape):
        names = [case[index].text.split(", ") for case in cases]
        found, test = names[-1], which[index].text
        for i, own in reversed(list(enumerate(names[:-1]))):
            found = [named("uint32_t", f"{test} <= {i} ? {one} : {other}").text for one, other in zip(own, found, strict=True)]
        made[index] = Scalar(", ".join(found), KIND)
    return made


def _check() -> None:
    if not jax.config.jax_threefry_partitionable:  # type: ignore[attr-defined]
        raise Untranslatable("keys of each particle's own with jax_threefry_partitionable off")


def _children(named: Named, params: dict[str, Any], keys: Scalars) -> np.ndarray:
    return _each(keys, params["shape"], lambda key, k: _child(named, key.text, f"{k}u"))


def _bits(named: Named, params: dict[str, Any], keys: Scalars) -> np.ndarray:
    width = params["bit_width"]
    if width not in (32, 64):
        raise Untranslatable(f"random words of {width} bits")
    word = "motes::word" if width == 32 else "motes::word_of_64"
    return _each(keys, params["shape"], lambda key, k: named(f"uint{width}_t", f"{word}({{{key.text}}}, {k}u)"))


def _folded(named: Named, params: dict[str, Any], keys: Scalars, numbers: Scalars) -> np.ndarray:
    made, numbers = np.empty(keys.shape, object), np.broadcast_to(numbers, keys.shape)
    for index in np.ndindex(*keys.shape):
        made[index] = _child(named, keys[index].text, f"(uint32_t){numbers[index].text}")
    return made


def _each(keys: Scalars, shape: tuple[int, ...], draw: Callable[[Scalar, int], Scalar]) -> np.ndarray:
    _check()
    made = np.empty((*keys.shape, *shape), object)
    for index in np.ndindex(*keys.shape):
        for k, place in enumerate(np.ndindex(*shape)):
            made[(*index, *place)] = draw(keys[index], k)
    return made


DRAWN: dict[str, Callable[..., np.ndarray]] = {"random_split": _children, "random_bits": _bits, "random_fold_in": _folded}
"""What is drawn from keys of each particle's own, from what names expressions, parameters and operands."""
