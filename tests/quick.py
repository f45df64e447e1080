"""Which flags make XLA compile quickly; run as a program it prints those that the installed JAX knows, for XLA_FLAGS.

XLA ends a process that asks for a flag it does not know, and flags come and go between versions: each is tried in a process of its own.
"""

import os
import subprocess
import sys

FLAGS = ("--xla_backend_optimization_level=0", "--xla_cpu_use_fusion_emitters=false", "--xla_cpu_parallel_codegen_split_count=1",
         "--xla_llvm_disable_expensive_passes=true")  # fmt: skip


def stands(flags):
    """Whether JAX starts with these flags."""
    surroundings = os.environ | {"XLA_FLAGS": " ".join(flags), "JAX_PLATFORMS": "cpu"}
    return not subprocess.run([sys.executable, "-c", "import jax; jax.devices()"], capture_output=True, env=surroundings).returncode


def known(flags=FLAGS):
    """Return those of the flags that the installed JAX knows, in order."""
    return tuple(flags) if stands(flags) else tuple(flag for flag in flags if stands([flag]))


if __name__ == "__main__":
    print(*known())
