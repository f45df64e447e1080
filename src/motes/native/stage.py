"""A stage of a filter as one native kernel: the traced functions of the model, fused with random numbers, gathering and weighing."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motes.native import lanes
from motes.native.compile import begun, call_on_particles
from motes.native.parts import WORDS, in_parts
from motes.native.rules import REALS, Untranslatable, kind_of
from motes.native.translate import Translator, is_lane, traced
from motes.tracing.program import walk

Function = Callable[..., Any]
Shared = tuple[jax.Array, Sequence[jax.Array]]
"""Words and tables of a stage."""


class Stage(NamedTuple):
    """A translated stage, ready to be called on the arrays of a cloud.

    Attributes:
        kind: "move" or "weigh", the name of its kernel.
        source: C++.
        words: numbers that all particles share, `(p,)`, as 32-bit words.
        tables: arrays that all particles share, and each reads at places of its own.
        changed: for each array with the particle axis, whether the kernel works it out; it is left as it was otherwise.
        rest: what the stage returns without the particle axis, worked out by JAX.
        size: number of scalar operations.
    """

    kind: str
    source: str
    words: jax.Array
    tables: list[jax.Array]
    changed: list[bool]
    rest: list[Any]
    size: int

    @property
    def shared(self) -> Shared:
        """What all particles share."""
        return self.words, self.tables


def movement(function: Function, leaves: Sequence[jax.Array], resampled: bool = True) -> Stage:
    """Translate a function of the arrays of a cloud that returns the same arrays, moved.

    Args:
        function: gives the arrays.
        leaves: the arrays.
        resampled: whether the particles may have ancestors other than themselves.

    Raises:
        Untranslatable: it cannot be; the text says why.
        CompileError: there is no compiler, or it failed.
    """
    translator, outputs = _translated(function, leaves)
    return _compiled("move", translator, leaves, outputs, [], "ancestors[i]" if resampled else "first + i")


def judgement(function: Function, leaves: Sequence[jax.Array]) -> Stage:
    """Translate a function of the arrays of a cloud that returns a log likelihood `(n,)`, its maximum and the arrays, corrected.

    Raises:
        Untranslatable: it cannot be; the text says why.
        CompileError: there is no compiler, or it failed.
    """
    translator, (likelihood, max_log_likelihood, *outputs) = _translated(function, leaves)
    weighing = [translator.scalars(value).reshape(-1)[0] for value in (likelihood, max_log_likelihood)]
    return _compiled("weigh", translator, leaves, outputs, weighing, "first + i")


def _translated(function: Function, leaves: Sequence[jax.Array]) -> tuple[Translator, list[Any]]:
    real = kind_of(leaves[0].dtype)
    for leaf in leaves:
        if kind_of(leaf.dtype) != real or real not in REALS:
            raise Untranslatable(f"particles of type {leaf.dtype}")
    lanes.check(traced(function, leaves, lanes.COUNT))
    single = traced(function, leaves, 1)
    translator = Translator(real)
    first = 0
    inputs = []
    for leaf in leaves:
        inputs.append(translator.inputs(first, (*leaf.shape[:-1], 1)))
        first += inputs[-1].size
    return translator, walk(single, inputs, translator)


def _compiled(
    kind: str, translator: Translator, leaves: Sequence[jax.Array], outputs: Sequence[Any], weighing: Sequence[Any], place: str
) -> Stage:
    """Write, compile and register the kernel; `place` is that of a particle in the arrays, as C++."""
    rest = [jnp.asarray(value) for value in outputs[len(leaves) :] if not is_lane(value)]
    if len(rest) != len(outputs) - len(leaves):
        raise Untranslatable("a value for all particles that depends on one")
    changed: list[bool] = []
    assignments: list[str] = []
    shapes: list[tuple[int, int]] = []
    first = row = 0
    for leaf, output in zip(leaves, outputs, strict=False):
        count = _rows(leaf)
        scalars = translator.scalars(output).reshape(-1)
        changed.append([scalar.text for scalar in scalars] != [f"x{first + i}" for i in range(count)])
        first += count
        if changed[-1]:
            shapes.append((count, leaf.ndim))
            assignments += [f"y{row + i}[i] = {scalar.text};" for i, scalar in enumerate(scalars)]
            row += count
    if weighing:
        assignments += [f"{name}[i] = {scalar.text};" for name, scalar in zip(("likelihood", "maximum"), weighing, strict=True)]
    elif not shapes:
        raise Untranslatable("dynamics that move nothing")
    statements = translator.needed(assignments)
    inputs = [(_rows(leaf), leaf.ndim) for leaf in leaves]
    loads = [f"const {translator.real} x{j} = r{j}[{place}];" for j in range(sum(rows for rows, _ in inputs))]
    source = _source(kind, translator, [*loads, *statements], inputs, shapes, assignments)
    begun(source)
    return Stage(kind, source, translator.words(), translator.tables, changed, rest, len(statements))


def _rows(leaf: Any) -> int:
    return int(np.prod(leaf.shape[:-1], dtype=int))


def _source(
    kind: str,
    translator: Translator,
    statements: list[str],
    leaves: list[tuple[int, int]],
    outs: list[tuple[int, int]],
    assignments: list[str],
) -> str:
    """Put the C++ together; `cpp/stage.hpp` says what each name is for."""
    count, made = sum(rows for rows, _ in leaves), sum(rows for rows, _ in outs)
    real = translator.real
    given = [f"const {real}* __restrict r{j} = rows.in[{j}];" for j in range(count)]
    given += [f"{real}* __restrict y{j} = rows.out[{j}] + first;" for j in range(made)]
    given += [*translator.declarations(), *translator.pointers()]
    parts = in_parts(statements, assignments)
    bodies = "".join(
        f"""
  static __attribute__((noinline)) void part{k}(MOTES_LANES, Kept& kept) {{
    {_lines(_used(given, body), 4)}
#pragma omp simd
    for (int i = 0; i < m; i++) {{
      {_lines(body, 6)}
    }}
  }}"""
        for k, body in enumerate(parts.bodies)
    )
    lists = {"ROWS": [rows for rows, _ in leaves], "OUT_ROWS": [rows for rows, _ in outs], "OUT_RANKS": [rank for _, rank in outs],
             "TABLE_BYTES": [table.dtype.itemsize for table in translator.tables]}  # fmt: skip
    arrays = [f"static constexpr int {name}[] = {{{', '.join(map(str, [*values, 0]))}}};" for name, values in lists.items()]
    return f"""#define MOTES_REAL {real}
