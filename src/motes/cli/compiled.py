"""Programs that JAX compiled, kept between calls of the command in a folder that nobody else can write to."""

import os
import stat
from pathlib import Path

SHORTEST = 0.2
"""Programs that took less than this many seconds to compile are not kept."""


def folder() -> Path:
    """Return where compiled programs are kept."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if os.path.isabs(home) else Path.home() / ".cache") / "motes" / "compiled"


def private_folder() -> Path | None:
    """Return the folder, made where it was missing, or None where it cannot be written to or is not ours alone.

    What lies there is executed, so a folder that others can write to is not used.
    """
    try:
        place = folder()
        place.parent.mkdir(parents=True, exist_ok=True)
        place.mkdir(mode=0o700, exist_ok=True)
        found = place.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            return None
        if stat.S_IMODE(found.st_mode) != 0o700:
            place.chmod(0o700)
        return place if os.access(place, os.W_OK) else None
    except (OSError, RuntimeError):
        return None


def keep_programs() -> None:
    """Let JAX keep what it compiles, unless the user has set a folder or the folder cannot be used."""
    import jax

    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    place = private_folder()
    if place is not None:
        jax.config.update("jax_compilation_cache_dir", str(place))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST)
