"""What is jitted here is compiled with options that keep it from stopping for good, alone and within other programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from motes.core.lapack import MENDED
from motes.tracing import compiling
from motes.tracing.compiling import ONE_THREAD, OPTIONS, jitted

law = mo.Gaussian(jnp.zeros(1), jnp.eye(1))
MODEL = mo.StateSpaceModel(law, mo.LinearGaussian(jnp.eye(1), jnp.eye(1)), mo.LinearGaussian(jnp.eye(1), jnp.eye(1)), ("x",))
YS = jnp.linspace(0.0, 1.0, 6)[:, None]


@pytest.fixture
def asked(monkeypatch):
    """Give the options of every program that is handed to the compiler."""
    from jax._src import compiler

    true, seen = compiler.get_compile_options, []
    monkeypatch.setattr(compiler, "get_compile_options", lambda *a, **k: (seen.append(k.get("env_options_overrides")), true(*a, **k))[1])
    return seen


@pytest.mark.skipif(jax.__version_info__ >= MENDED, reason="from JAX 0.12 on nothing stops, and programs are compiled without options")
def test_programs_of_their_own_are_compiled_with_care(asked):
    def loop(x):
        return jax.lax.fori_loop(0, 3, lambda i, x: x + i, x)

    assert float(jitted(loop)(1.5)) == 4.5 and asked[-1] == OPTIONS
    assert float(jax.jit(loop)(2.5)) == 5.5 and not asked[-1], "the check sees programs without options"
    jax.clear_caches()
    asked.clear()
    mo.run(0, mo.ParticleFilter(n=7), MODEL, YS)
    assert OPTIONS in asked and OPTIONS | ONE_THREAD not in asked
    stream = mo.stream(0, mo.KalmanFilter(), MODEL)
    for run in (lambda: mo.run(0, mo.KalmanFilter(), MODEL, YS), lambda: stream.update(YS[0])):
        asked.clear()
        run()
        assert OPTIONS | ONE_THREAD in asked and OPTIONS not in asked


def test_within_other_programs():
    @jitted
    def loop(x):
        return jax.lax.fori_loop(0, 3, lambda i, x: x * 1.5, x)

    assert jnp.allclose(jax.jit(lambda x: loop(x) + 1)(2.0), loop(2.0) + 1)
    assert jnp.allclose(jax.jit(lambda: loop(2.0))(), loop(2.0))
    assert jnp.allclose(jax.grad(loop)(2.0), 1.5**3) and jnp.allclose(jax.jit(jax.grad(loop))(2.0), 1.5**3)
    assert jnp.allclose(jax.vmap(loop)(jnp.arange(3.0)), 1.5**3 * jnp.arange(3.0))
    assert jnp.allclose(jax.lax.scan(lambda c, _: (loop(c), c), 1.0, length=2)[0], 1.5**6)
    alone = mo.run(3, mo.KalmanFilter(), MODEL, YS).mean
    within = jax.jit(lambda ys: mo.run(3, mo.KalmanFilter(), MODEL, ys).mean)(YS)
    np.testing.assert_allclose(alone, within, rtol=1e-6)


@pytest.mark.skipif(jax.__version_info__ >= MENDED, reason="from JAX 0.12 on nothing stops, and programs are compiled without options")
def test_a_compiler_without_the_options_does_without(monkeypatch):
    monkeypatch.setattr(compiling, "OPTIONS", {"xla_cpu_no_such_option": False})
    compiling._are_needed.cache_clear()
    try:
        assert jitted(lambda x: x + 1)(1) == 2
        assert not compiling._are_needed()
    finally:
        compiling._are_needed.cache_clear()
