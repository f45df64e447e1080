"""Settings of the whole suite; its place also puts this folder on the import path, so that tests share helpers such as data.py."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest

_seen = [0]


@pytest.fixture(autouse=True)
def _forget_programs():
    """Drop compiled programs now and then: a process that keeps thousands runs out of memory maps."""
    yield
    _seen[0] += 1
    if _seen[0] % 60 == 0:
        jax.clear_caches()


def pytest_collection_modifyitems(config, items):
    """Leave out what tells nothing new: float64 of variants (named with a comma) and, on the native engine, what JAX does anyway.

    That is float64, filters without particles, and kernels with whole covariances.
    """
    native = os.environ.get("MOTES_ENGINE") == "native"
    words = ("float64", "KalmanFilter", "PointMassFilter", "common kernel")
    same = {item for item in items if ("float64" in item.name and ", " in item.name) or native and (
        "double" in getattr(item, "fixturenames", ()) or any(word in item.name for word in words))}
    config.hook.pytest_deselected(items=list(same))
    items[:] = [item for item in items if item not in same]


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
