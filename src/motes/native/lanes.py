"""The proof that a program over a cloud works on each particle alone: every array has the particle axis once or not at all, throughout.

It is a proof for the operations that `translate.py` knows; it refuses all others, such as sorting or running sums, by itself.
"""

import math
from typing import Any

from motes.native.keys import NUMBERED
from motes.native.rules import MOVES, Untranslatable, located
from motes.native.translate import block_of
from motes.native.written_out import WRITTEN_OUT, own_axes
from motes.tracing.internals import Branches, Scan, Solve, called, control, has_own_mapping, without_constants
from motes.tracing.program import walk

COUNT = 99_991
"""A prime number of particles that no other axis has, nor a product of axes."""


def check(program: Any) -> None:
    """Refuse a program traced for `COUNT` particles in which particles meet.

    Raises:
        Untranslatable: the text names the operation.
    """
    walk(program, [_axes(variable) for variable in without_constants(program)[0].invars], _Apart())


class _Apart:
    """Rules by which the places of the particle axis stand for each array."""

    def literal(self, atom: Any) -> list[int]:
        return _axes(atom)

    def constant(self, variable: Any, value: Any) -> list[int]:
        return _axes(variable)

    @located
    def step(self, eqn: Any, before: list[list[int]]) -> list[list[int]]:
        after = [_axes(variable) for variable in eqn.outvars]
        if block_of(eqn):
            if after != [[len(eqn.outvars[0].aval.shape) - 1]]:
                _refuse("random numbers")
        elif called(eqn) is not None:
            walk(called(eqn), before, self)
            if has_own_mapping(eqn) and any(after) and not any(before):
                _refuse("random numbers")  # what no particle enters is left to JAX as it is
        else:
            self._check(eqn, before, after)
        return after

    def _check(self, eqn: Any, before: list[list[int]], after: list[list[int]]) -> None:
        name = eqn.primitive.name
        if any(len(axes) > 1 for axes in after):
            _refuse(name)
        parts = control(eqn, before)
        if isinstance(parts, Scan):
            return self._check_loop(eqn, parts, after)
        if isinstance(parts, Solve):
            walk(parts.program, parts.operands, self)
            return None
        if name in WRITTEN_OUT and any(set(axes) & set(own_axes(name, eqn.params, i, len(eqn.invars[i].aval.shape)))
                                       for i, axes in enumerate(before)):  # fmt: skip
            _refuse(name)
        given, made = any(before), [bool(axes) for axes in after]
        if name == NUMBERED and not given:
            return _check_numbered(eqn, made)
        if given and not all(made):
            _refuse(name)
        if not given and any(made) and name != "broadcast_in_dim":
            _refuse(name)
        if isinstance(parts, Branches):
            for branch in parts.programs:
                walk(branch, parts.operands, self)
        if given and name in MOVES:
            _check_move(eqn, before, after[0])

    def _check_loop(self, eqn: Any, loop: Scan, after: list[list[int]]) -> None:
        """A loop of known length is what its steps are; it may not run from particle to particle."""
        if loop.length == COUNT or [0] in [*loop.rows, *after[len(loop.carry) :]]:
            _refuse(eqn.primitive.name)
        walk(loop.body, [_axes(variable) for variable in without_constants(loop.body)[0].invars], self)


def _check_numbered(eqn: Any, made: list[bool]) -> None:
    """As many keys as there are particles are theirs, others are of all; one alone could be either."""
    if eqn.params["shape"] == (1,) or (any(made) and eqn.params["shape"] != (COUNT,)):
        _refuse(NUMBERED)


def _axes(atom: Any) -> list[int]:
    """Places of the particle axis in an array."""
    shape = getattr(atom.aval, "shape", ())
    if any(size > COUNT and size % COUNT == 0 for size in shape):
        _refuse("reshape")
    return [i for i, size in enumerate(shape) if size == COUNT]


def _check_move(eqn: Any, before: list[list[int]], after: list[int]) -> None:
    """Data may be moved along any axis but that of the particles."""
    name, params = eqn.primitive.name, eqn.params
    if not before[0]:
        if name in ("dynamic_update_slice", "scatter"):
            _refuse(name)
        return
    axis, shape = before[0][0], eqn.invars[0].aval.shape
    numbers = params.get("dimension_numbers")
    wrong = {
        "rev": lambda: axis in params["dimensions"],
        "reshape": lambda: math.prod(shape[:axis]) != math.prod(eqn.outvars[0].aval.shape[: after[0]]),
        "pad": lambda: params["padding_config"][axis] != (0, 0, 0),
        "gather": lambda: not _gathers_apart(params, axis, before),
        "scatter": lambda: not before[2] or axis in (*numbers.inserted_window_dims, *numbers.scatter_dims_to_operand_dims),
        "dynamic_update_slice": lambda: before[1] != [axis],
    }
    if wrong.get(name, lambda: False)():
        _refuse(name)


def _gathers_apart(params: dict[str, Any], axis: int, before: list[list[int]]) -> bool:
    """Tell whether each particle is read from its own array: whole from all of them, or at places of its own from its own."""
    numbers = params["dimension_numbers"]
    if axis in numbers.operand_batching_dims:
        return before[1] == [numbers.start_indices_batching_dims[numbers.operand_batching_dims.index(axis)]]
    return params["slice_sizes"][axis] == COUNT and axis not in (*numbers.start_index_map, *numbers.collapsed_slice_dims) and not before[1]


def _refuse(name: str) -> None:
    raise Untranslatable(f"the operation {name} across particles")
