"""The one walk through a traced program; what each step means is said by a set of rules.

A program is a list of equations, each an operation with parameters that makes variables from variables and literals. What stands for a
variable is up to the rules: a number in order of appearance (`identity.py`), how it depends on the inputs (`affinity.py`), the axis of
particles or C++ (`native`).
"""

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

from motes.tracing.internals import Literal, without_constants

V = TypeVar("V")


class Rules(Protocol[V]):
    """What stands for literals, constants and the results of operations."""

    def literal(self, atom: Any, /) -> V:
        """Return what stands for a number in an equation; `atom.val` is the number."""
        ...

    def constant(self, variable: Any, value: Any, /) -> V:
        """Return what stands for an array that the program holds."""
        ...

    def step(self, equation: Any, operands: list[V], /) -> Sequence[V]:
        """Return what stands for the results of an equation; a program inside it is walked through by `walk` once more, or not."""
        ...


def walk(program: Any, inputs: Sequence[V], rules: Rules[V]) -> list[V]:
    """Walk through a program and return what stands for its outputs.

    Args:
        program: what `jax.make_jaxpr` gives, or a program inside an equation (`internals.called`, `internals.control`).
        inputs: what stands for each of its inputs.
        rules: say what stands for everything else.
    """
    jaxpr, consts = without_constants(program)
    constants = [rules.constant(variable, value) for variable, value in zip(jaxpr.constvars, consts, strict=True)]
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *inputs], strict=True))

    def read(atom: Any) -> V:
        return rules.literal(atom) if isinstance(atom, Literal) else known[atom]

    for equation in jaxpr.eqns:
        results = rules.step(equation, [read(atom) for atom in equation.invars])
        known.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]
