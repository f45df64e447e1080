"""Trees of many arrays as few: to hand them from program to program, or to write them at each step, takes time by the array."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


class Packed:
    """A tree whose numbers of one type stand in one array.

    Attributes:
        arrays: those that are no numbers as they are; numbers of one type together, `(k,)`; of many steps with the time axis first.
        form: for each of the arrays the places of its parts among the leaves, and the structure of the tree.
    """

    __slots__ = ("arrays", "form")

    def __init__(self, arrays: tuple[Any, ...], form: Any):
        """Take arrays and form; see `of`."""
        self.arrays, self.form = arrays, form

    @classmethod
    def of(cls, tree: Any, together: bool = True) -> "Packed":
        """Pack a tree; with `together` off it is only taken apart, so that its numbers come out of a program as they would without."""
        leaves, structure = jax.tree.flatten(tree)
        leaves = [jnp.asarray(leaf) for leaf in leaves]
        groups: dict[Any, list[int]] = {}
        for place, leaf in enumerate(leaves):
            groups.setdefault(leaf.dtype if together and leaf.ndim == 0 else place, []).append(place)
        arrays = tuple(leaves[own[0]] if len(own) == 1 else jnp.stack([leaves[place] for place in own]) for own in groups.values())
        return cls(arrays, (tuple(map(tuple, groups.values())), structure))

    def whole(self) -> Any:
        """Return the tree; of many steps with the time axis first. Outside of programs numbers that were together are NumPy's."""
        places, structure = self.form
        leaves: list[Any] = [None] * structure.num_leaves
        for array, own in zip(self.arrays, places, strict=True):
            if len(own) == 1:
                leaves[own[0]] = array
                continue
            numbers = array if isinstance(array, Tracer) else np.asarray(array)
            for k, place in enumerate(own):
                leaves[place] = numbers[..., k]
        return jax.tree.unflatten(structure, leaves)


jax.tree_util.register_pytree_node(Packed, lambda packed: (packed.arrays, packed.form), lambda form, arrays: Packed(tuple(arrays), form))
