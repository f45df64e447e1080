"""Traced programs are walked through in one place, and one file knows how JAX is made inside."""

import ast

from sources import SOURCE

CALLS = ("custom_jvp_call", "custom_vjp_call", "custom_vmap_call", "closed_call", "remat2")
INSIDES = ("jax._src.", "jax.extend.", "jax.interpreters.")


def files(*words):
    """Syntax of the files in which any of the words stands."""
    texts = {str(path.relative_to(SOURCE)): path.read_text() for path in sorted(SOURCE.rglob("*.py"))}
    return {name: ast.parse(text) for name, text in texts.items() if any(word in text for word in words)}


def walkers(trees):
    """Files that look at the equations of programs, once for each place."""
    return [name for name, tree in trees.items() for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "eqns"]


def calls(trees):
    """Files that name operations that are calls of a program."""
    return {name for name, tree in trees.items() for node in ast.walk(tree) if isinstance(node, ast.Constant) and node.value in CALLS}


def knowing(trees):
    """Files that import what JAX does not offer to everybody."""

    def imported(node):
        if isinstance(node, ast.Import):
            return [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom) and node.module:
            return [f"{node.module}.{alias.name}" for alias in node.names]
        return [f"{node.value.id}.{node.attr}"] if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) else []

    return {name for name, tree in trees.items() for node in ast.walk(tree) for target in imported(node)
            if f"{target}.".startswith(INSIDES)}  # fmt: skip


def test_programs_are_walked_through_in_one_place():
    assert walkers(files("eqns")) == ["tracing/program.py"]
    assert calls(files(*CALLS)) == {"tracing/internals.py"}


def test_one_file_knows_the_insides_of_jax():
    assert knowing(files("_src", "extend", "interpreters")) == {"tracing/internals.py"}


def test_a_breach_is_seen():
    found = {name: ast.parse(text) for name, text in {
        "one": "for line in program.jaxpr.eqns: pass", "two": "import jax._src.core", "three": "from jax.extend import core",
        "four": "CALLS = ('closed_call',)", "five": "import jax\njax.extend.core.Jaxpr",
    }.items()}  # fmt: skip
    assert walkers(found) == ["one"] and knowing(found) == {"two", "three", "five"} and calls(found) == {"four"}
