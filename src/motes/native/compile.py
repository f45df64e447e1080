"""From C++ source to functions that XLA calls: compiled once by the system's compiler, kept under the hash of all that went in."""

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib import version

from motes.core import engine
from motes.core.engine import CompileError
from motes.core.kept import private_folder, processor, prune
from motes.io.unfinished import unfinished
from motes.tracing.internals import before_compiling

HEADERS = Path(__file__).parent / "cpp"
FLAGS = (
    "-std=c++17", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-fwrapv", "-fopenmp-simd",
    "-fPIC", "-shared", "-fvisibility=hidden", "-w", "-nostdinc++", "-fno-exceptions", "-xc++",
)  # fmt: skip
"""No flag lets the compiler take NaN for impossible or reorder a sum that is not marked. Hidden names keep the kernels of different models,
which have the same names inside, apart. The library of C++ is not there to be included."""
SECONDS = 300


@functools.cache
def compiler() -> tuple[str, ...]:
    """Return the words that call a C++ compiler: those of the environment variable CXX, else g++ or clang++ on the path, else ziglang's.

    None where there is none of them. The package ziglang, which the extra `native` brings, has clang for every system.
    """
    for name in (os.environ.get("CXX"), "g++", "clang++"):
        words = shlex.split(name) if name else []
        found = shutil.which(words[0]) if words else None
        if found:
            return (found, *words[1:])
    return (sys.executable, "-m", "ziglang", "cc") if find_spec("ziglang") else ()


@functools.cache
def _surroundings() -> bytes:
    """What decides the machine code besides the source: compiler, processor, headers."""
    texts = [*_required(), *FLAGS, *_special(), platform.machine(), jax.__version__, version.__version__]
    return b"\0".join([_maker(), processor(), *map(str.encode, texts), *(path.read_bytes() for path in sorted(HEADERS.glob("*.hpp")))])


@functools.cache
def _maker() -> bytes:
    """Return what the compiler says of itself."""
    return subprocess.run([*_required(), "--version"], capture_output=True, timeout=SECONDS, check=False).stdout


def _special() -> tuple[str, ...]:
    """Return what is asked of this compiler and for this processor.

    Compilers use half of the widest registers unless told otherwise. GCC does not vectorize the branch that is left where it takes out of
    another one what is worked out in both, nor loops with branches of its own making for what follows from a comparison.
    """
    wide = ("-mprefer-vector-width=512",) if b"avx512f" in processor() else ()
    return (*wide, "-fno-tree-pre", "-fno-thread-jumps") if b"Free Software Foundation" in _maker() else wide


def _required() -> tuple[str, ...]:
    found = compiler()
    if not found:
        raise CompileError("no C++ compiler: g++ or clang++ on the path, CXX, or pip install 'motes[native]'")
    return found


_loaded: dict[str, ctypes.CDLL] = {}
_begun: dict[str, Future[ctypes.CDLL]] = {}
_failed: dict[str, str] = {}
_compilers = ThreadPoolExecutor(max(os.cpu_count() or 1, 1), "compiler")


def begun(source: str) -> str:
    """Begin to compile (or find) a library, beside whatever goes on; return its hash.

    Raises:
        CompileError: there is no compiler, or it has failed on this source before.
    """
    mark = hashlib.sha256(_surroundings() + b"\0" + source.encode()).hexdigest()[:20]
    if mark in _failed:
        raise CompileError(_failed[mark])
    if mark not in _loaded and mark not in _begun:
        folder = private_folder("native")
        kept = folder / f"{mark}.so" if folder else None
        _begun[mark] = _compilers.submit(lambda: _found(kept) or _built(source, kept))
    return mark


def finished(mark: str) -> ctypes.CDLL:
    """Wait for a library that was begun, and return it.

    Raises:
        CompileError: the compiler failed.
    """
    if mark not in _loaded:
        if mark in _begun and _begun[mark].exception() is None:
            _loaded[mark] = _begun.pop(mark).result()
        else:
            _note_failures()
            raise CompileError(_failed[mark])
    return _loaded[mark]


def _note_failures() -> None:
    """Wait for all that was begun, so that what is traced next knows of every failure."""
    for mark, future in list(_begun.items()):
        reason = future.exception()
        if isinstance(reason, CompileError):
            _failed[mark] = str(reason)
            del _begun[mark]
        elif reason is not None:
            raise reason


