"""Operations over small axes of one particle's own, written out: running sums, sorting, the largest of a row, small linear algebra.

They follow LAPACK and XLA to the order of their steps: pivots are the first of the largest, sorting keeps the order of equals, a matrix
that is not positive definite has a factor of NaN.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from motes.native.rules import REALS, Named, Scalar, Scalars, Untranslatable, formula, kind_of, literal

LARGEST = 40
"""Rows of matrices and of what is sorted; beyond it a loop over particles is no better than JAX."""


class Writer:
    """Scalar operations by name: `writer("add", a, b)`.

    Args:
        named: gives a C++ expression of a type a name.
    """

    def __init__(self, named: Named):
        """Say how expressions are named."""
        self.named = named

    def __call__(self, name: str, *operands: Scalar) -> Scalar:
        """Write one operation."""
        found = formula(name, [operand.kind for operand in operands], {})
        if found is None:
            raise Untranslatable(f"the operation {name} on {operands[0].kind}")
        text, kind = found
        return self.named(kind, text.format(*(operand.text for operand in operands)))

    def select(self, test: Scalar, yes: Scalar, no: Scalar) -> Scalar:
        """Write a choice."""
        return yes if yes == no else self.named(yes.kind, f"{test.text} ? {yes.text} : {no.text}")

    def less(self, a: Scalar, b: Scalar, c: Scalar) -> Scalar:
        """Write c - a b, rounded once."""
        return self.named(c.kind, f"motes::fma(-{a.text}, {b.text}, {c.text})")

    def number(self, value: float, like: Scalar) -> Scalar:
        """Write a known number of the type of another."""
        return Scalar(literal(value, like.kind), like.kind)

    def whole(self, value: int, dtype: Any = np.int32) -> Scalar:
        """Write a known whole number."""
        kind = kind_of(dtype)
        return Scalar(literal(value, kind), kind)


def _rows(array: np.ndarray, axis: int) -> tuple[np.ndarray, Callable[[Sequence[Any]], np.ndarray]]:
    """Return an array as rows along an axis, and what puts such rows together again."""
    last = np.moveaxis(array, axis, -1)

    def together(rows: Sequence[Any]) -> np.ndarray:
        made = np.empty((len(rows), array.shape[axis]), object)
        for i, row in enumerate(rows):
            for j, element in enumerate(row):
                made[i, j] = element
        return np.moveaxis(made.reshape(last.shape), -1, axis)

    return last.reshape(-1, array.shape[axis]), together


def _running(operation: str) -> Callable[..., list[np.ndarray]]:
    def write(writer: Writer, params: dict[str, Any], operand: np.ndarray) -> list[np.ndarray]:
        rows, together = _rows(operand, params["axis"])
        made = []
        for row in rows:
            order = row[::-1] if params["reverse"] else row
            found = list(order[:1])
            for element in order[1:]:
                found.append(writer(operation, found[-1], element))
            made.append(found[::-1] if params["reverse"] else found)
        return [together(made)]

    return write


def _sorted(writer: Writer, params: dict[str, Any], *operands: np.ndarray) -> list[np.ndarray]:
    """Exchange neighbors that are out of order, which keeps the order of equals; zeros of both signs are equal, and NaN comes last."""
    if params["num_keys"] != 1:
        raise Untranslatable("sorting by several keys")
    _check_size("sorting", operands[0].shape[params["dimension"]])
    rows, togethers = zip(*(_rows(operand, params["dimension"]) for operand in operands), strict=True)
    made: list[list[Any]] = [[] for _ in operands]
    for each in zip(*rows, strict=True):
        keys = [_key(writer, element) for element in each[0]]
        columns = list(zip(keys, *each, strict=True))
        for end in range(len(columns) - 1, 0, -1):
            for i in range(end):
                columns[i], columns[i + 1] = _in_order(writer, columns[i], columns[i + 1])
        for found, column in zip(made, list(zip(*columns, strict=True))[1:], strict=True):
            found.append(column)
    return [together(found) for together, found in zip(togethers, made, strict=True)]


def _key(writer: Writer, element: Scalar) -> Scalar:
    if element.kind not in REALS:
        return element
    x = element.text
    kind = "int32_t" if element.kind == "float" else "int64_t"
    return writer.named(kind, f"motes::rank({x} == 0 ? ({element.kind})0 : ({x} != {x} ? NOT_A_NUMBER : {x}))")


def _in_order(writer: Writer, one: tuple[Scalar, ...], other: tuple[Scalar, ...]) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    wrong = writer("gt", one[0], other[0])
    pairs = [(writer.select(wrong, b, a), writer.select(wrong, a, b)) for a, b in zip(one, other, strict=True)]
    first, second = zip(*pairs, strict=True)
    return first, second


def _place_of(comparison: str) -> Callable[..., list[np.ndarray]]:
    """The place of the first of the largest, or smallest; of the first NaN where there is one."""

    def write(writer: Writer, params: dict[str, Any], operand: np.ndarray) -> list[np.ndarray]:
        (axis,), dtype = params["axes"], params["index_dtype"]
        last = np.moveaxis(operand, axis, -1)
        made = np.empty(last.shape[:-1], object)
        for index in np.ndindex(*made.shape):
            best, place = last[index][0], writer.whole(0, dtype)
            for i, element in enumerate(last[index][1:], 1):
                text = f"{element.text} {comparison} {best.text}"
                if element.kind in REALS:
                    text = f"({best.text} == {best.text}) & (({text}) | ({element.text} != {element.text}))"
                better = writer.named("bool", text)
                best, place = writer.select(better, element, best), writer.select(better, writer.whole(i, dtype), place)
            made[index] = place
        return [made]

    return write


def _check_size(what: str, size: int) -> None:
    if size > LARGEST:
        raise Untranslatable(f"{what} of {size} numbers")


def _cholesky(writer: Writer, params: dict[str, Any], operand: Scalars) -> list[np.ndarray]:
    m = operand.shape[-1]
    _check_size("a Cholesky factor", m)
    made = np.empty(operand.shape, object)
    for index in np.ndindex(*operand.shape[:-2]):
        a = operand[index]
        factor: Scalars = _filled((m, m), writer.number(0.0, a[0, 0]))
        good = Scalar("true", "bool")
        for j in range(m):
            for i in range(j, m):
                rest = a[i, j]
                for k in range(j):
                    rest = writer.less(factor[i, k], factor[j, k], rest)
                if i == j:
                    good = writer.named("bool", f"{good.text} & ({rest.text} > 0)")
                factor[i, j] = writer("sqrt", rest) if i == j else writer("div", rest, factor[j, j])
        nothing = writer.number(np.nan, a[0, 0])
        for i, j in np.ndindex(m, m):
            made[(*index, i, j)] = writer.select(good, factor[i, j], nothing) if i >= j else factor[i, j]
    return [made]


def _filled(shape: tuple[int, ...], scalar: Scalar) -> np.ndarray:
    made = np.empty(shape, object)
    for index in np.ndindex(*shape):
        made[index] = scalar
    return made


def _triangular_solve(writer: Writer, params: dict[str, Any], a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    m = a.shape[-1]
    _check_size("a linear system", m)
    transposed, lower = params["transpose_a"], params["lower"]
    if not params["left_side"]:  # x a = b is a' x' = b'
        b, transposed = np.swapaxes(b, -1, -2), not transposed
    if transposed:
        a, lower = np.swapaxes(a, -1, -2), not lower
    made = np.empty(b.shape, object)
    for index in np.ndindex(*b.shape[:-2]):
        for column in range(b.shape[-1]):
            for i in range(m) if lower else reversed(range(m)):
                rest = b[(*index, i, column)]
                for k in range(i) if lower else range(i + 1, m):
                    rest = writer.less(a[(*index, i, k)], made[(*index, k, column)], rest)
                made[(*index, i, column)] = rest if params["unit_diagonal"] else writer("div", rest, a[(*index, i, i)])
    return [made if params["left_side"] else np.swapaxes(made, -1, -2)]


def _lu(writer: Writer, params: dict[str, Any], operand: np.ndarray) -> list[np.ndarray]:
    m = operand.shape[-1]
    if operand.shape[-2] != m:
        raise Untranslatable("a triangular factor of a matrix that is not square")
    _check_size("a triangular factor", m)
    factors, pivots, orders = (np.empty(shape, object) for shape in (operand.shape, operand.shape[:-1], operand.shape[:-1]))
    for index in np.ndindex(*operand.shape[:-2]):
        rows = [[*operand[index][i], writer.whole(i)] for i in range(m)]  # the last tells where a row comes from
        for k in range(m):
            pivots[(*index, k)] = _pivoted(writer, rows, k)
            for i in range(k + 1, m):
                rows[i][k] = writer("div", rows[i][k], rows[k][k])
                for j in range(k + 1, m):
                    rows[i][j] = writer.less(rows[i][k], rows[k][j], rows[i][j])
        for i in range(m):
            orders[(*index, i)] = rows[i][m]
            for j in range(m):
                factors[(*index, i, j)] = rows[i][j]
    return [factors, pivots, orders]


def _pivoted(writer: Writer, rows: list[list[Scalar]], k: int) -> Scalar:
    """Exchange row k with the one below whose element in column k is largest, and return which that is."""
    best, place = writer("abs", rows[k][k]), writer.whole(k)
    for i in range(k + 1, len(rows)):
        size = writer("abs", rows[i][k])
        better = writer("gt", size, best)
        best, place = writer.select(better, size, best), writer.select(better, writer.whole(i), place)
    old = list(rows[k])
    for i in range(k + 1, len(rows)):
        this = writer.named("bool", f"{place.text} == {i}")
        for j in range(len(old)):
            rows[k][j], rows[i][j] = writer.select(this, rows[i][j], rows[k][j]), writer.select(this, old[j], rows[i][j])
    return place


WRITTEN_OUT: dict[str, Callable[..., list[np.ndarray]]] = {
    "cumsum": _running("add"), "cumprod": _running("mul"), "cummax": _running("max"), "cummin": _running("min"),
    "sort": _sorted, "argmax": _place_of(">"), "argmin": _place_of("<"),
    "cholesky": _cholesky, "triangular_solve": _triangular_solve, "lu": _lu,
}  # fmt: skip
"""How each operation is written, from its parameters and operands."""


def own_axes(name: str, params: dict[str, Any], place: int, rank: int) -> Sequence[int]:
    """Return the axes over which an operation works, in its operand of a place and a number of axes: no axis of particles may be there."""
    if name == "triangular_solve" and place == 1:
        return [rank - 2 if params["left_side"] else rank - 1]
    if name in ("cholesky", "triangular_solve", "lu"):
        return [rank - 2, rank - 1]
    return [params["dimension"]] if name == "sort" else params.get("axes", [params.get("axis")])
