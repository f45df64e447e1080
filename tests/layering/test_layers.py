"""The layers: a file imports only lower ranks; methods never import each other."""

import ast

import pytest
from budgets import depth, over_budget

from sources import SOURCE, imports

RANKS = {
    "core": 0, "tracing": 1, "laws": 1, "io": 1, "data": 1, "models": 2, "resampling": 2, "native": 3, "gaussian": 3, "filters": 4,
    "smoothers": 5, "mcmc": 5, "bounds": 5, "costs": 5, "diagnostics": 5, "detect": 5,
    "montecarlo": 6, "studies": 6, "testing": 6, "planning": 7, "parameters": 7, "plotting": 8, "report": 8, "live": 8,
    "watch": 9, "applications": 9, "cli": 10,
}  # fmt: skip
SHARED = {"filters": ("interface", "info", "clouds", "needs", "gated", "gaussian", "look_ahead", "proposals", "sharp", "alarm", "notices",
                      "precision", "history", "history_files", "keep", "data", "setup", "pair", "run", "wrapper", "pieces", "late",
                       "stream_steps", "marginal_moves", "frames", "predictive", "resized"),
          "mcmc": ("interface", "chains", "continuing", "convergence", "judgement", "jumps"),
          "montecarlo": ("estimate",), "detect": ("detection",),
          "parameters": ("posterior", "paths", "augmented", "named", "likelihood", "climbing", "fitted", "response_surface",
                         "expectation_maximization")}
"""Files of a room of methods that others of the room may import; the methods themselves may not import each other."""


def breaches(path, root=SOURCE):
    room, *rest = path.relative_to(root).with_suffix("").parts
    for target in imports(path):
        if not target:
            yield "imports the whole package"
        elif target[0] != room and RANKS[target[0]] >= RANKS[room]:
            yield f"{room} (rank {RANKS[room]}) imports {target[0]} (rank {RANKS[target[0]]})"
        elif target[0] == room and room in SHARED and len(target) > 1 and target[1] not in SHARED[room]:
            yield f"method {rest[0]} imports method {target[1]}"


FILES = [path for path in sorted(SOURCE.rglob("*.py")) if len(path.relative_to(SOURCE).parts) > 1]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_go_down(path):
    assert list(breaches(path)) == []


def test_rooms_have_no_circles():
    graph = {}
    for path in FILES:
        name = path.relative_to(SOURCE).with_suffix("").parts
        graph[name] = {tuple(target[:2]) for target in imports(path) if target and target[0] == name[0] and len(target) > 1}
    done = set()

    def visit(name, above):
        assert name not in above, f"circle through {'.'.join(name)}"
        if name in done:
            return
        for target in graph.get(name, ()):
            visit(target, above | {name})
        done.add(name)

    for name in graph:
        visit(name, frozenset())


def test_a_breach_is_seen(tmp_path):
    bad = tmp_path / "laws" / "upward.py"
    bad.parent.mkdir()
    bad.write_text("from motes.filters.run import run\n")
    assert list(breaches(bad, tmp_path))
    sideways = tmp_path / "filters" / "one.py"
    sideways.parent.mkdir()
    sideways.write_text("from motes.filters.kalman import KalmanFilter\n")
    assert list(breaches(sideways, tmp_path))


def test_budgets_are_kept():
    assert over_budget() == []
    assert depth("C", {"A": [], "B": ["A"], "C": ["B"]}) == 2


ASKS = "core/user_functions.py"
"""Looks whether a user's function drew global numbers."""
FORBIDDEN = {"eval", "exec", "pickle", "marshal", "jsonpickle", "yaml"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_nothing_runs_data_as_code_or_draws_global_numbers(path):
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            assert not (isinstance(node.func, ast.Name) and name in FORBIDDEN), f"line {node.lineno} calls {name}"
            allowed = {keyword.arg: keyword.value for keyword in node.keywords}
            value = allowed.get("allow_pickle")
            assert value is None or (isinstance(value, ast.Constant) and value.value is False), f"line {node.lineno} allows pickle"
            assert "shell" not in allowed, f"line {node.lineno} uses a shell"
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = {alias.name for alias in node.names} if isinstance(node, ast.Import) else {node.module}
            chance = set() if path == SOURCE / ASKS else {"random", "numpy.random"}
            assert not names & (FORBIDDEN | chance), f"line {node.lineno} imports {names}"