def _found(kept: Path | None) -> ctypes.CDLL | None:
    """Load a library that is kept, and mark it as used now; None where there is none, or none that loads."""
    if kept is None or not kept.exists():
        return None
    try:
        os.utime(kept)
        return ctypes.CDLL(str(kept))
    except OSError:  # another process has just removed it, or the disk has lost a part of it
        return None


def _built(source: str, kept: Path | None) -> ctypes.CDLL:
    with unfinished(Path(tempfile.mkdtemp(dir=kept.parent if kept else None))) as folder:
        text, made = folder / "kernel.cpp", folder / "kernel.so"
        text.write_text(source)
        words = [*_required(), *FLAGS, *_special(), f"-I{HEADERS}", f"-I{jax.ffi.include_dir()}", "-o", str(made), str(text), "-lm"]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as reason:
            raise CompileError(f"the C++ compiler failed: {reason}") from None
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
            raise CompileError(f"the C++ compiler refused the source: {first}")
        try:
            loaded = ctypes.CDLL(str(made))
        except OSError as reason:
            raise CompileError(f"what the C++ compiler made cannot be loaded: {reason}") from None
        if kept is not None:  # whole or not at all: another process may be looking for the same file
            os.replace(made, kept)
    if kept is not None:
        prune(kept.parent, kept)
    return loaded


_registered: set[str] = set()


def call_kernel(source: str, symbol: str, results: Any, *operands: jax.Array, **numbers: Any) -> Any:
    """Call a kernel of a source as part of a program; what is compiled from the source is waited for when the program itself is compiled.

    Args:
        source: C++.
        symbol: name of the kernel in it.
        results: shapes and types of what it gives, one or several.
        operands: arrays, at least one.
        numbers: what the kernel is told beside.

    Raises:
        CompileError: there is no compiler, or it has failed on this source before.
    """
    mark = begun(source)
    first = before_compiling(operands[0], _register, mark, symbol)
    return jax.ffi.ffi_call(_name(mark, symbol), results, vmap_method="expand_dims")(first, *operands[1:], **numbers)


def call_on_particles(
    source: str, symbol: str, results: Sequence[Any], operands: Sequence[jax.Array], of_particles: tuple[Sequence[bool], Sequence[bool]]
) -> Sequence[jax.Array]:
    """Call a kernel that works on clouds cut into elements as they lie in memory, where it is traced for these (`engine.for_elements`).

    Args:
        source: C++.
        symbol: name of the kernel in it.
        results: shapes and types of what it gives.
        operands: arrays.
        of_particles: for each operand, or the first of them, and for each result, whether its last axis is that of the particles.

    Raises:
        CompileError: see `call_kernel`.
    """
    if not engine.of_elements():
        return call_kernel(source, symbol, results, *operands)
    lanes = [*of_particles[0], *[False] * (len(operands) - len(of_particles[0]))]

    @jax.custom_batching.custom_vmap
    def call(*given: jax.Array) -> list[jax.Array]:
        return list(call_kernel(source, symbol, results, *given))

    @call.def_vmap
    def cut(count: int, batched: list[bool], *given: jax.Array) -> tuple[list[jax.Array], list[bool]]:
        # the axis of the elements goes back to where it came from: nothing is copied
        handed = []
        for array, own, lane in zip(given, batched, lanes, strict=True):
            if lane and own:
                array = jnp.moveaxis(array, 0, -2)
                array = array.reshape(*array.shape[:-2], count * array.shape[-1])
            handed.append(array if lane or own else array[None])
        wanted = [jax.ShapeDtypeStruct((*one.shape[:-1], count * one.shape[-1]) if lane else (count, *one.shape), one.dtype)
                  for one, lane in zip(results, of_particles[1], strict=True)]  # fmt: skip
        own = sum(1 << i for i, one in enumerate(batched) if one)
        found = call_kernel(source, symbol, wanted, *handed, batched=np.int64(own), elements=np.int64(count))
        return [jnp.moveaxis(one.reshape(*one.shape[:-1], count, one.shape[-1] // count), -2, 0) if lane else one
                for one, lane in zip(found, of_particles[1], strict=True)], [True] * len(found)  # fmt: skip

    return call(*operands)


def _name(mark: str, symbol: str) -> str:
    return f"motes_{symbol}_{mark}"


def _register(mark: str, symbol: str) -> None:
    """Make a kernel known to XLA."""
    name = _name(mark, symbol)
    if name not in _registered:
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(finished(mark), symbol)), platform="cpu")
        _registered.add(name)
