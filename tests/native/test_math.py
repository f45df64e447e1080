"""Elementary functions of the native engine against NumPy in double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from native_tools import natively, needs_compiler, ulps
from scipy import special

from motes.core import engine, random
from tiers import but_one_in, each

pytestmark = needs_compiler

WIDE = np.concatenate([np.linspace(-100, 100, 40_001), np.geomspace(1e-37, 1e38, 20_000), -np.geomspace(1e-37, 1e38, 20_000)])
"""XLA's threads treat smaller numbers as zero, in both engines."""
UNIT = np.concatenate([np.linspace(-1, 1, 50_001), np.geomspace(1e-30, 1, 5_000)])
EDGES = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0]

FUNCTIONS = {
    "exp": (jnp.exp, np.exp, WIDE[WIDE > -87], 2), "expm1": (jnp.expm1, np.expm1, WIDE, 2), "log": (jnp.log, np.log, np.abs(WIDE), 2),
    "log1p": (jnp.log1p, np.log1p, WIDE[WIDE > -1], 2), "sin": (jnp.sin, np.sin, WIDE[np.abs(WIDE) < 1e6], 2),
    "cos": (jnp.cos, np.cos, WIDE[np.abs(WIDE) < 1e6], 2), "tan": (jnp.tan, np.tan, WIDE[np.abs(WIDE) < 1e6], 4),
    "asin": (jnp.arcsin, np.arcsin, UNIT, 4), "acos": (jnp.arccos, np.arccos, UNIT, 4), "atan": (jnp.arctan, np.arctan, WIDE, 2),
    "sinh": (jnp.sinh, np.sinh, WIDE[np.abs(WIDE) < 88], 4), "cosh": (jnp.cosh, np.cosh, WIDE[np.abs(WIDE) < 88], 4),
    "tanh": (jnp.tanh, np.tanh, WIDE, 2), "logistic": (jax.nn.sigmoid, special.expit, WIDE[WIDE > -87], 3),
    "sqrt": (jnp.sqrt, np.sqrt, np.abs(WIDE), 1), "rsqrt": (jax.lax.rsqrt, lambda x: 1 / np.sqrt(x), np.abs(WIDE[WIDE != 0]), 2),
    "erf": (jax.scipy.special.erf, special.erf, WIDE, 2), "cbrt": (jnp.cbrt, np.cbrt, WIDE, 2),
    "log2": (jnp.log2, np.log2, np.abs(WIDE), 3), "erfc": (jax.scipy.special.erfc, special.erfc, WIDE[WIDE < 9], 5),
    "floor": (jnp.floor, np.floor, WIDE, 0), "ceil": (jnp.ceil, np.ceil, WIDE, 0), "round": (jnp.round, np.round, WIDE, 0),
    "sign": (jnp.sign, np.sign, WIDE, 0), "abs": (jnp.abs, np.abs, WIDE, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", each(list(FUNCTIONS), but_one_in(FUNCTIONS, 3)))
def test_functions_of_one_number(name):
    function, exact, points, most = FUNCTIONS[name]
    points = points.astype(np.float32)
    (ours,) = natively(lambda x: [function(x)], points[None])
    with np.errstate(all="ignore"):
        assert ulps(ours[0], exact(points.astype(np.float64))).max() <= most


def test_highest_accuracy_is_that_of_the_standard_library():
    points = np.linspace(-5, 5, 3001, dtype=np.float32)
    (ours,) = natively(lambda x: [jax.lax.exp(x, accuracy=jax.lax.AccuracyMode.HIGHEST)], points[None])
    assert ulps(ours[0], np.exp(points.astype(np.float64))).max() <= 1


@pytest.mark.parametrize("name", ["exp", "expm1", "log", "log1p", "atan", "tanh", "sqrt", "floor", "sign", "erf", "sinh", "cosh", "asin"])
def test_special_values(name):
    function, exact = FUNCTIONS[name][:2]
    (ours,) = natively(lambda x: [function(x)], np.array([EDGES]))
    with np.errstate(all="ignore"):
        wanted = exact(np.array(EDGES))
    assert np.array_equal(np.isnan(ours[0]), np.isnan(wanted)) and np.allclose(ours[0], wanted, rtol=1e-6, equal_nan=True)


def test_functions_of_two_numbers():
    generator = np.random.default_rng(0)
    y, x = generator.standard_cauchy((2, 100_000)).astype(np.float32)
    both = np.stack([y, x])
    both[:, :36] = np.array([[a, b] for a in (0.0, -0.0, 1, -1, np.inf, -np.inf) for b in (0.0, -0.0, 1, -1, np.inf, -np.inf)]).T
    cases = {
        "atan2": (lambda z: jnp.arctan2(z[:1], z[1:]), np.arctan2, 3), "rem": (lambda z: jax.lax.rem(z[:1], z[1:]), np.fmod, 0),
        "hypot": (lambda z: jnp.hypot(z[:1], z[1:]), np.hypot, 3), "max": (lambda z: jnp.maximum(z[:1], z[1:]), np.maximum, 0),
        "mod": (lambda z: jnp.mod(z[:1], z[1:]), None, 1),
    }  # fmt: skip
    for name, (function, exact, most) in cases.items():
        (ours,) = natively(lambda z, f=function: [jnp.concatenate([f(z), z[1:]])], both)
        with np.errstate(all="ignore"):
            wanted = np.asarray(function(jnp.asarray(both))[0]) if exact is None else exact(*both.astype(np.float64))
        assert ulps(ours[0], wanted).max() <= most, name


def test_whole_numbers_saturate():
    points = np.array([[0.5, -0.5, 3e9, -3e9, np.nan, np.inf, -np.inf, 7.9]])
    (ours,) = natively(lambda x: [x.astype(jnp.int32).astype(jnp.float32)], points)
    assert np.array_equal(ours[0], np.asarray(jnp.asarray(points[0]).astype(jnp.int32).astype(jnp.float32)))


@pytest.mark.optimized
def test_normal_numbers_equal_those_of_jax():
    """Same words, and normal numbers equal within 2 units in the last place, whatever the number of rows and particles."""
    for rows, n in ((1, 1024), (2, 5000), (7, 300_001), (13, 4096)):
        key = random.child(random.as_key(rows), 3)
        ours = np.asarray(blocks_normal(key, rows, n))
        wanted = np.asarray(random.normal(key, (rows, n), jnp.float32))
        assert ours.shape == (rows, n) and np.abs(ours.view(np.int32).astype(np.int64) - wanted.view(np.int32)).max() <= 2


def blocks_normal(key, rows, n):
    with engine.using("native"):
        return random.normal(key, (rows, n), jnp.float32)


def test_uniform_numbers_in_a_kernel_are_those_of_jax():
    key = random.as_key(5)
    (ours,) = natively(lambda x: [x * 0 + random.uniform(key, x.shape, jnp.float32)], np.zeros((3, 5000)))
    assert np.array_equal(ours, np.asarray(random.uniform(key, (3, 5000), jnp.float32)))
