"""Programs that JAX compiled, kept between calls of the command."""

import os

from motes.io.private import private_folder

SHORTEST = 0.2
"""Programs that took less than this many seconds to compile are not kept."""


def keep_programs() -> None:
    """Let JAX keep what it compiles, unless the user has set a folder or the folder cannot be used."""
    import jax

    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    place = private_folder("compiled")
    if place is not None:
        jax.config.update("jax_compilation_cache_dir", str(place))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST)
