"""What is known of one array of a traced program: which variables its elements depend on, and how.

Throughout, m is the number of variables, and an element is *affine* in a set of variables when it is so for every
fixed value of the others.
"""

from collections.abc import Sequence
from math import prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

KNOWN_LIMIT = 100_000  # elements; the numbers of larger arrays are not looked at


class Value(NamedTuple):
    """What is known of one array of the program; the leading axes of every field are those of the array.

    Fields that say the same of all elements are views with a stride of zero: large constant arrays cost nothing.
    """

    live: np.ndarray  # bool (*shape,): False where the element is zero whatever the variables are
    uses: np.ndarray  # bool (*shape, m): the variables that the element depends on
    pairs: np.ndarray  # bool (*shape, m, m), symmetric: the pairs in which the element is not jointly affine
    known: Any = None  # the array itself, if it is known now


def constant(shape: tuple[int, ...], count: int, known: Any = None) -> Value:
    """Return an array that depends on none of the `count` variables.

    Args:
        shape: of the array.
        count: number of variables.
        known: the array itself, `(*shape,)`, if it is known now.
    """
    if known is not None and prod(shape) > KNOWN_LIMIT:
        known = None
    numeric = known is not None and not jnp.issubdtype(known.dtype, jax.dtypes.extended)
    live = np.asarray(known) != 0 if numeric else np.broadcast_to(True, shape)
    return Value(live, nothing((*shape, count)), nothing((*shape, count, count)), known)


def entangled(shape: tuple[int, ...], uses: np.ndarray) -> Value:
    """Return an array of the given shape, all elements of which are nonlinear in the variables `uses`, `(m,)`."""
    return spread(make(np.array(True), uses, cross(uses, uses)), shape)


def spread(value: Value, shape: tuple[int, ...]) -> Value:
    """Say of all elements of an array of the given shape what `value` says of its only element."""
    count = value.uses.shape[-1]
    fields = (value.live, shape), (value.uses, (*shape, count)), (value.pairs, (*shape, count, count))
    return Value(*(np.broadcast_to(field, to) for field, to in fields))


def summary(value: Value) -> Value:
    """Return a value of shape () that holds for every element of the given one; its numbers are forgotten."""
    return make(np.array(True), any_element(value.uses, 1), any_element(value.pairs, 2))


def union(values: Sequence[Value]) -> Value:
    """Return what holds, element by element, for any combination of the values with independent coefficients."""
    live, uses, pairs = values[0][:3]
    for other in values[1:]:
        live, uses, pairs = live | other.live, uses | other.uses, pairs | other.pairs
    return make(live, uses, pairs)


def nonlinear(values: Sequence[Value]) -> Value:
    """Return what holds, element by element, for any function of the values."""
    both = union(values)
    return make(np.broadcast_to(True, both.live.shape), both.uses, cross(both.uses, both.uses))


def multiply(left: Value, right: Value) -> Value:
    """Return the value of the product, element by element; a factor that is zero cuts the dependence."""
    left_live, right_live = left.live[..., None], right.live[..., None]
    uses = (left.uses & right_live) | (right.uses & left_live)
    pairs = (left.pairs & right_live[..., None]) | (right.pairs & left_live[..., None]) | cross(left.uses, right.uses)
    return make(left.live & right.live, uses, pairs)


def divide(left: Value, right: Value) -> Value:
    """Return the value of the quotient, element by element."""
    return multiply(left, nonlinear([right]))


def decided(value: Value, by: np.ndarray) -> Value:
    """Return a value that is chosen, element by element, by something that depends on the variables `by`, `(..., m)`.

    For fixed values of those variables the choice is fixed, so that the result stays affine in the others, with
    coefficients that depend on the choice.
    """
    uses = value.uses | by
    return make(value.live, uses, value.pairs | cross(np.broadcast_to(by, uses.shape), uses))


def cross(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return all pairs of a variable of one set with a variable of the other, `(..., m)` to `(..., m, m)`."""
    outer = left[..., :, None] & right[..., None, :]
    return outer | np.swapaxes(outer, -1, -2)


def any_element(array: np.ndarray, keep: int) -> np.ndarray:
    """Return the union over all axes but the last `keep`; axes that only repeat (a stride of zero) are not walked."""
    lead = array.ndim - keep
    once = tuple(slice(0, 1) if stride == 0 else slice(None) for stride in array.strides[:lead])
    return np.asarray(array[once].any(axis=tuple(range(lead))))


def masked(value: Value, here: np.ndarray) -> Value:
    """Return the array with zeros put where `here`, `(*shape,)`, is False."""
    return make(value.live & here, value.uses & here[..., None], value.pairs & here[..., None, None])


def nothing(shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of the given shape that is False everywhere and takes no memory."""
    return np.broadcast_to(False, shape)


def make(live: np.ndarray, uses: np.ndarray, pairs: np.ndarray) -> Value:
    """Make a value, without holding a large array of pairs that are all absent, as they mostly are."""
    return Value(np.asarray(live), uses, pairs if any_element(pairs, 2).any() else nothing(pairs.shape))
