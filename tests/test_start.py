"""What starting up imports: JAX only when it is used, heavy packages only by who needs them."""

import json
import subprocess
import sys

import pytest

import motes

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
    assert 30 < len(motes.__all__) <= 85
