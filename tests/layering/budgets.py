"""Counts what ruff does not: lines of files and functions, and depth of inheritance. Run as a program it is part of `make lint`."""

import ast
import sys
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "motes"
FILE_LINES, FUNCTION_LINES, DEPTH = 350, 60, 2


def over_budget(source: Path = SOURCE) -> list[str]:
    """List every file, function and class over its budget."""
    found, parents = [], {}
    for path in sorted(source.rglob("*.py")):
        text = path.read_text()
        count = len(text.splitlines())
        if count > FILE_LINES:
            found.append(f"{path.relative_to(source)}: {count} lines, budget {FILE_LINES}")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                length = node.end_lineno - node.lineno + 1
                if length > FUNCTION_LINES:
                    found.append(f"{path.relative_to(source)}:{node.lineno}: {node.name} has {length} lines, budget {FUNCTION_LINES}")
            if isinstance(node, ast.ClassDef):
                parents[node.name] = [base.id for base in node.bases if isinstance(base, ast.Name)]
    found += [f"class {name}: inherits {depth(name, parents)} deep, budget {DEPTH}" for name in parents if depth(name, parents) > DEPTH]
    return found


def depth(name: str, parents: dict[str, list[str]]) -> int:
    """Number of the project's own classes above a class."""
    return max((1 + depth(base, parents) for base in parents.get(name, []) if base in parents), default=0)


if __name__ == "__main__":
    problems = over_budget()
    print("\n".join(problems) or "budgets kept")
    sys.exit(bool(problems))
