"""Which file of the library imports which; run as a program it prints the tests that a change can affect, nearest first.

    python tests/sources.py

What changed is what differs from the branch `main`, or on it from the last commit. Nearest are tests that changed themselves, then those
that name what a changed file defines, then those of its room, of rooms that import it, and so on. Where nothing of the library changed it
is all tests.
"""

import ast
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "motes"
ASK_FILTERS = ("contract", "faults", "oracles", "papers")
"""Folders of tests that run filters, whose rooms have folders of their own, too."""


def imports(path):
    """Names of what a file imports from the library, as tuples of room and file; an empty one for the whole package."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("motes"):
            names = [node.module] if node.module.count(".") > 1 else [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name.split(".")[1:] for name in names)
        elif isinstance(node, ast.Import):
            yield from (alias.name.split(".")[1:] for alias in node.names if alias.name.startswith("motes"))


def changed():
    """Paths of files that differ from the branch `main`, or on it from the last commit."""

    def told(*words):
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")

    base = told("merge-base", "HEAD", "main")[0]
    return {line for line in [*told("diff", "--name-only", base), *told("ls-files", "--others", "--exclude-standard")] if line}


def distances(paths):
    """How many imports lead from each file of the library, by room and name, to one that changed."""
    files = {path.relative_to(SOURCE).with_suffix("").parts[:2]: path for path in sorted(SOURCE.rglob("*.py"))}
    importers = {}
    for path in sorted(SOURCE.rglob("*.py")):
        for target in imports(path):
            importers.setdefault(tuple(target[:2]), set()).add(path.relative_to(SOURCE).with_suffix("").parts[:2])
    found = {name: 0 for name, path in files.items() if str(path.relative_to(ROOT)) in paths}
    edge, distance = set(found), 0
    while edge:
        distance += 1
        edge = {importer for known in edge for importer in importers.get(known, ())} - set(found)
        found |= dict.fromkeys(edge, distance)
    return found


def naming(paths):
    """Test files that name what a changed file of the library defines."""
    names = set()
    for path in paths:
        if path.startswith("src/") and path.endswith(".py") and (ROOT / path).exists():
            body = ast.parse((ROOT / path).read_text()).body
            names |= {one.name for one in body if isinstance(one, ast.ClassDef) and not one.name.startswith("_")}
            names |= {f"mo.{one.name}" for one in body if isinstance(one, ast.FunctionDef) and not one.name.startswith("_")}
    words = re.compile(rf"\b({'|'.join(map(re.escape, sorted(names)))})\b") if names else None
    files = [path for path in sorted((ROOT / "tests").rglob("test_*.py")) if words and words.search(path.read_text())]
    return [str(path.relative_to(ROOT)) for path in files if path.parent.name != "contract"]


def tests_of(paths):
    """Test files and folders that a change of these paths can affect, nearest first."""
    own = sorted(path for path in paths if path.startswith("tests/") and "test_" in path and (ROOT / path).exists())
    near = {}
    for (room, *_), distance in distances(paths).items():
        near[room] = min(distance, near.get(room, distance))
    if "filters" in near:
        near |= dict.fromkeys(ASK_FILTERS, near["filters"] + 0.5)
    rooms = sorted((name for name in near if (ROOT / "tests" / name).is_dir()), key=near.get)
    return list(dict.fromkeys([*own, *naming(paths), *(f"tests/{name}" for name in rooms)])) or ["tests"]


if __name__ == "__main__":
    print(*tests_of(changed()))
