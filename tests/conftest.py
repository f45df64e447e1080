"""Settings of the whole suite; its place also puts this folder on the import path, so that tests share helpers such as data.py."""

import gc
import os
import time
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest

from tiers import NIGHT

# a look through all that is alive takes seconds where thousands of programs are kept
gc.set_threshold(700, 10, 100)

SECONDS = float(os.environ.get("MOTES_SECONDS", "inf"))
"""After so many seconds no test begins any more: what is left then is skipped, and counted."""
_began = time.monotonic()
_seen = [0]
MAPS = Path("/proc/self/maps")
MOST_MAPS = 40_000


def pytest_runtest_setup(item):
    if time.monotonic() - _began > SECONDS:
        pytest.skip("the time of this run is over: make test runs it")


@pytest.fixture(autouse=True)
def _forget_programs():
    """Drop compiled programs before a process that keeps thousands runs out of memory maps; where they cannot be counted, now and then."""
    yield
    _seen[0] += 1
    if _seen[0] % 20 == 0 and (MAPS.read_text().count("\n") > MOST_MAPS if MAPS.exists() else _seen[0] % 60 == 0):
        jax.clear_caches()


def pytest_collection_modifyitems(config, items):
    """Leave what is marked to the night, or to JAX, and keep together what shares programs: tests of a file, or of one filter."""
    native = os.environ.get("MOTES_ENGINE") == "native"

    def left(item):
        late = item.get_closest_marker("night") and not NIGHT
        return late or native and (item.get_closest_marker("jax") or "double" in getattr(item, "fixturenames", ()))

    gone = [item for item in items if left(item)]
    config.hook.pytest_deselected(items=gone)
    items[:] = [item for item in items if item not in set(gone)]
    groups = {}
    for item in items:
        filter = getattr(item, "callspec", None) and item.callspec.params.get("filter")
        group = f"contract {filter!r}" if filter is not None and "contract" in str(item.path) else item.nodeid.split("::")[0]
        groups.setdefault(group, []).append(item)
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(group))
    items[:] = [item for group in groups.values() for item in group]


@pytest.fixture(params=["float32", "float64"])
def precision(request):
    """Run a test in both precisions."""
    with jax.enable_x64(request.param == "float64"):
        yield request.param


@pytest.fixture
def double():
    """Run a test in float64."""
    with jax.enable_x64(True):
        yield
