"""Tables looked up by the particle: arrays that all share, such as a map, or of its own, read at places that each works out for itself."""

import itertools
import math
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from motes.native.rules import Named, Scalar, Untranslatable, kind_of, literal

LARGEST = 1 << 31
"""Elements of a table: places are 32-bit numbers."""

MOST_CHOICES = 64
"""Places at which a particle's own array is read, each of which is looked at."""


class LookUp:
    """A look-up as C++: for every place, the statements that find it and the elements there.

    Args:
        equation: a gather.
        table: name of the elements in C++ of a table that all share, or scalars of the particle's own.
        named: gives a formula of a type a name.
    """

    def __init__(self, equation: Any, table: str | np.ndarray, named: Named):
        """Refuse what is too large."""
        params, shape = equation.params, equation.invars[0].aval.shape
        self._numbers, self._sizes = params["dimension_numbers"], params["slice_sizes"]
        if int(np.prod(shape, dtype=np.int64)) >= LARGEST:
            raise Untranslatable(f"a table of {LARGEST} elements or more")
        self._table, self._shape = table if isinstance(table, str) else list(table.flat), shape
        self._named = lambda kind, text: named(kind, text).text
        self._kind = kind_of(equation.invars[0].aval.dtype)
        self._strides = [int(np.prod(shape[d + 1 :], dtype=np.int64)) for d in range(len(shape))]
        self._begins = () if isinstance(table, str) else self._choices()
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
        gone = (*self._numbers.collapsed_slice_dims, *self._numbers.operand_batching_dims)
        windows = [d for d in range(len(self._shape)) if d not in gone]
        for index in np.ndindex(*places.shape[:-1]):
            own = zip(self._numbers.operand_batching_dims, self._numbers.start_indices_batching_dims, strict=True)
            base = sum(index[axis] * self._strides[d] for d, axis in own)
            first, inside = self._begin(list(places[index]), base)
            for within in np.ndindex(*(self._sizes[d] for d in windows)):
                offset = sum(step * self._strides[d] for step, d in zip(within, windows, strict=True))
                text = self._element(first, base, offset)
                where = np.empty(len(shape), int)
                where[around], where[list(self._numbers.offset_dims)] = index, within
                text = text if self._fill is None else f"{inside} ? {text} : {self._fill}"
                found[tuple(where)] = Scalar(self._named(self._kind, text), self._kind)
        return found

    def _element(self, first: str, base: int, offset: int) -> str:
        """Return the element at an offset from where a window begins."""
        if isinstance(self._table, str):
            text = f"{self._table}[{first} + {offset}]"
            return text if self._kind != "bool" else f"{text} != 0"
        begins = [base + begin for begin in self._begins]
        chosen = [self._table[begin + offset].text for begin in begins]
        found = chosen[-1]
        for begin, text in reversed(list(zip(begins[:-1], chosen, strict=False))):
            found = self._named(self._kind, f"{first} == {begin} ? {text} : {found}")
        return found

    def _choices(self) -> list[int]:
        """Return where a window into the particle's own array may begin, beside the place of its batch."""
        counts = {d: self._shape[d] - self._sizes[d] + 1 for d in self._numbers.start_index_map}
        if math.prod(counts.values()) > MOST_CHOICES:
            raise Untranslatable(f"more than {MOST_CHOICES} places of a particle's own array to choose from")
        starts = ([place * self._strides[d] for place in range(count)] for d, count in counts.items())
        return [sum(each) for each in itertools.product(*starts)]

    def _begin(self, place: list[Scalar], base: int) -> tuple[str, str]:
        """Name the element where a window begins, kept inside the table, and whether it was inside before."""
        terms, tests = [str(base)], ["true"]
        for scalar, d in zip(place, self._numbers.start_index_map, strict=True):
            last = self._shape[d] - self._sizes[d]
            below = f"{scalar.text} < 0 ? 0 : " if scalar.kind.startswith("int") else ""
            kept = self._named("int32_t", f"(int32_t)({below}{scalar.text} > {last} ? {last} : {scalar.text})")
            terms.append(f"{kept} * {self._strides[d]}")
            tests.append(f"{scalar.text} == ({scalar.kind}){kept}")
        inside = "" if self._fill is None else self._named("bool", " & ".join(f"({test})" for test in tests))
        return self._named("int32_t", " + ".join(terms)), inside
