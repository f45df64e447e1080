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


WITHOUT_STAGES = ("Ensemble", "GaussianParticle", "GaussianSum", "CostReference", "Interacting", "JumpMarkov", "Auxiliary")
"""Filters whose cloud has no stages of its own on the native engine, only blocks that others use too."""
ON_JAX = ("test_jump_markov", "test_ensemble_kalman", "test_sigma_points", "test_gaussian_particle_filters", "test_cost_reference",
          "test_square_root_and_parallel", "test_proposals", "test_aircraft_tracking", "test_bad_input")  # fmt: skip
"""Files about such filters, or messages, alone."""
BITS_ONCE = ("test_stream_draws_the_same_bits", "test_nothing_measured")
"""Asked of the programs compiled in full: filters that share their machinery with others answer one such question, of a run cut in two."""
NIGHT = bool(os.environ.get("MOTES_NIGHTLY"))
BY_NIGHT = ("test_eager_equals_jitted", "test_vmap_over_models_and_data")
"""Asked of such filters with MOTES_NIGHTLY=1 alone."""
DOUBLE = ("[float64-KalmanFilter]", "[float64-ParticleFilter]", "[float64-MarginalizedParticleFilter]")
"""Filters whose equal bits are asked for in float64 too."""


def tells_nothing_new(item, native):
    """Float64 of variants (named with a comma) and of filters that share their blocks; on the native engine what JAX does anyway.

    That is float64, filters without particles, kernels with whole covariances, and all but two tests of variants and of filters without
    stages.
    """
    name, double = item.name, "double" in getattr(item, "fixturenames", ())
    shares = any(word in name for word in WITHOUT_STAGES)
    if "float64" in name and (native or ", " in name or shares and "test_law_keeps" not in name):
        return True
    if "float64" in name and "contract" in str(item.path) and item.get_closest_marker("optimized") and not name.endswith(DOUBLE):
        return True
    if shares and item.get_closest_marker("optimized") and name.startswith(BITS_ONCE):
        return True
    if not NIGHT and (shares and name.startswith(BY_NIGHT) or name.startswith("test_one_outlier_is_survived[1000000.0-inflate")):
        return True
    if not native:
        return False
    if item.path.stem in ON_JAX:
        return True
    if double or any(word in name for word in ("KalmanFilter", "PointMassFilter", "common kernel")):
        return True
    few = "contract" in str(item.path) and (shares or ", " in name)
    return few and not name.startswith(("test_stream", "test_extreme"))


def pytest_collection_modifyitems(config, items):
    """Leave out what tells nothing new, and keep the tests of one filter together: they share what they compile."""
    native = os.environ.get("MOTES_ENGINE") == "native"
    same = [item for item in items if tells_nothing_new(item, native)]
    config.hook.pytest_deselected(items=same)
    items[:] = [item for item in items if item not in set(same)]
    groups = {}
    for item in items:
        filter = getattr(item, "callspec", None) and item.callspec.params.get("filter")
        group = f"contract {filter!r}" if filter is not None and "contract" in str(item.path) else item.nodeid
        groups.setdefault(group, []).append(item)
        if group != item.nodeid:
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
