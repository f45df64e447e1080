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
    """On the native engine, leave out what it hands to JAX anyway: float64, filters without particles, whole covariances of kernels."""
    if os.environ.get("MOTES_ENGINE") != "native":
        return
    same = [item for item in items if "double" in getattr(item, "fixturenames", ()) or
            any(word in item.name for word in ("float64", "KalmanFilter", "PointMassFilter", "common kernel"))]
    config.hook.pytest_deselected(items=same)
    items[:] = [item for item in items if item not in set(same)]


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
