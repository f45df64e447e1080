"""The engine's C++ is taken by every compiler and standard library that is here, and computes the same."""

import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from native_tools import by_jax, natively, needs_compiler

from motes.native import compile

COMPILERS = ("g++", "clang++", "clang++ -stdlib=libc++", f"{sys.executable} -m ziglang cc")
X = np.random.default_rng(0).uniform(0.1, 0.9, (2, 300)).astype(np.float32)


def everything(x):
    """One program with a call of nearly every function that the translator knows."""
    a, b = x[:1], x[1:]
    simple = (jnp.exp, jnp.expm1, jnp.log, jnp.log1p, jnp.sin, jnp.cos, jnp.tan, jnp.arcsin, jnp.arccos, jnp.arctan, jnp.sinh, jnp.cosh,
              jnp.tanh, jnp.sqrt, jnp.cbrt, jnp.arcsinh, jnp.arctanh, jnp.exp2, jnp.floor, jnp.round, jnp.abs, jnp.sign)  # fmt: skip
    return [jnp.concatenate([sum(f(a) for f in simple), jnp.arctan2(a, b) + a**b + jnp.array([[2.0, 1.0]]) @ x + jnp.mod(a, b)])]


@pytest.fixture
def chosen(request, monkeypatch, tmp_path, tmp_path_factory):
    """Use one compiler, with no compiled code kept from before."""
    command = request.param
    monkeypatch.setenv("CXX", command)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    words = command.split()
    try:
        monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "zig"))  # what it builds first serves all tests
        trial = [*words, "-shared", "-xc++", "-", "-o", str(tmp_path / "trial.so")]
        done = subprocess.run(trial, input="#include <stdint.h>\n", capture_output=True, text=True)
        missing = done.stderr.splitlines()[0] if done.returncode else ""
    except OSError as reason:
        missing = str(reason)
    if missing:
        pytest.skip(f"{command}: {missing}")
    monkeypatch.setattr(compile, "FLAGS", tuple(flag for flag in compile.FLAGS if flag != "-O3"))  # compiles faster
    for function in (compile.compiler, compile._maker, compile._surroundings):
        function.cache_clear()
    yield command
    for function in (compile.compiler, compile._maker, compile._surroundings):
        function.cache_clear()


each_compiler = pytest.mark.parametrize("chosen", COMPILERS, indirect=True)


@each_compiler
def test_kernels_of_models(chosen):
    assert compile.compiler()[1:] == tuple(chosen.split()[1:])
    (ours,), (wanted,) = natively(everything, X), by_jax(everything, X)
    assert np.allclose(ours, wanted, rtol=1e-5)


@each_compiler
def test_kernels_without_a_model(chosen):
    loaded = compile.finished(compile.begun((compile.HEADERS / "blocks.cpp").read_text()))
    assert all(hasattr(loaded, f"motes_{name}") for name in ("normal_block", "ancestors", "weigh", "moments"))


@each_compiler
def test_the_library_of_c_plus_plus_is_not_there(chosen):
    """Some compilers would have to build it first, and each has another."""
    with pytest.raises(compile.CompileError, match="vector"):
        compile.finished(compile.begun('#include "stage.hpp"\n#include <vector>\n'))


def test_a_compiler_from_a_package(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("CXX", "")
    for there, words in ((True, (sys.executable, "-m", "ziglang", "cc")), (False, ())):
        monkeypatch.setattr(compile, "find_spec", lambda name, there=there: there or None)
        compile.compiler.cache_clear()
        assert compile.compiler() == words
    compile.compiler.cache_clear()


@needs_compiler
@pytest.mark.parametrize("words, found", [("clang++-none", False), ("g++ -DNDEBUG", True)])
def test_the_compiler_of_the_environment(words, found, monkeypatch):
    """What CXX says is used, words and all; where it names no program, what is on the path."""
    monkeypatch.setenv("CXX", words)
    compile.compiler.cache_clear()
    try:
        assert (compile.compiler()[1:] == ("-DNDEBUG",)) == found
    finally:
        compile.compiler.cache_clear()


@needs_compiler
def test_what_is_kept_has_a_bound_and_what_is_broken_is_compiled_again(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "motes" / "native"
    sources = [f'extern "C" __attribute__((visibility("default"))) int number() {{ return {place}; }}' for place in range(4)]

    def number(place):
        compile._loaded.clear()
        return compile.finished(compile.begun(sources[place])).number()

    def kept():
        return {path.stem: path.stat().st_mtime for path in folder.glob("*.so")}

    assert [number(place) for place in range(3)] == [0, 1, 2] and len(kept()) == 3
    for age, path in enumerate(sorted(folder.glob("*.so"))):
        os.utime(path, (1e9 + age, 1e9 + age))
    before = kept()
    oldest = min(before, key=before.get)
    assert [number(place) for place in range(3)] == [0, 1, 2] and min(kept().values()) > 1.1e9, "what is loaded counts as used"
    os.utime(folder / f"{oldest}.so", (1e9, 1e9))
    monkeypatch.setattr("motes.core.kept.MOST", sum(path.stat().st_size for path in folder.glob("*.so")))
    assert number(3) == 3 and len(kept()) == 3 and oldest not in kept()
    monkeypatch.setattr("motes.core.kept.MOST", 1)
    broken = folder / f"{min(kept())}.so"
    broken.unlink()  # this process has it in its memory
    broken.write_bytes(b"broken")
    assert [number(place) for place in range(4)] == [0, 1, 2, 3], "each is found, or compiled anew"
    assert len(kept()) == 1
