"""What starting up imports: JAX only when it is used, heavy packages only by who needs them."""

import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import motes

ROOMS = (".filters.keep", ".models.terrain", ".models.textbook")
"""Files whose names are public."""
HEAVY = ("matplotlib", "xarray", "rasterio", "pyproj", "pandas", "h5py", "scipy.stats", "scipy.signal", "scipy.io")


def imported(code):
    """Names of the modules that a fresh interpreter holds after running code."""
    program = f"{code}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.parametrize("words", [[], ["--help"], ["--version"], ["nonsense"]])
def test_help_does_not_import_jax(words):
    modules = imported(f"from motes.cli.main import main\nmain({words})")
    assert "jax" not in modules and "numpy" not in modules


def test_the_package_itself_imports_nothing_heavy():
    modules = imported("import motes")
    assert "jax" not in modules and not modules & set(HEAVY)


def test_public_names_import_nothing_heavy():
    modules = imported("import motes\nfor name in motes.__all__: getattr(motes, name)")
    assert "jax" in modules and not modules & set(HEAVY)
    assert 30 < len(motes.__all__) <= 101


def test_no_file_hides_a_public_name():
    """A function that is called as its file gives way to the file once that was imported."""
    for found in pkgutil.walk_packages(motes.__path__, "motes."):
        importlib.import_module(found.name)
    named = [getattr(motes, name) for name in motes.__all__]
    rooms = [motes, *(room for room in named if inspect.ismodule(room) and hasattr(room, "__path__"))]
    assert len(rooms) > 10
    hidden = [f"{room.__name__}.{name}" for room in rooms for file, name in
              re.findall(r"^from (\.\S+) import (\w+) as", Path(room.__file__).with_suffix(".pyi").read_text(), re.M)
              if inspect.ismodule(getattr(room, name)) and f"{file}.{name}" not in ROOMS]  # fmt: skip
    assert hidden == []
