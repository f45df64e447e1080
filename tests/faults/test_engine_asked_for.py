"""An engine that was asked for and does not run, wholly or in part, is a warning that names the stage and the reason, once for each."""

import os
import subprocess
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

import jax
import numpy as np
import pytest

import motes as mo
from motes.core.engine import CompileError
from motes.native import blocks, compile, report
from tiers import each

sys.path.append(str(Path(__file__).parents[1] / "contract"))
from discovery import examples, shares_stages

from motes.testing.models import linear

AGAINST = blocks.standing(tried=True)
needs_compiler = pytest.mark.skipif(bool(AGAINST), reason=f"no native kernels on this machine: {AGAINST}")
FILTERS = examples()
YS = np.zeros((3, 2))


@pytest.fixture
def untold(monkeypatch):
    """As in a process that has not been warned yet."""
    monkeypatch.setattr(report, "_warned", set())


def traced(filter, model, ys=YS):
    """The engine of a run on the native engine, found by tracing anew, and what was warned of."""
    with warnings.catch_warnings(record=True) as caught, mo.engine("native"):
        warnings.simplefilter("always")
        # a keep function made anew is traced anew
        history = jax.eval_shape(lambda key: mo.run(key, filter, model, ys, keep=lambda state: {}), jax.random.key(0))
    return history.engine, [str(one.message) for one in caught if issubclass(one.category, mo.MotesWarning)]


def stages(filter, model):
    """What is explained of the native engine."""
    with mo.engine("native"):
        return mo.explain(filter, model).stages


def told_as_it_is(engine, texts, notes):
    """Whether what did not run natively was told, and nothing else: for each stage one line with its name and the reason."""
    missing = {stage: text for stage, text in notes if not text.startswith(report.FUSED)}
    assert bool(missing) == (engine != "native")
    assert len(texts) == len(missing)
    for stage, text in missing.items():
        name = "everything" if stage == "all" else f"stage '{stage}'"
        assert sum(f"but {name} runs" in line and line.endswith(f": {text.partition(': ')[2]}.") for line in texts) == 1


@needs_compiler
@pytest.mark.parametrize("filter", each(FILTERS, shares_stages))
def test_every_filter_tells_what_jax_does_for_it(filter, untold):
    model = linear()
    notes = stages(filter, model)
    engine, texts = traced(filter, model)
    told_as_it_is(engine, texts, notes)
    # once for each: another run of the same says nothing more
    assert traced(filter, model) == (engine, [])


@needs_compiler
def test_silence_is_noticed(untold, monkeypatch):
    """The planted twin: an engine that leaves work to JAX without a word."""
    monkeypatch.setattr(report.checks, "warn", lambda text: None)
    filter = mo.ParticleFilter(n=100)
    engine, texts = traced(filter, linear())
    with pytest.raises(AssertionError):
        told_as_it_is(engine, texts, stages(filter, linear()))


WALK = mo.AdditiveGaussian(lambda x, u, t: jax.lax.while_loop(lambda x: x[0] > 9, lambda x: x / 2, x), np.eye(2))
CASES = {
    "scheme": (mo.ParticleFilter(n=300, scheme=mo.resampling.Stratified()), "move", "Stratified resampling"),
    "few": (mo.ParticleFilter(n=100), "weigh", "fewer than 256 particles"),
    "proposal": (mo.ParticleFilter(n=300, proposal=mo.ExtendedKalmanProposal()), "move", "particles are moved by a proposal"),
    "no stages": (mo.KalmanFilter(), "everything", "KalmanFilter has no stage with native kernels"),
}


@needs_compiler
@pytest.mark.parametrize("case", CASES)
def test_reasons_are_named_and_shown_where_the_call_is(case, untold):
    filter, stage, reason = CASES[case]
    with mo.engine("native"), pytest.warns(mo.MotesWarning, match=f"{stage}.* runs .*: {reason}") as lines:
        mo.run(0, filter, linear(), YS, keep=lambda state: {})
    assert {Path(line.filename) for line in lines} == {Path(__file__)}


@needs_compiler
def test_models_that_are_left_to_jax(untold, precision):
    model = linear()
    assert traced(mo.ParticleFilter(n=300), model) == ("native", [])
    jumping = mo.StateSpaceModel(model.initial, WALK, model.sensor)
    engine, texts = traced(mo.ParticleFilter(n=300), jumping)
    assert engine == "native in part" and len(texts) == 1 and "stage 'move' runs as native kernels around JAX" in texts[0]


