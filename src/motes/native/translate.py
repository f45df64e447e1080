"""From a traced program over a cloud to a program for one particle, written in C++.

The program is traced for a single particle, so that every array is small, and flattened to scalars. What does not depend on the particle
is left to JAX, which works it out once and hands it over as parameters. That each particle is worked on alone is proved on a second trace,
with a number of particles that no other size can be mistaken for (`lanes.py`).
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from motes.core import random
from motes.native import keys
from motes.native.parts import needed
from motes.native.rules import LONG, MOVES, REALS, REDUCTIONS, Scalar, Untranslatable, formula, kind_of, literal, located
from motes.native.shared import LeftToJax, by_jax, plain
from motes.native.tables import LookUp
from motes.native.written_out import WRITTEN_OUT, Writer
from motes.native.zeros import SMALL, is_zero, simpler
from motes.tracing.internals import Branches, Scan, Solve, called, control, has_own_mapping, jitted_name
from motes.tracing.program import walk

MOST_STATEMENTS = 6_000
"""Longer programs take compilers minutes."""

BLOCKS = {random.NORMAL: "normals", random.UNIFORM: "uniforms"}
"""Names of the jitted functions that draw random numbers for all particles."""


def block_of(eqn: Any) -> str | None:
    """Return which random numbers an operation draws, or None."""
    return BLOCKS.get(jitted_name(eqn))


class Translator:
    """Rules that collect the C++ statements of what depends on the particle (see `tracing/program.py`).

    Values are JAX arrays (the same for all particles) or arrays of `Scalar`.

    Attributes:
        real: type of the particles' numbers in C++.
        statements: C++, in order.
        parameters: values that JAX works out, `()` or of any shape, in the order in which the kernel gets them.
        tables: arrays that all particles share and each looks up at places of its own, likewise.
        draws: C++ calls that fill the rows of random numbers.
        rows: number of rows of random numbers.
    """

    def __init__(self, real: str) -> None:
        """Start with nothing but the type of the particles' numbers."""
        self.real = real
        self.statements: list[str] = []
        self.parameters: list[Any] = []
        self.tables: list[jax.Array] = []
        self.draws: list[str] = []
        self.rows = 0
        self._slots: dict[int, np.ndarray] = {}
        self._named_tables: dict[int, str] = {}
        self._kept: list[Any] = []
        self._names: dict[tuple[str, str], Scalar] = {}
        self._factors: dict[str, Sequence[Scalar]] = {}
        self._shared = LeftToJax()

    def inputs(self, first: int, shape: tuple[int, ...]) -> np.ndarray:
        """Name the inputs of one particle, from row `first` on."""
        return _array([Scalar(f"x{first + i}", self.real) for i in range(int(np.prod(shape, dtype=int)))], shape)

    def needed(self, ends: Sequence[str]) -> list[str]:
        """Return the statements that some last ones need."""
        kept = needed(self.statements, ends)
        if len(kept) > MOST_STATEMENTS:
            raise Untranslatable(f"more than {MOST_STATEMENTS} scalar operations")
        return kept

    def declarations(self) -> list[str]:
        """C++ that gives the parameters their names and types."""
        kinds = [kind for value in self.parameters for kind in [kind_of(value.dtype)] * int(np.size(value))]
        made, at = [], 0
        for i, kind in enumerate(kinds):
            words = 2 if kind in LONG else 1
            bits = f"P[{at}] | (uint64_t)P[{at + 1}] << 32" if words == 2 else f"P[{at}]"
            made.append(f"const {kind} p{i} = " + (f"P[{at}] != 0;" if kind == "bool" else f"bits<{kind}>({bits});"))
            at += words
        return made

    def pointers(self) -> list[str]:
        """C++ that gives the tables their names and types."""
        kinds = [kind_of(table.dtype) for table in self.tables]
        return [f"const {kind}* __restrict t{i} = (const {kind}*)rows.tables[{i}];" for i, kind in enumerate(kinds)]

    def words(self) -> jax.Array:
        """Return the parameters as 32-bit words, `(p,)`."""
        parts = [jnp.zeros((1,), jnp.uint32)] if not self.parameters else []
        for value in self.parameters:
            flat = jnp.ravel(jnp.asarray(value))
            whole = flat.astype(jnp.uint32) if flat.dtype == bool else jax.lax.bitcast_convert_type(flat, jnp.uint32)
            parts.append(jnp.ravel(whole))  # a number of 64 bits is two words, the lower first
        return jnp.concatenate(parts)

    def literal(self, atom: Any) -> Any:
        """Return a number in an equation."""
        return np.asarray(atom.val, atom.aval.dtype)

    def constant(self, variable: Any, value: Any) -> Any:
        """Return an array that the program holds."""
        return value if isinstance(value, Tracer) or value.size > SMALL else plain(value)

    @located
    def step(self, eqn: Any, operands: list[Any]) -> Sequence[Any]:
        """Translate an equation."""
        results = self._equation(eqn, operands)
        if len(self.statements) > 2 * MOST_STATEMENTS:  # half of them, such as a second triangle, may not be needed
            raise Untranslatable(f"more than {MOST_STATEMENTS} scalar operations")
        return results

    def _equation(self, eqn: Any, operands: list[Any]) -> Sequence[Any]:
        block = block_of(eqn)
        if block:
            return [self._draw(block, operands[0], eqn.outvars[0].aval)]
        shared = not any(is_lane(value) for value in operands)
        if called(eqn) is not None and not (shared and has_own_mapping(eqn)):
            return walk(called(eqn), operands, self)
        if shared and eqn.primitive.name == keys.NUMBERED and eqn.params["shape"] == (1,):
            return [_array([keys.numbered(self._named, self.scalars(jax.random.key_data(operands[0])))], (1,))]
        if shared:
            return self._shared(eqn, operands)
        parts = control(eqn, operands)
        return self._plain(eqn, operands) if parts is None else self._controlled(eqn.primitive.name, parts)

    def _controlled(self, name: str, parts: Any) -> Sequence[Any]:
        if isinstance(parts, Branches):
            return self._branches(parts)
        if isinstance(parts, Scan):
            return self._unrolled(parts)
        if isinstance(parts, Solve):
            return walk(parts.program, parts.operands, self)
        raise Untranslatable(f"the operation {name}: how often it turns is not known beforehand")

    def _plain(self, eqn: Any, operands: list[Any]) -> Sequence[Any]:
        name = eqn.primitive.name
        if name == "optimization_barrier":
            return operands
        if name == "gather" and is_lane(operands[1]):
            look_up = LookUp(eqn, operands[0] if is_lane(operands[0]) else self._table(operands[0]), self._named)
            return [look_up.at(operands[1], eqn.outvars[0].aval.shape)]
        if name in keys.DRAWN:
            return [keys.DRAWN[name](self._named, eqn.params, *map(self.scalars, operands))]
        if name in WRITTEN_OUT:
            return WRITTEN_OUT[name](Writer(self._named), eqn.params, *map(self.scalars, operands))
        if name in MOVES:
            return self._moved(eqn, operands)
        if name in REDUCTIONS:
            return [self._reduced(REDUCTIONS[name], self.scalars(operands[0]), eqn.params["axes"])]
        if name == "dot_general":
            a, b = (self._converted(value, kind_of(eqn.outvars[0].aval.dtype)) for value in operands)
            return [self._product(a, b, eqn.params["dimension_numbers"])]
        return [self._elementwise(name, [self.scalars(value) for value in operands], eqn.params)]

    def scalars(self, value: Any) -> np.ndarray:
        """Return a value as an array of scalars; what JAX works out becomes parameters."""
        if is_lane(value):
            return value
        if isinstance(value, np.ndarray) and (value.size <= 64 or value.dtype == bool):
            kind = kind_of(value.dtype)
            return _array([Scalar(literal(v, kind), kind) for v in value.reshape(-1)], value.shape)
        if id(value) not in self._slots:
            kind = kind_of(value.dtype)
            first = sum(int(np.size(p)) for p in self.parameters)
            self.parameters.append(value)
            self._kept.append(value)  # an id is only good as long as its object lives
            slots = [Scalar(f"p{first + i}", kind) for i in range(int(np.size(value)))]
            live = self._shared.live(value)
            if live is not None:
                slots = [slot if lives else Scalar(literal(0, kind), kind) for slot, lives in zip(slots, live.flat, strict=True)]
            self._slots[id(value)] = _array(slots, np.shape(value))
        return self._slots[id(value)]

    def _named(self, kind: str, text: str) -> Scalar:
        """Name an expression; the same expression has one name."""
        if (kind, text) not in self._names:
            name = f"v{len(self.statements) + 1}"
            self.statements.append(f"const {kind} {name} = {text};")
            self._names[kind, text] = Scalar(name, kind)
        return self._names[kind, text]

    def _elementwise(self, name: str, operands: list[np.ndarray], params: dict[str, Any]) -> np.ndarray:
        try:
            wide = np.broadcast_arrays(*operands)
        except ValueError:  # it is none of elements with their like
            raise Untranslatable(f"the operation {name}") from None
        if not wide[0].size:
            return wide[0]
        if name == "select_n" and wide[1].flat[0].kind == keys.KIND:
            return keys.selected(self._named, *wide)
        found = formula(name, [operand.flat[0].kind for operand in operands], params)
        if found is None:
            raise Untranslatable(f"the operation {name}")
        return _array([self._operation(name, each, *found) for each in zip(*(array.flat for array in wide), strict=True)], wide[0].shape)

    def _operation(self, name: str, operands: Sequence[Scalar], text: str, kind: str) -> Scalar:
        found = simpler(name, operands)
        if isinstance(found, Scalar):
            return found
        if found is None and kind in REALS:
            found = self._rounded_once(name, operands)
        made = self._named(kind, text.format(*(one.text for one in operands)) if found is None else found)
        if name == "mul" and kind in REALS:
            self._factors[made.text] = operands
        return made

    def _rounded_once(self, name: str, operands: Sequence[Scalar]) -> str | None:
        """Fuse the sum of a product and a number, as XLA does; factors stand in one order, so that equal sums of products have one name."""
        if name == "mul":
            return " * ".join(sorted(operand.text for operand in operands))
        if name not in ("add", "add_any", "sub"):
            return None
        a, b = (operand.text for operand in operands)
        minus = "-" if name == "sub" else ""
        for product, rest, sign in ((b, a, minus), (a, minus + b, "")):
            if product in self._factors:
                x, y = sorted(factor.text for factor in self._factors[product])
                return f"motes::fma({sign}{x}, {y}, {rest})"
        return None

    def _moved(self, eqn: Any, operands: list[Any]) -> list[np.ndarray]:
        """Find where each element goes by moving their numbers instead."""
        says_where = MOVES[eqn.primitive.name]
        elements: list[Scalar] = []
        numbers: list[Any] = []
        for i, value in enumerate(operands):
            if says_where(i):
                if is_lane(value):
                    raise Untranslatable(f"the operation {eqn.primitive.name} at places that depend on the particle")
                if isinstance(value, Tracer):
                    raise Untranslatable(f"the operation {eqn.primitive.name} at places that are not known beforehand")
                numbers.append(value)
                continue
            own = self.scalars(value)
            numbers.append(np.arange(len(elements), len(elements) + own.size, dtype=np.int32).reshape(own.shape))
            elements += list(own.flat)
        moved = by_jax(eqn, numbers)
        return [_array([elements[j] for j in np.asarray(m).flat], np.shape(m)) for m in moved]

    def _reduced(self, name: str, operand: np.ndarray, axes: Sequence[int]) -> np.ndarray:
        rest = [a for a in range(operand.ndim) if a not in axes]
        count = int(np.prod([operand.shape[a] for a in axes], dtype=int))
        if not count:
            raise Untranslatable("a reduction of nothing")
        parts = operand.transpose([*axes, *rest]).reshape(count, *(operand.shape[a] for a in rest))
        total = parts[0]
        for part in parts[1:]:
            total = self._elementwise(name, [total, part], {})
        return total

    def _product(self, a: np.ndarray, b: np.ndarray, dimensions: Any) -> np.ndarray:
        (a_sum, b_sum), (a_same, b_same) = dimensions
        a_rest = [i for i in range(a.ndim) if i not in (*a_sum, *a_same)]
        b_rest = [i for i in range(b.ndim) if i not in (*b_sum, *b_same)]
        same, rows, columns = [a.shape[i] for i in a_same], [a.shape[i] for i in a_rest], [b.shape[i] for i in b_rest]
        sizes = [int(np.prod(group, dtype=int)) for group in (same, rows, columns, [a.shape[i] for i in a_sum])]
        left = a.transpose([*a_same, *a_rest, *a_sum]).reshape(sizes[0], sizes[1], sizes[3])
        right = b.transpose([*b_same, *b_rest, *b_sum]).reshape(sizes[0], sizes[2], sizes[3])
        results = [self._inner_product(x, y) for g in range(sizes[0]) for x in left[g] for y in right[g]]
        return _array(results, (*same, *rows, *columns))

    def _converted(self, value: Any, kind: str) -> np.ndarray:
        """Return scalars of a type; a product may be of two precisions."""
        scalars = self.scalars(value)
        if not scalars.size or scalars.flat[0].kind == kind:
            return scalars
        return _array([Scalar(f"({kind}){scalar.text}", kind) for scalar in scalars.flat], scalars.shape)

    def _inner_product(self, x: np.ndarray, y: np.ndarray) -> Scalar:
        kind = x[0].kind if len(x) else self.real
        if kind not in REALS:
            raise Untranslatable("a matrix product of whole numbers")
        terms = [(one, other) for one, other in zip(x, y, strict=True) if not (is_zero(one) or is_zero(other))]
        if not terms:
            return Scalar(literal(0, kind), kind)
        products = [self._operation("mul", term, "", kind) for term in terms]
        total = products[0]
        for product in products[1:]:
            total = self._operation("add", (total, product), "{0} + {1}", kind)
        return total

    def _branches(self, parts: Branches) -> list[np.ndarray]:
        """Work out every branch and select."""
        branches = [walk(branch, parts.operands, self) for branch in parts.programs]
        which = self.scalars(parts.index)
        return [self._elementwise("select_n", [which, *map(self.scalars, cases)], {}) for cases in zip(*branches, strict=True)]

    def _unrolled(self, loop: Scan) -> list[Any]:
        """Write a loop out: its length is known."""
        if not 0 < loop.length <= MOST_STATEMENTS:
            raise Untranslatable(f"a loop of {loop.length} turns")
        carry, made = list(loop.carry), []
        order = range(loop.length)
        for k in reversed(order) if loop.reverse else order:
            results = walk(loop.body, [*loop.consts, *carry, *(rows[k] for rows in loop.rows)], self)
            carry = results[: len(carry)]
            made.append(results[len(carry) :])
        steps = made[::-1] if loop.reverse else made
        return [*carry, *(self._stacked(values) for values in zip(*steps, strict=True))]

    def _stacked(self, values: Sequence[Any]) -> Any:
        if not any(is_lane(value) for value in values):
            return jnp.stack([jnp.asarray(value) for value in values])
        return np.stack([self.scalars(value) for value in values])

    def _table(self, value: Any) -> str:
        """Hand a table over, once; return its name."""
        if id(value) not in self._named_tables:
            self._named_tables[id(value)] = f"t{len(self.tables)}"
            self._kept.append(value)
            words = jnp.asarray(value)
            self.tables.append(words.astype(jnp.int32) if words.dtype == bool else words)
        return self._named_tables[id(value)]

    def _draw(self, block: str, key: Any, drawn: Any) -> np.ndarray:
        if is_lane(key):
            raise Untranslatable("random numbers with a key of each particle's own")
        if kind_of(drawn.dtype) != self.real:
            raise Untranslatable(f"random numbers of type {drawn.dtype} for particles of another")
        first, second = self.scalars(key).flat
        rows = int(np.prod(drawn.shape[:-1], dtype=int))
        self.draws.append(f"{block}(Key{{{first.text}, {second.text}}}, begin, {rows}, noise + {self.rows});")
        scalars = [Scalar(f"noise[{self.rows + r}][i]", self.real) for r in range(rows)]
        self.rows += rows
        return _array(scalars, drawn.shape)


def is_lane(value: Any) -> bool:
    """Tell whether a value is an array of scalars of one particle."""
    return isinstance(value, np.ndarray) and value.dtype == object


def _array(elements: list[Scalar], shape: Sequence[int]) -> np.ndarray:
    made = np.empty(len(elements), object)
    for i, element in enumerate(elements):
        made[i] = element
    return made.reshape(tuple(shape))


def traced(function: Callable[..., Any], leaves: Sequence[Any], n: int) -> Any:
    """Trace a function of arrays `(..., n)` for another number of particles."""
    return jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct((*leaf.shape[:-1], n), leaf.dtype) for leaf in leaves))
