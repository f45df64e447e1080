"""From C++ source to functions that XLA calls: compiled once by the system's compiler, kept under the hash of all that went in."""

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path

import jax
from jaxlib import version

from motes.io.private import private_folder
from motes.io.unfinished import unfinished

HEADERS = Path(__file__).parent / "cpp"
FLAGS = (
    "-std=c++17", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-fwrapv", "-fopenmp-simd",
    "-fPIC", "-shared", "-fvisibility=hidden", "-w",
)  # fmt: skip
"""No flag lets the compiler take NaN for impossible or reorder a sum that is not marked. Hidden names keep the kernels of different models,
which have the same names inside, apart."""
SECONDS = 300
MOST_KEPT = 500_000_000
"""Bytes of compiled kernels that are kept on disk."""


class CompileError(Exception):
    """The compiler is missing, or it refused the source; the text says which."""


@functools.cache
def compiler() -> tuple[str, ...]:
    """Return the words that call the C++ compiler: those of the environment variable CXX, else g++ or clang++ on the path; else none."""
    for name in (os.environ.get("CXX"), "g++", "clang++"):
        words = shlex.split(name) if name else []
        found = shutil.which(words[0]) if words else None
        if found:
            return (found, *words[1:])
    return ()


@functools.cache
def _surroundings() -> bytes:
    """What decides the machine code besides the source: compiler, processor, headers."""
    maker = subprocess.run([*_required(), "--version"], capture_output=True, timeout=SECONDS, check=False).stdout
    texts = [*_required(), *FLAGS, *_wide(), platform.machine(), jax.__version__, version.__version__]
    return b"\0".join([maker, processor(), *map(str.encode, texts), *(path.read_bytes() for path in sorted(HEADERS.glob("*.hpp")))])


def processor() -> bytes:
    """Return what tells this kind of processor from others."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor().encode()
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))})).encode()


def _wide() -> tuple[str, ...]:
    """Compilers use half of the widest registers unless told otherwise."""
    return ("-mprefer-vector-width=512",) if b"avx512f" in processor() else ()


def _required() -> tuple[str, ...]:
    found = compiler()
    if not found:
        raise CompileError("no C++ compiler: g++ or clang++ on the path, or CXX")
    return found


_loaded: dict[str, ctypes.CDLL] = {}


def shared_object(source: str) -> tuple[str, ctypes.CDLL]:
    """Compile (or find) a library and load it; return its hash too.

    Raises:
        CompileError: there is no compiler, or it failed.
    """
    mark = hashlib.sha256(_surroundings() + b"\0" + source.encode()).hexdigest()[:20]
    if mark not in _loaded:
        folder = private_folder("native")
        kept = folder / f"{mark}.so" if folder else None
        _loaded[mark] = _found(kept) or _built(source, kept)
    return mark, _loaded[mark]


def _found(kept: Path | None) -> ctypes.CDLL | None:
    """Load a library that is kept, and mark it as used now; None where there is none, or none that loads."""
    if kept is None or not kept.exists():
        return None
    try:
        os.utime(kept)
        return ctypes.CDLL(str(kept))
    except OSError:  # another process has just removed it, or the disk has lost a part of it
        return None


def _prune(folder: Path, spared: Path) -> None:
    """Remove the libraries that were used least recently, beyond what is kept; those in use by other processes stay in their memory."""
    found = []
    for path in folder.glob("*.so"):
        with suppress(OSError):
            status = path.stat()
            found.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total > MOST_KEPT and path != spared:
            path.unlink(missing_ok=True)
            total -= size


def _built(source: str, kept: Path | None) -> ctypes.CDLL:
    with unfinished(Path(tempfile.mkdtemp(dir=kept.parent if kept else None))) as folder:
        text, made = folder / "kernel.cpp", folder / "kernel.so"
        text.write_text(source)
        words = [*_required(), *FLAGS, *_wide(), f"-I{HEADERS}", f"-I{jax.ffi.include_dir()}", "-o", str(made), str(text)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as reason:
            raise CompileError(f"the C++ compiler failed: {reason}") from None
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
            raise CompileError(f"the C++ compiler refused the source: {first}")
        if kept is None:
            return ctypes.CDLL(str(made))
        # whole or not at all: another process may be looking for the same file
        os.replace(made, kept)
    _prune(kept.parent, kept)
    return ctypes.CDLL(str(kept))


_registered: set[str] = set()


def kernel(source: str, symbol: str) -> str:
    """Compile a source, register one of its kernels with XLA and return the name to call it by.

    Raises:
        CompileError: there is no compiler, or it failed.
    """
    mark, loaded = shared_object(source)
    name = f"motes_{symbol}_{mark}"
    if name not in _registered:
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(loaded, symbol)), platform="cpu")
        _registered.add(name)
    return name