@needs_compiler
@pytest.mark.parametrize("filter, lines", [(mo.ParticleFilter(n=100), 2), (mo.KalmanFilter(), 1), (CASES["proposal"][0], 1)])
def test_streams_tell_too(filter, lines, untold):
    jax.clear_caches()
    with warnings.catch_warnings(record=True) as caught, mo.engine("native"):
        warnings.simplefilter("always")
        stream = mo.stream(0, filter, linear())
        for y in YS:
            stream.update(y)
            stream.predict()
    assert len([one for one in caught if issubclass(one.category, mo.MotesWarning)]) == lines


@pytest.mark.parametrize("engine", ["auto", "jax"])
def test_jax_is_not_warned_of(engine, untold):
    """Nobody asked for native kernels; nor does one who only wants to know."""
    with warnings.catch_warnings(), mo.engine(engine):
        warnings.simplefilter("error")
        for filter in (mo.ParticleFilter(n=100), CASES["no stages"][0], mo.ParticleFilter(n=2000, scheme=mo.resampling.Stratified())):
            mo.explain(filter, linear())
            jax.eval_shape(lambda key, filter=filter: mo.run(key, filter, linear(), YS, keep=lambda state: {}), jax.random.key(0))


WITHOUT = """
import jax, motes as mo, numpy as np
model = mo.StateSpaceModel(mo.Gaussian([0.0], [[1.0]]), mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[1.0]]))
for seed in (0, 1):
    print(mo.run(seed, mo.ParticleFilter(n=1000), model, np.zeros((3, 1))).engine)
model.initial.sample(jax.random.key(0), 2000)
"""


@pytest.mark.skipif(bool(find_spec("ziglang")), reason="there is a compiler: the package ziglang")
def test_without_a_compiler(tmp_path):
    surroundings = os.environ | {"PATH": "", "CXX": "", "MOTES_ENGINE": "native", "XDG_CACHE_HOME": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-W", "always", "-c", WITHOUT], capture_output=True, text=True, timeout=300, env=surroundings)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if "MotesWarning" in line]
    assert done.stdout.split() == ["jax", "jax"]
    assert all("no C++ compiler" in line for line in lines)
    told = [line.partition("but ")[2].partition(" runs on JAX")[0] for line in lines]
    assert sorted(told) == ["everything", "stage 'move'", "stage 'weigh'"]


@needs_compiler
def test_a_kernel_that_cannot_be_compiled_is_left_to_jax(untold, monkeypatch, tmp_path):
    """The compiler fails when all is traced: JAX does everything, and says so; the next time it knows. So in a stream."""
    whole = compile._built

    def failing(source, kept):
        if "stage.hpp" in source:
            raise CompileError("the disk is full")
        return whole(source, kept)

    monkeypatch.setattr(compile, "_built", failing)
    monkeypatch.setattr(compile, "_failed", {})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    filter, line = mo.ParticleFilter(n=1301), linear()
    # a program that no other test compiles
    model = mo.StateSpaceModel(line.initial, line.dynamics, mo.AdditiveGaussian(lambda x, u, t: 1.0301 * x[:2], np.eye(2)))
    with mo.engine("jax"):
        wanted = mo.run(0, filter, model, YS)
    with pytest.warns(mo.MotesWarning, match="a native kernel could not be compiled, and JAX does the work: the disk is full"):
        found = mo.run(0, filter, model, YS)
    assert found.engine == "jax" and np.array_equal(found.mean, wanted.mean)
    jax.clear_caches()
    again = mo.run(0, filter, model, YS)
    assert again.engine == "native in part" and np.allclose(again.mean, wanted.mean, atol=1e-3)
    compile._failed.clear()
    jax.clear_caches()
    with pytest.warns(mo.MotesWarning, match="could not be compiled"):
        stream = mo.stream(0, filter, model)
        for y in YS:
            stream.update(y)
            stream.predict()
    compile._failed.clear()
    jax.clear_caches()
    with pytest.raises(mo.MotesError, match="the disk is full"):
        jax.jit(lambda key: mo.run(key, filter, model, YS).mean)(jax.random.key(0))