#include "stage.hpp"
using namespace motes;
struct Model {{
  static constexpr int LEAVES = {len(leaves)}, OUTS = {len(outs)}, IN_ROWS = {count}, OUT_ROWS_ALL = {made};
  static constexpr int NOISE = {translator.rows}, TABLES = {len(translator.tables)};
  {_lines(arrays, 2)}
  static void draw(const uint32_t* P, uint32_t begin, Real (*noise)[BLOCK]) {{
    {_lines([*_used(translator.declarations(), translator.draws), *translator.draws], 4)}
  }}
  struct Kept {{
    {_lines(parts.kept, 4)}
  }};{bodies}
  static void lanes(MOTES_LANES) {{
    Kept kept;
    for (int at = 0; at < m; at += {parts.lanes}) {{
      {_lines([f"part{k}(MOTES_PIECE({parts.lanes}), kept);" for k in range(len(parts.bodies))], 6)}
    }}
  }}
}};
static void run(const Frame& frame, const Team& team) {{ motes::{kind}<Model>(frame, team); }}
MOTES_KERNEL({kind}, run)
"""


def _lines(lines: Sequence[str], indented: int) -> str:
    return ("\n" + " " * indented).join(lines)


def _used(declarations: Sequence[str], body: Sequence[str]) -> list[str]:
    """Return the declarations of names that are used."""
    words = set(WORDS.findall(" ".join(body)))
    return [line for line in declarations if WORDS.findall(line.split("=")[0])[-1] in words]


def call_move(stage: Stage, shared: Shared, ancestors: jax.Array, leaves: Sequence[jax.Array]) -> list[jax.Array]:
    """Return the arrays of the chosen ancestors, moved."""
    many = ancestors.shape[0]
    made = [jax.ShapeDtypeStruct((*leaf.shape[:-1], many), leaf.dtype)
            for leaf, changed in zip(leaves, stage.changed, strict=True) if changed]  # fmt: skip
    words, tables = shared
    results = list(_call(stage, made, tables, words, ancestors, *leaves))
    return [results.pop(0) if changed else leaf[..., ancestors] for leaf, changed in zip(leaves, stage.changed, strict=True)]


def call_weigh(
    stage: Stage, shared: Shared, log_weights: jax.Array, leaves: Sequence[jax.Array]
) -> tuple[jax.Array, jax.Array, list[jax.Array]]:
    """Return normalized log weights `(n,)`, the judgement `(6,)` (see `logspace.joint_weights`) and the arrays, corrected."""
    made = [leaf for leaf, changed in zip(leaves, stage.changed, strict=True) if changed]
    six = jax.ShapeDtypeStruct((6,), log_weights.dtype)
    words, tables = shared
    weights, found, *results = _call(stage, [log_weights, six, *made], tables, words, log_weights, *leaves)
    return weights, found, [results.pop(0) if changed else leaf for leaf, changed in zip(leaves, stage.changed, strict=True)]


def _call(stage: Stage, results: Sequence[Any], tables: Sequence[jax.Array], *operands: jax.Array) -> Sequence[jax.Array]:
    shapes = [jax.ShapeDtypeStruct(result.shape, result.dtype) for result in results]
    # all but the words, and the judgement
    of_particles = ([False, *[True] * (len(operands) - 1)], [shape.shape != (6,) for shape in shapes])
    return call_on_particles(stage.source, stage.kind, shapes, [*operands, *tables], of_particles)
