"""Compiled code that is kept between processes, in folders of the user's that nobody else can write to."""

import functools
import hashlib
import os
import platform
import stat
import sys
import time
from contextlib import suppress
from pathlib import Path

import platformdirs

SWITCH = "MOTES_CACHE"
"""Environment variable that, set to "off" (or 0, no, false), has nothing kept."""

MOST = 500_000_000
"""Bytes of each kind that are kept on disk."""

SHORTEST = 0.2
"""Programs that JAX compiled in less than this many seconds are not kept."""

A_DAY = 86_400
POSIX = os.name == "posix"


def place(name: str) -> Path:
    """Return where compiled code of one kind is kept."""
    return platformdirs.user_cache_path("motes", appauthor=False) / name


def private_folder(name: str) -> Path | None:
    """Return the folder for one kind, made where it was missing, or None where it cannot be used or nothing is to be kept.

    What lies there is executed, so a folder that others can write to is not used.
    """
    if _is_off():
        return None
    try:
        folder = place(name)
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode):
            return None
        # Windows has neither owners by number nor such modes: what lies in a user's profile is that user's
        if POSIX:
            if found.st_uid != os.getuid():
                return None
            if stat.S_IMODE(found.st_mode) != 0o700:
                folder.chmod(0o700)
        return folder if os.access(folder, os.W_OK) else None
    except (OSError, RuntimeError):
        return None


def why_not(name: str) -> str:
    """Say why nothing of one kind is kept, where there is no folder for it."""
    return f"{SWITCH}=off" if _is_off() else f"{place(name)} cannot be used"


def _is_off() -> bool:
    return os.environ.get(SWITCH, "").strip().lower() in ("off", "0", "no", "false")


def prune(folder: Path, spared: Path | None = None) -> None:
    """Remove the files that were used least recently, beyond what is kept; those in use by other processes stay in their memory."""
    found = []
    for path in folder.iterdir():
        with suppress(OSError):
            status = path.stat()
            if stat.S_ISREG(status.st_mode):
                found.append((max(status.st_mtime, status.st_atime), status.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total > MOST and path != spared:
            path.unlink(missing_ok=True)
            total -= size


@functools.cache
def processor() -> bytes:
    """Return what tells this kind of processor from others; code compiled for one need not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor().encode()
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))})).encode()


def programs() -> str:
    """Return the kind of the programs that JAX compiled on this kind of processor."""
    return f"compiled-{hashlib.sha256(processor()).hexdigest()[:8]}"


def keep_programs() -> None:
    """Let JAX keep what it compiles between processes, unless the user has set a folder for it, or switched it off.

    JAX looks for its folder once, when it first compiles, so that this is to be done before.
    """
    jax = sys.modules.get("jax")
    if os.environ.get("JAX_COMPILATION_CACHE_DIR") or (jax and getattr(jax.config, "jax_compilation_cache_dir", None)):
        return
    folder = private_folder(programs())
    if folder is None:
        return
    _prune_daily(folder)
    wanted = {"jax_compilation_cache_dir": str(folder), "jax_persistent_cache_min_compile_time_secs": SHORTEST}
    for name, value in wanted.items():
        if name.upper() in os.environ:
            continue
        if jax is None:
            os.environ[name.upper()] = str(value)
        else:
            jax.config.update(name, value)


def _prune_daily(folder: Path) -> None:
    mark = folder / "pruned"
    with suppress(OSError):
        if not mark.exists() or time.time() - mark.stat().st_mtime > A_DAY:
            mark.touch()
            prune(folder, mark)
