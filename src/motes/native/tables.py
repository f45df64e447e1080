"""Tables looked up by the particle: arrays that all particles share, such as a map, read at places that each works out for itself."""

from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from motes.native.rules import Scalar, Untranslatable, kind_of, literal

LARGEST = 1 << 31
"""Elements of a table: places are 32-bit numbers."""


class LookUp:
    """A look-up as C++: for every place, the statements that find it and the elements there.

    Args:
        equation: a gather whose first operand all particles share.
        table: name of the table's elements in C++.
        named: gives a formula of a type a name.
    """

    def __init__(self, equation: Any, table: str, named: Any):
        """Refuse what is not one table for all."""
        params, shape = equation.params, equation.invars[0].aval.shape
        self._numbers, self._sizes = params["dimension_numbers"], params["slice_sizes"]
        if self._numbers.operand_batching_dims:
            raise Untranslatable("a table of each particle's own")
        if int(np.prod(shape, dtype=np.int64)) >= LARGEST:
            raise Untranslatable(f"a table of {LARGEST} elements or more")
        self._table, self._named, self._shape = table, named, shape
        self._kind = kind_of(equation.invars[0].aval.dtype)
        self._strides = [int(np.prod(shape[d + 1 :], dtype=np.int64)) for d in range(len(shape))]
        fills = GatherScatterMode.from_any(params["mode"]) == GatherScatterMode.FILL_OR_DROP
        self._fill = self._filling(params["fill_value"], equation.invars[0].aval.dtype) if fills else None

    def _filling(self, given: Any, dtype: Any) -> str:
        """What is read beyond the table, as JAX has it."""
        kind = np.dtype(dtype)
        usual = np.nan if kind.kind == "f" else kind.kind == "b" or (np.iinfo(kind).min if kind.kind == "i" else np.iinfo(kind).max)
        return literal(usual if given is None else given, self._kind)

    def at(self, places: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Return the elements at places `(..., index)`, as an array of scalars of the shape of the result."""
        found = np.empty(shape, object)
        around = [axis for axis in range(len(shape)) if axis not in self._numbers.offset_dims]
        windows = [d for d in range(len(self._shape)) if d not in self._numbers.collapsed_slice_dims]
        for index in np.ndindex(*places.shape[:-1]):
            first, inside = self._begin(list(places[index]))
            for within in np.ndindex(*(self._sizes[d] for d in windows)):
                offset = sum(step * self._strides[d] for step, d in zip(within, windows, strict=True))
                text = f"{self._table}[{first} + {offset}]"
                text = text if self._kind != "bool" else f"{text} != 0"
                where = np.empty(len(shape), int)
                where[around], where[list(self._numbers.offset_dims)] = index, within
                text = text if self._fill is None else f"{inside} ? {text} : {self._fill}"
                found[tuple(where)] = Scalar(self._named(self._kind, text), self._kind)
        return found

    def _begin(self, place: list[Scalar]) -> tuple[str, str]:
        """Name the element where a window begins, kept inside the table, and whether it was inside before."""
        terms, tests = ["0"], ["true"]
        for scalar, d in zip(place, self._numbers.start_index_map, strict=True):
            last = self._shape[d] - self._sizes[d]
            below = f"{scalar.text} < 0 ? 0 : " if scalar.kind == "int32_t" else ""
            kept = self._named("int32_t", f"(int32_t)({below}{scalar.text} > {last} ? {last} : {scalar.text})")
            terms.append(f"{kept} * {self._strides[d]}")
            tests.append(f"(int32_t){scalar.text} == {kept}")
        inside = "" if self._fill is None else self._named("bool", " & ".join(f"({test})" for test in tests))
        return self._named("int32_t", " + ".join(terms)), inside
